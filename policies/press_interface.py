"""How a recovery by pressing begins, sees and acts, where training steps scenes; `neural` runs the finished skill."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.joints import JointTarget
from resync_robot.core.kinematics import WORK_BRANCH
from resync_robot.core.rig import Rig
from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.core.world import ArmObservation
from resync_robot.learning.recovery_policy import (
    ACTION_SIZE,
    OBSERVATION_SIZE,
    PressVariety,
    commanded_tip,
    observe,
    project,
)
from resync_robot.policies.cartesian import Blocked, GeneratorPolicy, Hand, Motion, run_motion
from resync_robot.policies.grasp import travel_height
from resync_robot.policies.state_recovery import DECISION_STEPS, RATE_HZ, RecoverySkillSettings, approach, leave


@dataclass
class PressRun:
    """What one run remembers.

    Attributes:
        objects: robot, block, box.
        commanded: (3,) m, where the tip was sent last.
        lag: control steps that the arm is behind its commands.
        rotation: (3, 3) of the tool: down, and square to the box.
    """

    objects: tuple[Object, ...]
    commanded: Float[np.ndarray, "3"]
    lag: float
    rotation: Float[np.ndarray, "3 3"]


class PressInterface:
    """A `RecoveryInterface`: the closed hand over the block, its tip sent about in small steps."""

    features, actions, rate_hz = OBSERVATION_SIZE, ACTION_SIZE, RATE_HZ / DECISION_STEPS

    def __init__(self, rig: Rig, variety: PressVariety | None = None) -> None:
        s, v = RecoverySkillSettings(), variety or PressVariety()
        self._rig, self._lag = rig, v.lag
        self.effort_limit: tuple[float, ...] | None = s.effort_limit
        self._base_T_world = spatial.inverse(rig.arm.world_T_base)
        self._tip_T_flange = spatial.inverse(rig.gripper.flange_T_tip)

        def skill(name: str, motion: Callable[[tuple[Object, ...], ArmObservation], Motion]) -> Skill:
            def begin(objects: tuple[Object, ...], first: ArmObservation) -> GeneratorPolicy:
                return run_motion(motion(objects, first), first)

            return Skill(name, (ROBOT, BLOCK, BOX), begin, RATE_HZ, time_limit_s=45, effort_limit=s.effort_limit)

        self.approach: Skill | None = skill("Approach", lambda objects, first: _approach(objects, first, rig, s, v))
        self.leave: Skill | None = skill("Leave", lambda _objects, first: _leave(first, rig, s))

    def begin(self, objects: tuple[Object, ...], state: State, rng: np.random.Generator) -> PressRun:
        robot, _, _ = objects
        pose = spatial.pose_from_features(state[robot][:7])
        return PressRun(objects, pose[:3, 3].copy(), self._lag * float(rng.random()), pose[:3, :3].copy())

    def see(self, runs: Sequence[PressRun], states: Sequence[State]) -> Float[np.ndarray, "n 19"]:
        return np.asarray(observe(self._projected(runs, states)).double().numpy())

    def act(
        self, runs: Sequence[PressRun], states: Sequence[State], actions: Float[np.ndarray, "n 3"]
    ) -> list[JointTarget]:
        action = torch.as_tensor(actions, dtype=torch.float32)
        goals = commanded_tip(self._projected(runs, states), action).double().numpy()
        poses = np.tile(np.eye(4), (len(runs), 1, 1))
        for run, goal, pose in zip(runs, goals, poses, strict=True):
            # Commands are ramps from one to the next; a late arm ends each step that share of the ramp behind.
            pose[:3, 3] = goal - run.lag * (goal - run.commanded)
            pose[:3, :3], run.commanded = run.rotation, goal
        home = self._rig.arm.home
        q = self._rig.arm.kinematics.inverse_branch(self._base_T_world @ poses @ self._tip_T_flange, WORK_BRANCH)
        q += 2 * np.pi * np.round((home - q) / (2 * np.pi))
        return [JointTarget(row, 0.0) for row in q]

    @staticmethod
    def _projected(runs: Sequence[PressRun], states: Sequence[State]) -> torch.Tensor:
        rows = []
        for run, state in zip(runs, states, strict=True):
            robot, block, box = run.objects
            rows.append(project(state, robot, block, box, run.commanded))
        return torch.cat(rows)


def _approach(
    objects: tuple[Object, ...], first: ArmObservation, rig: Rig, s: RecoverySkillSettings, v: PressVariety
) -> Motion:
    """Until the policy takes over, at a place that is drawn for this state."""
    _, block, box = objects
    rng = np.random.default_rng(first.state[block].view(np.uint64))
    s, aside = replace(s, approach_height=rng.uniform(*v.height)), rng.uniform(-v.aside, v.aside, 2)
    hand = Hand(rig, first, 1.0 / RATE_HZ, stray=np.inf)
    above = travel_height(first.state, carried=None)
    try:
        refused = yield from approach(hand, first.state, block, box, above, s, (float(aside[0]), float(aside[1])))
    except Blocked as blocked:
        return SkillOutcome(SkillEnd.BLOCKED, str(blocked))
    return refused or SkillOutcome(SkillEnd.DONE)


def _leave(first: ArmObservation, rig: Rig, s: RecoverySkillSettings) -> Motion:
    """As the finished skill ends."""
    hand = Hand(rig, first, 1.0 / RATE_HZ, stray=np.inf)
    try:
        yield from leave(hand, travel_height(first.state, carried=None), s)
    except Blocked as blocked:
        return SkillOutcome(SkillEnd.BLOCKED, str(blocked))
    return SkillOutcome(SkillEnd.DONE)
