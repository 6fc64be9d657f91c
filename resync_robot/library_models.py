"""Models to plan with: the given one, the given one with a recovery skill, and the one that a library holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from resync_robot.core.embodiment import Embodiment
from resync_robot.core.errors import ConfigError, LibraryError, ResyncError
from resync_robot.core.library import RETRAIN, LearnedStage, Library, Record
from resync_robot.core.rig import Rig
from resync_robot.core.skill import Skill
from resync_robot.core.symbols import Operator, Predicate, Type
from resync_robot.core.task import Domain
from resync_robot.learning.model import Concepts, load_concepts
from resync_robot.planning.abstract import Abstraction, Classifier, Form, Not, form_from_json
from resync_robot.planning.execute import Model
from resync_robot.planning.outcome_costs import OutcomeCosts, Tally
from resync_robot.planning.pddl import domain_to_pddl


def shipped_library(domain: str) -> Path:
    """Where the library lies that comes with the program. Raises LibraryError where none does."""
    path = Path(__file__).parent / "shipped" / domain
    if not path.exists():
        raise LibraryError(
            f"no library folder comes with the program for '{domain}'",
            "give one with --library; train one: resync-robot train-sim --domain DOMAIN",
        )
    return path


def embodiment_of(domain: Domain, rig: Rig | None) -> Embodiment:
    """The robot of a domain: its own, or the arm of the rig. Raises ConfigError where there is none."""
    if domain.embodiment is not None:
        return domain.embodiment
    from resync_robot.arm_embodiment import arm_embodiment  # its simulator takes seconds to import

    return arm_embodiment(_required(rig), domain.operators)


def initial_model(domain: Domain, rig: Rig | None) -> Model:
    """What the robot knows before it has failed (C_0, Psi_0, Op_0).

    Args:
        rig: of an arm; a domain with a robot of its own has none.
    """
    if domain.embodiment is not None:
        given = domain.embodiment.skills()
    else:
        from resync_robot.policies.given_skills import given_skills

        given = given_skills(_required(rig), domain.operators)
    skills = {s.name: s for s in given}
    return Model(skills, Abstraction(domain.predicates, domain.classifiers), domain.operators)


def _required(rig: Rig | None) -> Rig:
    if rig is None:
        raise ConfigError("an arm needs a rig", "give one with --rig")
    return rig


def recovery_of(domain: Domain, rig: Rig | None, name: str, record: Record, skills: Mapping[str, Skill]) -> Skill:
    """The learned skill of a record, which follows the simulator's state. Raises LibraryError on a broken record.

    Args:
        skills: the given ones, among them the one whose failure it mends.
    """
    if domain.embodiment is None:
        from resync_robot.policies.state_recovery import recovery_skill

        return recovery_skill(name, record, _required(rig))
    from resync_robot.learning.learned_recovery import LearnedRecovery

    learned = LearnedRecovery.from_record(name, record, {t.name: t for t in domain.types})
    if learned.failed_skill not in skills:
        raise LibraryError(f"{name} begins with {learned.failed_skill}, which is no skill here", RETRAIN)
    return learned.skill(skills[learned.failed_skill], domain.embodiment, domain.relations)


def known_concepts(domain: Domain, library: Library) -> Concepts:
    """The symbols that a library holds, and what they rely on: what the next stage is learned on top of.

    Raises:
        LibraryError: it was learned in another domain, or does not fit this one.
    """
    if library.domain != domain.name:
        raise LibraryError(f"the library was learned in '{library.domain}', not in '{domain.name}'", RETRAIN)
    if library.types_hash not in ("", domain.types_hash):
        raise LibraryError(f"the types of '{domain.name}' are not those any more that the library knows", RETRAIN)
    return load_concepts(library.domain_pddl, library.predicates, domain)


def learned_names(domain: Domain, library: Library) -> list[str]:
    """Predicates and skills of a library's model that the domain did not give."""
    concepts = known_concepts(domain, library)
    given = {*(p.name for p in domain.predicates), *(o.name for o in domain.operators)}
    return sorted({*(p.name for p in concepts.predicates), *(o.name for o in concepts.operators)} - given)


def sees_by_camera(domain: Domain, library: Library) -> bool:
    """Does the library hold a camera policy for the recovery?"""
    return domain.recovery in library.policies


def camera_recovery(domain: Domain, rig: Rig, library: Library) -> Skill:
    """The recovery that follows its block by camera. Raises LibraryError or PolicyError where there is none for this
    rig."""
    if not sees_by_camera(domain, library):
        raise LibraryError(
            f"the library holds no camera policy for '{domain.recovery}'",
            "train one: resync-robot train-sim, or run with --skills state",
        )
    from resync_robot.perception.objects import catalogue_of
    from resync_robot.policies.camera_recovery import camera_recovery_skill
    from resync_robot.policies.carried_block import ByState
    from resync_robot.policies.diffusion import load_student

    # LeRobot reads folders; what is given to it is what was verified, not what may lie in the library by now.
    with TemporaryDirectory() as folder:
        for name, data in library.policies[domain.recovery].items():
            (Path(folder) / name).write_bytes(data)
        student = load_student(Path(folder), rig)
    return camera_recovery_skill(
        domain.recovery, student, rig, hues=catalogue_of(rig).hues, by_state=ByState.of(library.skills[domain.recovery])
    )


def learned_model(domain: Domain, rig: Rig | None, library: Library, recoveries: Sequence[Skill] = ()) -> Model:
    """Everything a library holds. Raises LibraryError where it does not fit the domain.

    Args:
        recoveries: in place of those of the same names that follow the simulator's state.
    """
    concepts = known_concepts(domain, library)
    if not library.stages:
        raise LibraryError("the library holds no stage, and so no recovery", RETRAIN)
    missing = [s.recovery for s in library.stages if s.recovery not in library.skills]
    if missing:
        raise LibraryError(f"the library holds no skill '{missing[0]}'", RETRAIN)
    skills = dict(initial_model(domain, rig).skills)
    for stage in library.stages:
        name = stage.recovery
        skills[name] = recovery_of(domain, rig, name, library.skills[name], skills)
    skills |= {skill.name: skill for skill in recoveries}
    predicates, operators = concepts.predicates, concepts.operators
    try:
        for variant, base in library.execution.get("variants", {}).items():
            operator = next(o for o in operators if o.name == variant)
            skills[variant] = _variant(variant, skills[base], tuple(v.type for v in operator.parameters))
        costs = _costs(library.execution.get("experience", {}), predicates, operators)
    except (AttributeError, IndexError, KeyError, StopIteration, TypeError, ValueError, ResyncError) as error:
        raise LibraryError(f"execution.json does not fit domain.pddl: {error!r}", RETRAIN) from error
    learned = [p.name for p in predicates if _base(p.name, concepts.classifiers) not in domain.classifiers]
    errors = {name: _error(name, concepts.classifiers, library) for name in learned}
    return Model(skills, Abstraction(predicates, concepts.classifiers), operators, errors, costs)


def _base(predicate: str, classifiers: Mapping[str, Classifier | Form]) -> str:
    """The predicate that this one is derived from in the end, or itself."""
    form = classifiers[predicate]
    return _base(form.base.name, classifiers) if isinstance(form, Form) else predicate


def _error(predicate: str, classifiers: Mapping[str, Classifier | Form], library: Library) -> float | None:
    """The share of held-out cases in which the classifier of a learned predicate was wrong, where that is known."""
    accuracy = library.predicates[_base(predicate, classifiers)].meta.get("accuracy")
    return 1.0 - accuracy if isinstance(accuracy, int | float) and 0.0 <= accuracy <= 1.0 else None


def _costs(
    experience: Mapping[str, Any], predicates: tuple[Predicate, ...], operators: tuple[Operator, ...]
) -> OutcomeCosts:
    by_name, signatures = {p.name: p for p in predicates}, {o.name: o.parameters for o in operators}
    tallies: dict[str, list[Tally]] = {skill: [] for skill in experience}
    for skill, entries in experience.items():
        for entry in entries:
            predicate, arguments = by_name[entry["predicate"]], _arguments(entry)
            form = form_from_json({**entry, "base": predicate.name}, by_name) if "form" in entry else None
            if isinstance(form, Not):
                raise ValueError(f"{skill} is counted by {form.predicate.name}")
            predicate = predicate if form is None else form.predicate
            if predicate.types != tuple(signatures[skill][i].type for i in arguments):
                raise ValueError(f"{predicate.name} is not about arguments {arguments} of {skill}")
            held, otherwise = ((int(s), int(n)) for s, n in (entry["held"], entry["otherwise"]))
            if not (0 <= held[0] <= held[1] and 0 <= otherwise[0] <= otherwise[1]):
                raise ValueError(f"{skill} succeeded more often than it was tried")
            tallies[skill].append(Tally(predicate, arguments, held, otherwise, form))
    return OutcomeCosts(tallies)


def _arguments(entry: Mapping[str, Any]) -> tuple[int, ...]:
    """What a tally is about. Older libraries know tallies of one argument only."""
    if "arguments" in entry:
        return tuple(entry["arguments"])
    return () if entry["argument"] is None else (entry["argument"],)


def make_library(
    domain: Domain,
    rig: Rig | None,
    stage: LearnedStage,
    recovery: Record,
    concepts: Concepts,
    provenance: Mapping[str, Any],
    policy: Mapping[str, bytes] | None = None,
    known: Library | None = None,
) -> Library:
    """What a stage of training saves, with all that was known before it; `learned_model` is the way back.

    Args:
        stage, recovery: what it learned to do, and the record of that skill.
        concepts: the whole model: that of earlier stages, and what this one added.
        policy: the files of the recovery's camera policy.
        known: the library of the stages before.
    """
    name = stage.recovery
    return Library(
        domain=domain.name,
        rig_hash=rig.hash if rig is not None else "",
        domain_pddl=domain_to_pddl(domain.name, domain.types, concepts.predicates, concepts.operators),
        predicates=concepts.records,
        skills={**(known.skills if known else {}), name: recovery},
        stages=(*(known.stages if known else ()), stage),
        provenance=provenance,
        execution={
            "variants": concepts.report.get("variants", {}),
            "experience": concepts.report.get("experience", {}),
        },
        policies={**(known.policies if known else {}), **({name: policy} if policy else {})},
        types_hash=domain.types_hash,
    )


def _variant(name: str, base: Skill, types: tuple[Type, ...]) -> Skill:
    """The published formulation's symbol for an attempt that is expected to fail: the same skill by another name."""
    count = len(base.types)
    return replace(base, name=name, types=types, start=lambda objects, first: base.start(objects[:count], first))
