"""What is wrong with a domain before anything of it runs: parts that are missing, misnamed, or do not fit together."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields
from typing import Any

from resync_robot.core.embodiment import Embodiment, Stage
from resync_robot.core.skill import Skill
from resync_robot.core.symbols import Operator, Predicate, Type
from resync_robot.core.task import Domain, Scenario

Fault = tuple[str, str]
"""What is wrong, and how to mend it."""


def faults(domain: Domain) -> Iterator[Fault]:
    """Everything that is wrong. What builds on something that is wrong is not looked at."""
    kinds = list(_wrong_kinds(domain))
    yield from kinds
    if kinds:
        return
    yield from _names(domain)
    yield from _types(domain)
    yield from _predicates(domain)
    yield from _operators(domain)
    yield from _scenarios(domain)
    yield from _stages(domain)
    if domain.embodiment is not None:
        yield from _embodiment(domain.embodiment)


def skill_faults(domain: Domain, skills: Any) -> Iterator[Fault]:
    """What is wrong with the given skills, which are made by a function of the domain's own."""
    if not isinstance(skills, tuple) or not all(isinstance(s, Skill) for s in skills):
        yield f"embodiment.skills() returns {_kind(skills)}", "return a tuple of Skill"
        return
    yield from _twice("skill", (s.name for s in skills))
    named = {s.name: s for s in skills}
    for operator in domain.operators:
        skill = named.get(operator.name)
        if skill is None:
            yield f"operator {operator.name} has no skill; there are {_list(named)}", "name one after the operator"
        elif skill.types != tuple(v.type for v in operator.parameters):
            wanted = ", ".join(v.type.name for v in operator.parameters)
            found = ", ".join(t.name for t in skill.types)
            yield f"skill {skill.name} takes ({found}), its operator ({wanted})", "give both the same types"
    for skill in skills:
        if not (skill.rate_hz > 0 and skill.time_limit_s > 0):
            yield f"skill {skill.name} has a rate or a time limit that is not above 0", "give it Hz and s"
    for scenario in domain.scenarios.values():
        for name, _ in scenario.begins_after:
            if name not in named:
                yield f"scenario {scenario.name} begins after '{name}', which is no skill", f"one of {_list(named)}"


# field -> what each has to be: a class, or (the class of its entries,) in a tuple
_FIELDS: Mapping[str, Any] = {
    "name": str,
    "types": (Type,),
    "predicates": (Predicate,),
    "classifiers": Mapping,
    "operators": (Operator,),
    "scenarios": Mapping,
    "stages": (Stage,),
    "embodiment": Embodiment,
    "free": Callable,
    "world_numbers": Mapping,
    "practice": Callable,
    "expert": Callable,
    "fixed": (Type,),
}
_MAY_LACK = ("embodiment", "free", "practice", "expert")


def _wrong_kinds(domain: Domain) -> Iterator[Fault]:
    for field in fields(domain):
        wanted, found = _FIELDS.get(field.name), getattr(domain, field.name)
        if wanted is None or (found is None and field.name in _MAY_LACK):
            continue
        if isinstance(wanted, tuple):
            if not isinstance(found, tuple) or not all(isinstance(x, wanted[0]) for x in found):
                yield (
                    f"{field.name} is {_kind(found)}",
                    f"make it a tuple of {wanted[0].__name__}: ({field.name}[0], ...)",
                )
        elif not isinstance(found, wanted):
            name = "a function" if wanted is Callable else f"a {wanted.__name__}"
            yield f"{field.name} is {_kind(found)}", f"make it {name.replace('a Mapping', 'a dictionary')}"


def _names(domain: Domain) -> Iterator[Fault]:
    if not re.fullmatch(r"[a-z][a-z0-9-]*", domain.name):
        yield f"the name '{domain.name}' names folders, too", "use small letters, digits and '-'"
    for field in ("types", "predicates", "operators", "stages"):
        if not getattr(domain, field):
            yield f"there are no {field}", f"give at least one: {field}=(...,)"
    if not domain.scenarios:
        yield "there are no scenarios", "give at least one that trains, and one that tests"


def _types(domain: Domain) -> Iterator[Fault]:
    yield from _twice("type", (t.name for t in domain.types))
    for t in domain.types:
        if not isinstance(t.features, tuple) or not all(isinstance(f, str) for f in t.features):
            yield f"the features of type {t.name} are {t.features!r}", 'make them a tuple of names: ("x", "y")'
        else:
            yield from _twice(f"feature of type {t.name}", t.features)


def _predicates(domain: Domain) -> Iterator[Fault]:
    yield from _twice("predicate", (p.name.lower() for p in domain.predicates))
    for p in domain.predicates:
        yield from _known_types(domain, f"predicate {p.name}", p.types)
        if p.name not in domain.classifiers:
            yield (
                f"predicate {p.name} has no classifier",
                f'add "{p.name}": function of (state, objects) to classifiers',
            )
        elif not callable(domain.classifiers[p.name]):
            yield f"the classifier of {p.name} is {_kind(domain.classifiers[p.name])}", "make it a function"
    for name in sorted(set(domain.classifiers) - {p.name for p in domain.predicates}):
        yield (
            f"there is a classifier '{name}', and no such predicate",
            f"one of {_list(p.name for p in domain.predicates)}",
        )


def _operators(domain: Domain) -> Iterator[Fault]:
    yield from _twice("operator", (o.name for o in domain.operators))
    for o in domain.operators:
        yield from _known_types(domain, f"operator {o.name}", (v.type for v in o.parameters))
        for predicate in sorted({a.predicate for a in o.preconditions | o.add | o.delete} - set(domain.predicates)):
            yield f"operator {o.name} uses {predicate.name}, which is not among the predicates", "add it there"
        if not o.add | o.delete:
            yield f"operator {o.name} changes nothing", "give it effects: add, delete"


def _scenarios(domain: Domain) -> Iterator[Fault]:
    for name, scenario in domain.scenarios.items():
        if not isinstance(scenario, Scenario):
            yield f"scenario '{name}' is {_kind(scenario)}", "make it a Scenario"
            continue
        if scenario.name != name:
            yield f"scenario '{scenario.name}' is filed under '{name}'", "use {s.name: s for s in SCENARIOS}"
        for part in ("goal", "sample", "sample_practice", "sample_unseen"):
            if not callable(getattr(scenario, part)):
                yield f"{part} of scenario {name} is {_kind(getattr(scenario, part))}", "make it a function"
        if not 0 <= scenario.after_stage <= len(domain.stages):
            yield (
                f"scenario {name} is for after stage {scenario.after_stage}",
                f"one of 0 (none) to {len(domain.stages)}",
            )


def _stages(domain: Domain) -> Iterator[Fault]:
    yield from _twice("recovery", (s.recovery for s in domain.stages))
    for stage in domain.stages:
        scenario = domain.scenarios.get(stage.scenario)
        if scenario is None:
            yield f"stage {stage.recovery} learns in '{stage.scenario}'", f"a scenario: {_list(domain.scenarios)}"
        elif isinstance(scenario, Scenario) and not scenario.training:
            yield f"stage {stage.recovery} learns in {scenario.name}, which is for tests", "set training=True there"
        if stage.recovery in {o.name for o in domain.operators}:
            yield f"stage {stage.recovery} learns a skill that is given already", "give the recovery another name"
        if stage.horizon < 1:
            yield f"stage {stage.recovery} has a horizon of {stage.horizon}", "give it the actions of an attempt"


def _embodiment(embodiment: Embodiment) -> Iterator[Fault]:
    for part in ("simulate", "skills"):
        if not callable(getattr(embodiment, part)):
            yield f"embodiment.{part} is {_kind(getattr(embodiment, part))}", "make it a function"
    if not isinstance(embodiment.actions, Mapping) or not embodiment.actions:
        yield f"embodiment.actions is {_kind(embodiment.actions)}", 'make it a dictionary: {"vx": (-1.0, 1.0)}'
        return
    for name, ends in embodiment.actions.items():
        try:
            low, high = map(float, ends)
            fits = low < high and math.isfinite(high - low)
        except (TypeError, ValueError):
            fits = False
        if not fits:
            yield f"action '{name}' goes from least to greatest {ends!r}", "give it two numbers: (-1.0, 1.0)"
    if not embodiment.rate_hz > 0:
        yield f"embodiment.rate_hz is {embodiment.rate_hz}", "give the actions a second"


def _known_types(domain: Domain, what: str, types: Iterable[Type]) -> Iterator[Fault]:
    for t in sorted(set(types) - set(domain.types)):
        yield f"{what} is about type '{t.name}', which is not among the types", "add it there, with the same features"


def _twice(kind: str, names: Iterable[str]) -> Iterator[Fault]:
    for name in sorted(n for n, count in Counter(names).items() if count > 1):
        yield f"{kind} '{name}' is there twice", "give one of them another name"


def _list(names: Iterable[str]) -> str:
    return ", ".join(sorted(names)) or "none"


def _kind(value: Any) -> str:
    if isinstance(value, tuple):
        return f"a tuple with {_list({type(x).__name__ for x in value})} in it"
    return f"of type {value.__name__}" if isinstance(value, type) else f"of type {type(value).__name__}"
