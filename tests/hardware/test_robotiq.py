"""The gripper's driver against the emulated gripper, and against sockets that answer nonsense."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

from resync_robot.hardware.base import RobotError
from resync_robot.hardware.emulator.arm import KinematicArm
from resync_robot.hardware.emulator.gripper import EmulatedGripper
from resync_robot.hardware.emulator.server import Emulator
from resync_robot.hardware.robotiq import Robotiq
from tests import emulators

pytestmark = pytest.mark.realtime


@pytest.fixture
def machine() -> Iterator[Emulator]:
    with emulators.emulated(gripper=EmulatedGripper(0.1)) as emulator:
        yield emulator


def wait_for(condition: Callable[[], bool], seconds: float = 8.0) -> bool:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.02)
    return condition()


def test_it_activates_moves_and_grips(machine: Emulator) -> None:
    with Robotiq(machine.address) as gripper:
        assert gripper.state().opening == pytest.approx(0.1, abs=1e-3)
        gripper.move(0.03)
        assert wait_for(lambda: abs(gripper.state().opening - 0.03) < 1e-3)
        assert not gripper.state().object_detected
        gripper.move(0.12)
        assert wait_for(lambda: gripper.state().opening > 0.118)
        assert isinstance(machine.controller.arm, KinematicArm)
        machine.controller.arm.object_width = 0.06
        gripper.move(0.0)
        assert wait_for(lambda: gripper.state().object_detected)
        assert gripper.state().opening == pytest.approx(0.06, abs=1e-3)
        machine.controller.arm.object_width = 0.0
        assert wait_for(lambda: not gripper.state().object_detected)


def test_the_table_of_the_unit_is_used() -> None:
    gripper = Robotiq("127.0.0.1", table=((10, 0.1), (110, 0.05), (210, 0.0)))
    assert (gripper.count(0.1), gripper.count(0.05), gripper.count(0.025), gripper.count(0.0)) == (10, 110, 160, 210)
    assert gripper.opening(160) == pytest.approx(0.025)


@pytest.mark.parametrize(
    "arguments",
    [{"speed": 0.5}, {"speed": 0.0}, {"force": 2.0}],
)
def test_what_it_cannot_do_is_refused_at_once(arguments: dict[str, object]) -> None:
    with pytest.raises(RobotError):
        Robotiq("127.0.0.1", **arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize("opening", [float("nan"), -0.01, 0.5])
def test_openings_outside_are_refused(machine: Emulator, opening: float) -> None:
    with Robotiq(machine.address) as gripper, pytest.raises(RobotError, match="allowed"):
        gripper.move(opening)


def test_a_gripper_that_is_not_connected_takes_no_request(machine: Emulator) -> None:
    gripper = Robotiq(machine.address)
    for _ in range(2):
        for use in (gripper.state, lambda: gripper.move(0.05)):
            with pytest.raises(RobotError, match="not connected"):
                use()
        with gripper:
            gripper.move(0.05)


@pytest.mark.parametrize(("code", "word"), [(0xE, "current is too high"), (8, "too hot"), (99, "unknown kind")])
def test_a_fault_is_one_sentence(machine: Emulator, code: int, word: str) -> None:
    assert machine.gripper is not None
    with Robotiq(machine.address) as gripper:
        machine.gripper.fault = code

        def failed() -> bool:
            try:
                gripper.state()
            except RobotError as error:
                return word in error.what
            return False

        assert wait_for(failed)


def test_a_silent_gripper_is_an_emergency_stop(machine: Emulator) -> None:
    assert machine.gripper is not None
    machine.gripper.silent = True
    with pytest.raises(RobotError, match="emergency stop"):
        Robotiq(machine.address).connect()


@pytest.mark.parametrize("reply", [b"STA x\n", b"POS 3\n", b"STA 999\n", b"\xff" * 100, b"STA\n"])
def test_nonsense_is_one_error(reply: bytes) -> None:
    with emulators.stranger(reply) as port, pytest.raises(RobotError):
        Robotiq("127.0.0.1", port=port).connect()


def test_nobody_there(machine: Emulator) -> None:
    with pytest.raises(RobotError, match="no gripper at"):
        Robotiq("127.0.0.1", port=1).connect()
