"""The arms that the emulated controller can have: one of its own, and one in a simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float

from resync_robot.hardware.base import SERVO_PERIOD
from resync_robot.hardware.sim import Physics


@dataclass(frozen=True, slots=True)
class Measured:
    """Attributes: `q` (6,) rad, `qd` (6,) rad/s, `opening` m, `force` (3,) N of the world on the hand, world frame."""

    q: Float[np.ndarray, "6"]
    qd: Float[np.ndarray, "6"]
    opening: float
    force: Float[np.ndarray, "3"]


class PhysicsArm(Protocol):
    """What a controller and a gripper drive."""

    def tick(self, q: Float[np.ndarray, "6"], opening: float) -> None:
        """Advance by SERVO_PERIOD with the joints asked to be at `q` (rad) and the pads at `opening` (m)."""
        ...

    def measure(self) -> Measured: ...


class KinematicArm:
    """Follows its setpoints with a first-order lag, in empty space; the pads stop at `object_width`.

    Args:
        q: (6,) rad where it stands.
        opening: m between the pads.
        lag: time constant, s.
        object_width: m; what lies between the pads, 0 for nothing.
    """

    def __init__(
        self, q: Float[np.ndarray, "6"], opening: float = 0.1, lag: float = 0.01, object_width: float = 0.0
    ) -> None:
        self.q, self.qd, self.opening = np.array(q, dtype=float), np.zeros(6), opening
        self.object_width = object_width
        self.force = np.zeros(3)
        self._share = 1.0 - float(np.exp(-SERVO_PERIOD / lag))

    def tick(self, q: Float[np.ndarray, "6"], opening: float) -> None:
        step = self._share * (q - self.q)
        self.q, self.qd = self.q + step, step / SERVO_PERIOD
        self.opening = max(opening, min(self.opening, self.object_width)) if self.object_width else opening

    def measure(self) -> Measured:
        return Measured(self.q.copy(), self.qd.copy(), self.opening, self.force.copy())


class SimulatedArm:
    """A simulator's arm: its physics steps whenever a period of it is full of ticks."""

    def __init__(self, physics: Physics) -> None:
        self._physics = physics
        self._per_step = round(physics.period / SERVO_PERIOD)
        self._ticks = 0
        self._measured = self._measure()

    def tick(self, q: Float[np.ndarray, "6"], opening: float) -> None:
        self._ticks += 1
        if self._ticks >= self._per_step:
            self._ticks = 0
            self._physics.drive(q, opening)
            self._physics.step()
            self._measured = self._measure()

    def measure(self) -> Measured:
        """As after the last physics step."""
        return self._measured

    def _measure(self) -> Measured:
        q, qd, opening, force = self._physics.measure()
        return Measured(np.array(q, float), np.array(qd, float), float(opening), np.array(force, float))
