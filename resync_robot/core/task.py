"""Tasks, scenarios and domains: what is asked of the robot, and what it knows to begin with."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from resync_robot.core.embodiment import Embodiment, Stage
from resync_robot.core.errors import ConfigError, PlanningError, UnknownNameError
from resync_robot.core.relations import Relation, moved
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Atoms, Object, Operator, Predicate, Term, Type


@dataclass(frozen=True)
class Task:
    """T = <objects, x_0, g>, with the physics that was drawn for it (friction, masses, looks)."""

    objects: tuple[Object, ...]
    initial: State
    goal: Atoms
    physics: Mapping[str, Any]
    seed: int

    def renamed(self, names: Mapping[Object, Object]) -> Task:
        """The same of other objects of the same types: what is called how changes nothing."""
        initial, goal = self.initial.renamed(names), frozenset(a.substitute(names) for a in self.goal)
        return replace(self, objects=initial.objects, initial=initial, goal=goal)


Sample = Callable[[np.random.Generator, int], Task]
"""(rng, seed) -> a task; a pure function of the two."""


def _as_usual(rng: np.random.Generator, seed: int) -> Task:
    raise NotImplementedError("Scenario puts its own `sample` in this place")


@dataclass(frozen=True)
class Scenario:
    """A family of tasks. `training` scenarios elicit the failure; the others test generalisation.

    Attributes:
        goal: domain -> what shall hold in the end.
        sample: a task with physics, sizes and looks between the edges of training.
        sample_practice: the same, at the edges more often: what training draws. `sample` unless given.
        sample_unseen: the same, with physics, sizes and looks that training never draws. `sample` unless given.
        training: whether a stage learns from its failures.
        begins_after: given skills with the names of their objects, which the robot runs before an episode begins: what
            they leave behind is the situation that it is in, such as a block in its hand.
        after_stage: the stage, from 1, after which it can be expected to succeed; 0: the given model does.
    """

    name: str
    description: str
    goal: Callable[[Domain], Atoms]
    sample: Sample
    sample_practice: Sample = _as_usual
    sample_unseen: Sample = _as_usual
    training: bool = False
    begins_after: tuple[tuple[str, tuple[str, ...]], ...] = ()
    after_stage: int = 1

    def __post_init__(self) -> None:
        for name in ("sample_practice", "sample_unseen"):
            if getattr(self, name) is _as_usual:
                object.__setattr__(self, name, self.sample)


def _not_declared(*_: Any) -> Task:
    raise ConfigError("this domain does not say how its tasks are resampled", "use its `free` instead")


@dataclass(frozen=True)
class Domain:
    """The initial knowledge: types, given predicates with their classifiers, given operators, robot, scenarios.

    Attributes:
        classifiers: predicate name -> function of (state, objects) -> probability that it holds.
        embodiment: how its robot acts, and its simulator.
        stages: what is to be learned, in order.
        free: (rng, seed, how many objects of which type) -> a task in which nothing obstructs anything; of a type that
            is not asked for as many as it takes.
        world_numbers: scenario -> the number that its worlds of evaluation are drawn with. It has to stay what it is;
            a scenario without one gets a number by its name.
        dream: (rng, seed, how many objects of the relevant type) -> a task in which all of them begin free.
        practice: (rng, seed) -> a task with one object somewhere between trapped and free, or covered, where the domain
            knows better than chance what is worth practising. An attempt ends with its first failure, so every skill
            should be the first one to meet what is in the way now and then.
        expert: (state, goal) -> the skill sequence that a person gives: (skill name, objects) each.
        instruction: what the recovery does, in a sentence, for datasets and policies that read one.
        spec: what `find_domain` finds it by in another process, which fills it in; the name of one that comes with the
            program.
        stacking: two-place predicates that put one thing upon another: a thing is upon one other at most, and never,
            by whatever way round, upon itself. The given model need not know; goals are checked by it.
        relations: how objects of two types lie beside each other, where the default of `core.relations` does not do.
        fixed: types whose objects stay where they are, as a box or a wall does: others are moved to them when states
            are resampled. What else causes a failure is moved to what the failure is about.
    """

    name: str
    types: tuple[Type, ...]
    predicates: tuple[Predicate, ...]
    classifiers: Mapping[str, Callable[[State, tuple[Object, ...]], float]]
    operators: tuple[Operator, ...]
    scenarios: Mapping[str, Scenario]
    stages: tuple[Stage, ...]
    embodiment: Embodiment | None = None
    free: Callable[[np.random.Generator, int, Mapping[Type, int]], Task] | None = None
    world_numbers: Mapping[str, int] = field(default_factory=dict)
    dream: Callable[[np.random.Generator, int, int], Task] = _not_declared
    practice: Sample | None = None
    expert: Callable[[State, Atoms], tuple[tuple[str, tuple[Object, ...]], ...]] | None = None
    instruction: str = ""
    stacking: tuple[Predicate, ...] = ()
    relations: Mapping[tuple[Type, Type], Relation] = field(default_factory=dict)
    fixed: tuple[Type, ...] = ()
    spec: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "spec", self.spec or self.name)

    def relocate(self, task: Task, obj: Object, beside: Object, relative: np.ndarray, rng: np.random.Generator) -> Task:
        """The task with one object beside another as `relative` says, in the columns of their relation: how failure
        mining and dreaming resample states."""
        return replace(task, initial=moved(task.initial, obj, beside, relative, rng, self.relations))

    def moving(self, cause: Object, relevant: Object) -> tuple[Object, Object]:
        """Of a failure's cause and what the failure is about: which is moved when states are resampled, and beside
        which."""
        return (relevant, cause) if cause.type in self.fixed else (cause, relevant)

    @property
    def recovery(self) -> str:
        """The skill that the first stage learns."""
        return self.stages[0].recovery

    @property
    def types_hash(self) -> str:
        """Of the names and features of its types: what was learned of others says nothing here."""
        words = "; ".join(f"{t.name}({', '.join(t.features)})" for t in sorted(self.types))
        return hashlib.sha256(words.encode()).hexdigest()[:16]

    def world_number(self, scenario: str) -> int:
        """What sets the worlds of evaluation of one scenario apart from those of the others, whatever their order."""
        by_name = int.from_bytes(hashlib.sha256(scenario.encode()).digest()[:8])
        return self.world_numbers.get(scenario, by_name)

    def predicate(self, name: str) -> Predicate:
        for p in self.predicates:
            if p.name.lower() == name.lower():
                return p
        raise UnknownNameError("predicate", name, [p.name for p in self.predicates])

    @property
    def first_test(self) -> Scenario:
        """The first scenario that nothing trains in, or just the first where there is none such."""
        every = list(self.scenarios.values())
        return next((s for s in every if not s.training), every[0])

    def scenario(self, name: str) -> Scenario:
        if name not in self.scenarios:
            raise UnknownNameError(f"scenario of {self.name}", name, list(self.scenarios))
        return self.scenarios[name]

    def parse_goal(self, text: str, objects: tuple[Object, ...]) -> Atoms:
        """Atoms from text such as 'On(b1,b0), On(b2,b1)'.

        Raises:
            UnknownNameError: of a predicate or object.
            PlanningError: it is no list of atoms, or one that no state can meet.
        """
        atoms = parse_atoms(text, self.predicates, objects)
        for predicate in self.stacking:
            _check_stack(predicate, sorted(a for a in atoms if a.predicate == predicate))
        return atoms


def _check_stack(predicate: Predicate, atoms: Sequence[Atom]) -> None:
    """Refuse a thing upon two others, and a ring. Raises PlanningError."""
    below: dict[Term, Term] = {}
    for upper, lower in (a.args for a in atoms):
        if upper in below:
            both = f"{predicate(upper, below[upper])} and {predicate(upper, lower)}"
            raise PlanningError(
                f"no state has both {both}: {upper} is upon one thing at a time", "leave out one of them"
            )
        below[upper] = lower
    for start in below:
        ring = [start]
        while (ahead := below.get(ring[-1])) is not None and ahead != start and ahead not in ring:
            ring.append(ahead)
        if ahead == start:
            words = ", ".join(str(predicate(upper, below[upper])) for upper in ring)
            raise PlanningError(f"no state has {words}: {start} would be upon itself", "leave out one of them")


def parse_atoms(text: str, predicates: tuple[Predicate, ...], objects: tuple[Object, ...]) -> Atoms:
    """Read 'P(a,b), Q(c)' into atoms; names are case-insensitive for predicates, exact for objects."""
    names = {p.name.lower(): p for p in predicates}
    known = {o.name: o for o in objects}
    found: list[Atom] = []
    # A word with a parenthesis behind it looks like an atom, too.
    rest = _ATOM.sub(lambda atom: atom[1] if atom[1].lower() in _WORDS else " ", text)
    if rest.strip(" ,;&"):
        shown = " ".join(text.split())
        raise PlanningError(f"cannot read the goal '{shown}': {_why_not(rest)}", f"write it as {_EXAMPLE}")
    for name, inside in _ATOM.findall(text):
        if name.lower() not in names:
            raise UnknownNameError("predicate", name, [p.name for p in predicates])
        args = [a.strip() for a in inside.split(",") if a.strip()]
        for a in args:
            if a not in known:
                raise UnknownNameError("object", a, list(known))
        atom = names[name.lower()](*(known[a] for a in args))
        if len(set(args)) < len(args):
            raise PlanningError(f"no state has {atom}: it takes different objects", f"write it as {_EXAMPLE}")
        found.append(atom)
    if not found:
        raise PlanningError(f"the goal '{text}' names no atom", f"write it as {_EXAMPLE}")
    return frozenset(found)


_ATOM = re.compile(r"([\w-]+)\s*\(([^()]*)\)")
_EXAMPLE = '--goal "On(b1,b0)"'
_WORDS = {
    **dict.fromkeys(("not", "!", "~", "¬"), "a goal lists what shall hold, and cannot ask that something does not"),
    **dict.fromkeys(("and", "∧", "+"), "atoms stand beside each other, with a comma between them"),
    **dict.fromkeys(("or", "|", "||", "∨"), "a goal leaves no choice: all of its atoms shall hold"),
    **dict.fromkeys(("forall", "exists", "imply", "when"), "a goal names each object, without a rule over them"),
}


def _why_not(rest: str) -> str:
    """What is wrong with what is left of a goal without its atoms."""
    for word in re.findall(r"[^\s,;&()]+", rest):
        if word.lower() in _WORDS:
            return f"'{word}' is not understood; {_WORDS[word.lower()]}"
    word = next(iter(re.findall(r"[^\s,;&()]+", rest)), None)
    if word is not None:
        return f"'{word}' is no atom"
    if "(" in rest or ")" in rest:
        return "a parenthesis is too many, or not closed"
    return "it has a line break or a tab; write all atoms on one line"
