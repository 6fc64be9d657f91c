"""Fakes for the drivers, handed out as fixtures: simple enough to check by hand."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core.rig import Rig, load_rig
from resync_robot.core.world import CameraFrame
from resync_robot.hardware.base import Connected, RobotState


class LaggingPhysics:
    """Joints and fingers approach their targets with time constant `lag` s; `wall` stops the first joint there."""

    def __init__(self, q: np.ndarray, opening: float = 0.1, lag: float = 0.02, wall: float | None = None) -> None:
        self.period, self.time, self.lag, self.wall = 0.01, 0.0, lag, wall
        self.q, self.qd, self.opening = np.array(q, dtype=float), np.zeros(6), opening
        self.driven: list[tuple[np.ndarray, float]] = []

    def drive(self, q: np.ndarray, opening: float) -> None:
        self.driven.append((q.copy(), opening))

    def step(self) -> None:
        target, opening = self.driven[-1]
        share = 1 - np.exp(-self.period / self.lag)
        before = self.q.copy()
        self.q = self.q + share * (target - self.q)
        if self.wall is not None:
            self.q[0] = min(self.q[0], self.wall)
        self.qd = (self.q - before) / self.period
        self.opening += share * (opening - self.opening)
        self.time += self.period

    def measure(self) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
        pushed = self.wall is not None and self.q[0] >= self.wall
        return self.q, self.qd, self.opening, np.array([-10.0 * pushed, 0.0, 0.0])

    def render(self, camera: str) -> CameraFrame:
        grey = np.full((4, 6, 3), 128, np.uint8)
        depth = np.full((4, 6), 5000, np.uint16)
        return CameraFrame(camera, grey, depth, np.eye(3), np.eye(4), self.time)


class PerfectRobot(Connected):
    """Is at once where it is sent, and keeps every setpoint."""

    def __init__(self, q: np.ndarray, opening: float = 0.1) -> None:
        self.q, self.opening = np.array(q, dtype=float), opening
        self.sent: list[np.ndarray] = []
        self.openings: list[float] = []

    def connect(self) -> None:
        pass

    def close(self) -> None:
        pass

    def state(self) -> RobotState:
        return RobotState(0.002 * len(self.sent), self.q.copy(), np.zeros(6), np.zeros(3), self.opening)

    def servo(self, q: np.ndarray, opening: float) -> None:
        self.q, self.opening = q.copy(), opening
        self.sent.append(q.copy())
        self.openings.append(opening)


@pytest.fixture
def rig() -> Rig:
    return load_rig()


@pytest.fixture
def lagging_physics() -> type[LaggingPhysics]:
    return LaggingPhysics


@pytest.fixture
def perfect_robot() -> type[PerfectRobot]:
    return PerfectRobot
