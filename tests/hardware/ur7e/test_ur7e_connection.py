"""Whom the driver connects to, what it sets and verifies before anything moves, and at which pace it then plans."""

from __future__ import annotations

from dataclasses import replace

import pytest

from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig
from resync_robot.hardware.base import RobotError
from resync_robot.hardware.emulator.controller import ControllerSettings, RobotMode, SafetyMode
from resync_robot.hardware.emulator.server import Emulator
from resync_robot.hardware.robotiq import Robotiq
from resync_robot.hardware.stream import Stream
from resync_robot.hardware.ur7e import Ur7e
from tests import emulators
from tests.hardware.ur7e.motions import wait_for

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize(
    ("mode", "word"),
    [
        (SafetyMode.ROBOT_EMERGENCY_STOP, "release it and switch the arm on"),
        (SafetyMode.SYSTEM_EMERGENCY_STOP, "release it and switch the arm on"),
        (SafetyMode.SAFEGUARD_STOP, "safeguard"),
        (SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP, "safeguard"),
        (SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP, "enabling device"),
        (SafetyMode.VIOLATION, "safety limit was violated"),
        (SafetyMode.FAULT, "has a fault"),
        (SafetyMode.RECOVERY, "outside its safety limits"),
    ],
)
def test_no_connection_to_a_robot_that_must_not_move(
    machine: Emulator, robot: Ur7e, mode: SafetyMode, word: str
) -> None:
    machine.call(lambda: machine.controller.set_safety(mode))
    with pytest.raises(RobotError, match=word):
        robot.connect()
    assert machine.controller.uploads == 0
    # No software resets it.
    assert machine.controller.safety_mode is mode


def test_no_connection_without_power_or_in_local_control(machine: Emulator, robot: Ur7e) -> None:
    machine.call(lambda: machine.controller.power(RobotMode.IDLE))
    with pytest.raises(RobotError, match="brakes are on"):
        robot.connect()
    machine.call(lambda: machine.controller.power(RobotMode.RUNNING))
    machine.call(lambda: setattr(machine.controller, "remote", False))
    with pytest.raises(RobotError, match="local control"):
        robot.connect()
    assert machine.controller.uploads == 0


def test_no_connection_to_another_arm_than_the_rig_says(machine: Emulator, rig: Rig) -> None:
    other = replace(rig, arm=replace(rig.arm, model="ur10e"))
    with pytest.raises(RobotError, match=r"the controller's arm is a UR7, the rig file says UR10e"):
        Ur7e(other, Robotiq(machine.address)).connect()
    assert machine.controller.uploads == 0


def test_only_one_program_controls_the_robot(machine: Emulator, robot: Ur7e, rig: Rig) -> None:
    """And whoever is refused leaves the other one's program alone."""
    with robot:
        with pytest.raises(RobotError, match=r"another program controls|no control of"):
            Ur7e(rig, Robotiq(machine.address)).connect()
        assert machine.controller.uploads == 1
        assert machine.controller.program is not None
        robot.servo(robot.state().q, 0.1)


def test_payload_and_tcp_are_set_and_verified(machine: Emulator, robot: Ur7e, rig: Rig) -> None:
    with robot:
        assert rig.controller is not None
        assert machine.controller.payload == rig.controller.payload
        assert machine.controller.tcp[2] == rig.gripper.tip_offset


def test_a_controller_that_keeps_another_tcp_is_not_driven(
    machine: Emulator, robot: Ur7e, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        type(machine.controller), "tcp", property(lambda c: (0.0,) * 6, lambda c, v: None), raising=False
    )
    with pytest.raises(RobotError, match="TCP"):
        robot.connect()
    assert machine.controller.wire == []


def test_a_controller_that_keeps_another_payload_is_not_driven(
    machine: Emulator, robot: Ur7e, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(type(machine.controller), "payload", property(lambda c: 0.3, lambda c, v: None), raising=False)
    with pytest.raises(RobotError, match=r"payload \[0\.3, .* instead of \[1\.2"):
        robot.connect()
    assert machine.controller.wire == []
    assert wait_for(lambda: machine.controller.program is None)


@pytest.mark.parametrize(("slider", "mode", "fraction"), [(0.5, 1, 0.5), (1.0, 2, 0.5), (0.25, 1, 0.25)])
def test_the_slider_and_reduced_mode_stretch_the_plan(
    machine: Emulator, robot: Ur7e, rig: Rig, slider: float, mode: int, fraction: float
) -> None:
    machine.call(lambda: setattr(machine.controller, "slider", slider))
    machine.call(lambda: machine.controller.set_safety(SafetyMode(mode)))
    with robot:
        assert robot.speed_fraction() == pytest.approx(fraction)
        stream = Stream(robot, rig)
        wire = machine.controller.wire
        assert wire is not None
        wire.clear()
        for k in range(5):
            q = rig.arm.home.copy()
            q[0] += 0.004 * (k + 1)
            stream.run(JointTarget(q, 0.1), 0.02)
        stream.stop()
        assert wait_for(lambda: len(wire) >= 5 * round(0.02 / fraction / 0.002))


def test_a_slider_at_zero_is_named(machine: Emulator, robot: Ur7e, rig: Rig) -> None:
    machine.call(lambda: setattr(machine.controller, "slider", 0.0))
    with robot, pytest.raises(RobotError, match="slider"):
        Stream(robot, rig).run(JointTarget(rig.arm.home, 0.1), 0.02)


def test_nobody_there_is_one_sentence(rig: Rig) -> None:
    nowhere = emulators.rig_at(emulators.address())
    with pytest.raises(RobotError, match="no controller at"):
        Ur7e(nowhere, Robotiq("127.0.0.250")).connect()


def test_the_controllers_remote_check_sees_local_mode() -> None:
    with emulators.emulated(ControllerSettings(remote=False)) as machine:
        with pytest.raises(RobotError, match="local control"):
            Ur7e(emulators.rig_at(machine.address), Robotiq(machine.address)).connect()
        assert machine.controller.uploads == 0
