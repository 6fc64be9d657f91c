"""Recovery Chaining (Vats et al. 2024): plan with the given model; when a skill fails, react with the recovery.

As in the paper's comparison it is given the same learned skill and failure detector as this project's method. What it
lacks is a concept to plan with, so it meets each failure before it can do anything about it.
"""

from __future__ import annotations

import numpy as np

from resync_robot.core.library import Record
from resync_robot.core.skill import GroundSkill, Skill
from resync_robot.core.state import State
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.learning.recovery_policy import observe, project
from resync_robot.learning.terminals import Terminal


class RecoveryChaining:
    """A `Reaction` of `plan_and_execute`.

    Args:
        recovery: the learned skill over (robot, block, box).
        record: its library record, which holds the failure detector beta of the failed skill.
    """

    def __init__(self, recovery: Skill, record: Record) -> None:
        self._recovery = recovery
        weights = {k.removeprefix("failed."): v for k, v in record.tensors.items() if k.startswith("failed.")}
        self._failed = Terminal.from_record(Record(record.meta.get("failed", {}), weights))

    def __call__(self, failed: GroundSkill, state: State) -> GroundSkill | None:
        robot, box = state.of_type(ROBOT)[0], state.of_type(BOX)[0]
        for block in (o for o in reversed(failed.objects) if o.type == BLOCK):
            seen = observe(project(state, robot, block, box, np.asarray(state.get(robot, "x", "y", "z"))))
            if float(self._failed.probability(seen)) > 0.5:
                return self._recovery.ground((robot, block, box))
        return None
