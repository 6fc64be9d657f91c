"""Every backend's arm, gripper and camera, handed out under one name each.

A recording is none of them: its arm goes where it went. What it owes is in `test_motions_contract.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest

from resync_robot.core.rig import Rig, load_rig
from resync_robot.core.world import CameraFrame
from resync_robot.hardware.base import Gripper, Robot
from resync_robot.hardware.emulator.arm import KinematicArm
from resync_robot.hardware.robotiq import Robotiq
from resync_robot.hardware.sim import SimGripper, SimRobot
from resync_robot.hardware.ur7e import Ur7e
from tests import emulators

OPEN = 5 / 7
"""Share of the gripper's widest opening at which it stands."""


class KinematicPhysics:
    """A `resync_robot.hardware.sim.Physics` in empty space."""

    def __init__(self, arm: KinematicArm) -> None:
        self.period, self.time, self.arm = 0.01, 0.0, arm
        self._target = arm.measure().q, arm.measure().opening

    def drive(self, q: np.ndarray, opening: float) -> None:
        self._target = q.copy(), opening

    def step(self) -> None:
        for _ in range(5):
            self.arm.tick(*self._target)
        self.time += self.period

    def measure(self) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
        m = self.arm.measure()
        return m.q, m.qd, m.opening, m.force

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        pass

    def render(self, camera: str) -> CameraFrame:
        return CameraFrame(
            camera, np.zeros((4, 6, 3), np.uint8), np.full((4, 6), 5000, np.uint16), np.eye(3), np.eye(4), self.time
        )


@dataclass
class Backend:
    """Attributes: `robot`, not connected yet; `gripper` of it; `rig`; the kinematic `arm` behind it all."""

    name: str
    robot: Robot
    gripper: Gripper
    rig: Rig
    arm: KinematicArm

    def share(self, share: float) -> float:
        """m; that much of the widest opening."""
        return share * self.rig.gripper.max_opening


@contextmanager
def sim() -> Iterator[Backend]:
    rig = load_rig()
    arm = KinematicArm(rig.arm.home, 0.1)
    physics = KinematicPhysics(arm)
    gripper = SimGripper(physics)
    yield Backend("sim", SimRobot(physics, gripper), gripper, rig, arm)


@contextmanager
def ur7e(rig: Rig | None = None) -> Iterator[Backend]:
    emulators.need_client()
    rig = rig or load_rig(emulators.RIG_FILE)
    with emulators.emulated(opening=OPEN * rig.gripper.max_opening, rig=rig) as emulator:
        rig = emulators.rig_at(emulator.address, rig)
        gripper = Robotiq(emulator.address, rig.controller.gripper_table, model=rig.gripper.facts)
        arm = emulator.controller.arm
        assert isinstance(arm, KinematicArm)
        robot = Ur7e(rig, gripper)
        yield Backend("ur7e", robot, gripper, rig, arm)
        robot.close()


SISTERS = ("ur3e", "ur5e", "ur10e", "ur16e")
"""Each with a 2F-85; the UR12e is a UR10e."""
BACKENDS = {"sim": sim, "ur7e": ur7e} | {
    model: partial(lambda model: ur7e(emulators.sister(model)), model) for model in SISTERS
}


@pytest.fixture(params=["sim", *(pytest.param(name, marks=pytest.mark.realtime) for name in ("ur7e", *SISTERS))])
def backend(request: pytest.FixtureRequest) -> Iterator[Backend]:
    with BACKENDS[request.param]() as made:
        yield made
