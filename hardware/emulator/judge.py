"""Judges what an emulated controller is sent, setpoint by setpoint as it arrives, by the limits of an arm."""

from __future__ import annotations

from collections import deque

import numpy as np
from jaxtyping import Float

from resync_robot.core.joints import ARM_JOINTS
from resync_robot.core.rig import ArmRig
from resync_robot.hardware.base import SERVO_PERIOD

ROUNDING = 1e-6
"""Relative; of a third difference over 2 ms."""
KEPT = 100
"""Sentences."""


class Judge:
    """Knows nothing of the client: position, velocity, acceleration and jerk are those of what came over the wire.

    Args:
        arm: whose limits count.

    Attributes:
        count: setpoints judged.
        broken: how many of them were outside a limit.
        reasons: a sentence for each of the last of those.
        worst: largest share of its limit that each quantity had.
    """

    def __init__(self, arm: ArmRig) -> None:
        self._joint_limit = arm.kinematics.joint_limit
        self._rates = (
            ("velocity", arm.velocity_limit), ("acceleration", arm.acceleration_limit), ("jerk", arm.jerk_limit),
        )  # fmt: skip
        self._past = np.zeros((3, 6))
        self.count, self.broken = 0, 0
        self.reasons: deque[str] = deque(maxlen=KEPT)
        self.worst = dict.fromkeys(("position", *(name for name, _ in self._rates)), 0.0)

    def begin(self, q: Float[np.ndarray, "6"]) -> None:
        """A program starts, with the arm at rest at `q` (rad), as its client measures it: there it has to begin."""
        self._past = np.repeat(q[None], 3, axis=0)

    def take(self, q: Float[np.ndarray, "6"]) -> None:
        """Judge the next setpoint (rad)."""
        self.count += 1
        before = self.broken
        self._look("position", q, self._joint_limit)
        motion = np.concatenate([self._past, q[None]])
        self._past = motion[1:]
        for name, limit in self._rates:
            motion = np.diff(motion, axis=0) / SERVO_PERIOD
            self._look(name, motion[-1], limit)
        self.broken = min(self.broken, before + 1)

    def _look(self, name: str, value: np.ndarray, limit: np.ndarray) -> None:
        # What is not a number is beyond every limit.
        share = np.nan_to_num(np.abs(value) / limit, nan=np.inf)
        joint = int(share.argmax())
        self.worst[name] = max(self.worst[name], float(share[joint]))
        if share[joint] > 1 + ROUNDING:
            self.broken += 1
            self.reasons.append(
                f"setpoint {self.count}: {name} of {ARM_JOINTS[joint]} is {share[joint]:.4g} times its limit"
            )
