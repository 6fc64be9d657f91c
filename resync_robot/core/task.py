"""Tasks, scenarios and domains: what is asked of the robot, and what it knows to begin with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from resync_robot.core.errors import UnknownNameError
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Atoms, Object, Operator, Predicate, Type


@dataclass(frozen=True)
class Task:
    """T = <objects, x_0, g>, with the physics that was drawn for it (friction, masses, looks)."""

    objects: tuple[Object, ...]
    initial: State
    goal: Atoms
    physics: Mapping[str, Any]
    seed: int


@dataclass(frozen=True)
class Scenario:
    """A family of tasks. `training` scenarios elicit the failure; the others test generalisation.

    Attributes:
        sample: (rng, seed) -> a task with physics, sizes and looks between the edges of training.
        sample_practice: the same, at the edges more often: what training draws.
        sample_unseen: the same, with physics, sizes and looks that training never draws.
        begins_after: given skills with the names of their objects, which the robot runs before an episode begins: what
            they leave behind is the situation that it is in, such as a block in its hand.
    """

    name: str
    description: str
    goal: Callable[[Domain], Atoms]
    sample: Callable[[np.random.Generator, int], Task]
    sample_practice: Callable[[np.random.Generator, int], Task]
    sample_unseen: Callable[[np.random.Generator, int], Task]
    training: bool = False
    begins_after: tuple[tuple[str, tuple[str, ...]], ...] = ()


@dataclass(frozen=True)
class Domain:
    """The initial knowledge: types, given predicates with their classifiers, given operators, scenarios.

    Attributes:
        classifiers: predicate name -> function of (state, objects) -> probability that it holds.
        recovery: name of the skill to be learned.
        relocate: (task, object, relative pose, rng) -> the task with that object and the failure object in the
            relative pose; how failure mining and dreaming resample states.
        dream: (rng, seed, how many objects of the relevant type) -> a task in which all of them begin free.
        practice: (rng, seed) -> a task with one object somewhere between trapped and free, or covered.
        expert: (state, goal) -> the skill sequence that a person would give: (skill name, objects) each.
    """

    name: str
    types: tuple[Type, ...]
    predicates: tuple[Predicate, ...]
    classifiers: Mapping[str, Callable[[State, tuple[Object, ...]], float]]
    operators: tuple[Operator, ...]
    scenarios: Mapping[str, Scenario]
    recovery: str
    relocate: Callable[[Task, Object, tuple[float, float, float], np.random.Generator], Task]
    dream: Callable[[np.random.Generator, int, int], Task]
    practice: Callable[[np.random.Generator, int], Task]
    expert: Callable[[State, Atoms], tuple[tuple[str, tuple[Object, ...]], ...]]

    def predicate(self, name: str) -> Predicate:
        for p in self.predicates:
            if p.name.lower() == name.lower():
                return p
        raise UnknownNameError("predicate", name, [p.name for p in self.predicates])

    def scenario(self, name: str) -> Scenario:
        if name not in self.scenarios:
            raise UnknownNameError(f"scenario of {self.name}", name, list(self.scenarios))
        return self.scenarios[name]

    def parse_goal(self, text: str, objects: tuple[Object, ...]) -> Atoms:
        """Atoms from text such as 'On(b1,b0), On(b2,b1)'. Raises UnknownNameError or PlanningError."""
        return parse_atoms(text, self.predicates, objects)


def parse_atoms(text: str, predicates: tuple[Predicate, ...], objects: tuple[Object, ...]) -> Atoms:
    """Read 'P(a,b), Q(c)' into atoms; names are case-insensitive for predicates, exact for objects."""
    import re

    from resync_robot.core.errors import PlanningError

    names = {p.name.lower(): p for p in predicates}
    known = {o.name: o for o in objects}
    found: list[Atom] = []
    rest = re.sub(r"([\w-]+)\s*\(([^()]*)\)", "", text)
    if rest.strip(" ,;&"):
        raise PlanningError(f"cannot read the goal '{text}'", 'write it as --goal "On(b1,b0)"')
    for name, inside in re.findall(r"([\w-]+)\s*\(([^()]*)\)", text):
        if name.lower() not in names:
            raise UnknownNameError("predicate", name, [p.name for p in predicates])
        args = [a.strip() for a in inside.split(",") if a.strip()]
        for a in args:
            if a not in known:
                raise UnknownNameError("object", a, list(known))
        found.append(names[name.lower()](*(known[a] for a in args)))
    if not found:
        raise PlanningError(f"the goal '{text}' names no atom", 'write it as --goal "On(b1,b0)"')
    return frozenset(found)
