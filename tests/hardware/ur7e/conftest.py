"""An emulated machine, its rig and its driver, for every test here."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from resync_robot.core.rig import Rig
from resync_robot.hardware.emulator.server import Emulator
from resync_robot.hardware.robotiq import Robotiq
from resync_robot.hardware.ur7e import Ur7e
from tests import emulators


@pytest.fixture(autouse=True)
def client() -> None:
    emulators.need_client()


@pytest.fixture
def machine() -> Iterator[Emulator]:
    with emulators.emulated() as emulator:
        yield emulator


@pytest.fixture
def rig(machine: Emulator) -> Rig:
    return emulators.rig_at(machine.address)


@pytest.fixture
def robot(machine: Emulator, rig: Rig) -> Iterator[Ur7e]:
    robot = Ur7e(rig, Robotiq(machine.address))
    yield robot
    robot.close()
