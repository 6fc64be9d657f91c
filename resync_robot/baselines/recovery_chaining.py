"""Recovery Chaining (Vats et al. 2024): plan with the given model; when a skill fails, react with the recovery.

As in the paper's comparison it is given the same learned skills and failure detectors as this project's method. What it
lacks is a concept to plan with, so it meets each failure before it can do anything about it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch

from resync_robot.core.library import Library, Record
from resync_robot.core.skill import GroundSkill, Skill
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.task import Domain
from resync_robot.learning.recovery_policy import observe, project
from resync_robot.learning.relational_view import RelationalView
from resync_robot.learning.terminals import Terminal

Detector = Callable[[State, tuple[Object, ...]], float]
"""(state, the recovery's objects) -> the probability that the skill it mends fails from there: beta_F."""


@dataclass(frozen=True)
class RecoveryChaining:
    """A `Reaction` of `plan_and_execute`: the recovery whose detector is surest, for an object of the failed skill.

    Attributes:
        recoveries: each with its detector.
    """

    recoveries: tuple[tuple[Skill, Detector], ...]

    def __call__(self, failed: GroundSkill, state: State) -> GroundSkill | None:
        found = [
            (detects(state, objects), skill, objects)
            for skill, detects in self.recoveries
            for objects in _arguments(skill, failed, state)
        ]
        sure = [one for one in found if one[0] > 0.5]
        if not sure:
            return None
        _, skill, objects = max(sure, key=lambda one: one[0])
        return skill.ground(objects)


def _arguments(skill: Skill, failed: GroundSkill, state: State) -> list[tuple[Object, ...]]:
    """(robot, o^R, every o^F) for each argument of the failed skill that o^R can be, the last one first."""
    robot, relevant, *causes = skill.types
    found = []
    for about in (o for o in reversed(failed.objects) if o.type == relevant):
        objects = [state.of_type(robot)[0], about]
        for kind in causes:
            others = [o for o in state.of_type(kind) if o not in objects]
            if not others:
                break
            objects.append(min(others, key=lambda o: np.linalg.norm(state[o][:2] - state[about][:2])))
        if len(objects) == len(skill.types):
            found.append(tuple(objects))
    return found


def chaining(domain: Domain, library: Library, skills: Mapping[str, Skill]) -> RecoveryChaining:
    """The baseline with all that a library has learned. Raises LibraryError on a record without a detector.

    Args:
        skills: by name; the recoveries to run.
    """
    names = [stage.recovery for stage in library.stages]
    return RecoveryChaining(tuple((skills[n], detector_of(domain, library.skills[n])) for n in names))


def detector_of(domain: Domain, record: Record) -> Detector:
    """Of the failure that a recovery mends. Raises LibraryError where its record has none."""
    failed = _terminal(record, "failed")
    if domain.embodiment is None:
        return lambda state, objects: float(failed.probability(_of_corner(state, objects)))
    sees = int(record.meta["sees"])

    def detects(state: State, objects: tuple[Object, ...]) -> float:
        seen = torch.as_tensor(RelationalView(objects[:sees], domain.relations)(state), dtype=torch.float32)[None]
        return float(failed.probability(seen))

    return detects


def _of_corner(state: State, objects: tuple[Object, ...]) -> torch.Tensor:
    robot, block, box = objects
    return observe(project(state, robot, block, box, np.asarray(state.get(robot, "x", "y", "z"))))


def _terminal(record: Record, name: str) -> Terminal:
    prefix = f"{name}."
    weights = {k.removeprefix(prefix): v for k, v in record.tensors.items() if k.startswith(prefix)}
    return Terminal.from_record(Record(record.meta.get(name, {}), weights))
