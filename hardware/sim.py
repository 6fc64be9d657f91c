"""The simulated robot, gripper and cameras. The physics is handed in: this package knows no simulator."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from jaxtyping import Float

from resync_robot.core.world import CameraFrame, Cutout, Glimpse, Window
from resync_robot.hardware.base import SERVO_PERIOD, Connected, GripperState, RobotError, RobotState

DETECTED = 2e-3
"""m by which the pads must stop short of the request for an object to count as held; above the drive's own error."""


class Physics(Protocol):
    """What a simulator must offer to be driven like a robot.

    Attributes:
        period: s that one `step` advances; a whole number of servo periods.
        time: s simulated so far.
    """

    period: float
    time: float

    def drive(self, q: Float[np.ndarray, "6"], opening: float) -> None:
        """Set the targets of the joint drives (rad) and of the fingers (m between the pads)."""
        ...

    def step(self) -> None:
        """Advance by one period."""
        ...

    def measure(self) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6"], float, Float[np.ndarray, "3"]]:
        """q (rad), qd (rad/s), opening (m), force of the world on the hand (N, world frame)."""
        ...

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        """Cap the arm's joint torques (N m); None restores its own limits."""
        ...

    def render(self, camera: str) -> CameraFrame:
        """A picture from the camera of that name."""
        ...

    def render_window(self, camera: str, window: Window, size: int, error: Float[np.ndarray, "4 4"]) -> Cutout:
        """A part of its picture, from `error` beside where it stands, in the camera's own axes."""
        ...

    def render_colour(self, camera: str) -> Glimpse:
        """The colours of a picture from it."""
        ...


class SimGripper(Connected):
    """The fingers of the simulated hand."""

    def __init__(self, physics: Physics) -> None:
        self._physics = physics
        self.request = 0.0

    def connect(self) -> None:
        self.request = float(self._physics.measure()[2])

    def close(self) -> None:
        pass

    def state(self) -> GripperState:
        opening = float(self._physics.measure()[2])
        return GripperState(opening, object_detected=opening > self.request + DETECTED)

    def move(self, opening: float) -> None:
        self.request = opening


class SimRobot(Connected):
    """A robot whose clock runs on setpoints: every tick is 2 ms, and physics steps when a period is full.

    Args:
        physics: the simulator.
        gripper: the hand it carries; one is made when none is given.
    """

    def __init__(self, physics: Physics, gripper: SimGripper | None = None) -> None:
        self._physics = physics
        self.gripper = gripper or SimGripper(physics)
        self._ticks_per_step = round(physics.period / SERVO_PERIOD)
        if self._ticks_per_step < 1 or abs(self._ticks_per_step * SERVO_PERIOD - physics.period) > 1e-9:
            raise RobotError(f"a physics period of {physics.period} s; allowed: multiples of {SERVO_PERIOD} s")
        self._ticks = 0
        self._connected = False
        self._measured: RobotState | None = None

    def connect(self) -> None:
        self.gripper.connect()
        self._ticks, self._measured, self._connected = 0, None, True

    def close(self) -> None:
        self._connected = False

    def state(self) -> RobotState:
        """The measurement after the last physics step, stamped with the time of that step."""
        self._require_connection()
        if self._measured is None:
            q, qd, opening, tip_force = self._physics.measure()
            self._measured = RobotState(
                self._physics.time, np.array(q, float), np.array(qd, float), np.array(tip_force, float), float(opening)
            )
        return self._measured

    def servo(self, q: Float[np.ndarray, "6"], opening: float) -> None:
        self._require_connection()
        self.gripper.move(opening)
        self._ticks += 1
        if self._ticks == self._ticks_per_step:
            self._ticks = 0
            self._physics.drive(q, self.gripper.request)
            self._physics.step()
            self._measured = None

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        self._require_connection()
        self._physics.limit_effort(limit)

    def _require_connection(self) -> None:
        if not self._connected:
            raise RobotError("the simulated robot is not connected", "use it as `with SimRobot(physics) as robot:`")


class SimCamera(Connected):
    """One camera of the simulated scene."""

    def __init__(self, physics: Physics, name: str) -> None:
        self._physics = physics
        self._name = name

    @property
    def name(self) -> str:
        return self._name

    def connect(self) -> None:
        pass

    def close(self) -> None:
        pass

    def capture(self) -> CameraFrame:
        return self._physics.render(self._name)

    def cut_out(self, window: Window, size: int, error: Float[np.ndarray, "4 4"] | None = None) -> Cutout:
        return self._physics.render_window(self._name, window, size, np.eye(4) if error is None else error)

    def glimpse(self) -> Glimpse:
        return self._physics.render_colour(self._name)
