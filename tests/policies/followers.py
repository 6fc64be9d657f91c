"""An arm that is at once where it is sent, among objects that nothing moves."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig, load_rig
from resync_robot.core.state import State
from resync_robot.core.world import ArmObservation
from tests.scenes import R

RIG = load_rig()


@dataclass
class Follower:
    """A `World`; with `stuck` the arm stays where it is, `force` (3,) N is felt at the tip, and the pads close no
    further than `between`."""

    scene: State
    rig: Rig = RIG
    arm: np.ndarray = field(default_factory=lambda: RIG.arm.home.copy())
    opening: float = RIG.gripper.max_opening
    told: float | None = None
    force: np.ndarray = field(default_factory=lambda: np.zeros(3))
    stuck: bool = False
    between: float = 0.0
    time: float = 0.0
    limits: list[tuple[float, ...] | None] = field(default_factory=list)
    tips: list[np.ndarray] = field(default_factory=list)

    def observe(self, live: bool = False) -> ArmObservation:
        features = {o: self.scene[o] for o in self.scene} | {R: self.rig.robot_features(self.arm, self.opening)}
        told = self.opening if self.told is None else self.told
        return ArmObservation(
            time=self.time,
            state=State(features),
            arm=self.arm,
            arm_velocity=np.zeros(6),
            opening=self.opening,
            commanded_opening=told,
            tip_force=self.force,
        )

    def perceive(self) -> State:
        return self.observe().state

    def act(self, target: JointTarget, duration: float) -> None:
        self.time += duration
        if not self.stuck:
            self.arm, self.opening = target.arm.copy(), max(target.opening, self.between)
            self.told = target.opening
        self.tips.append(self.rig.tip_pose(self.arm)[:3, 3])

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        self.limits.append(limit)
