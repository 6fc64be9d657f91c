"""Sockets and clock of the emulator."""

from __future__ import annotations

import socket
import time

import numpy as np
import pytest

from resync_robot.core.errors import ConfigError, UnknownNameError
from resync_robot.core.rig import load_rig
from resync_robot.hardware.base import RobotError
from resync_robot.hardware.emulator.arm import KinematicArm
from resync_robot.hardware.emulator.controller import Controller
from resync_robot.hardware.emulator.faults import FAULTS, FaultPlan, PlannedFault, parse_fault
from resync_robot.hardware.emulator.server import DASHBOARD_PORT, GRIPPER_PORT, RTDE_PORT, Emulator
from tests import emulators

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize(("where", "word"), [("0.0.0.0", "loopback"), ("192.0.2.1", "loopback"), ("here", "IPv4")])
def test_only_loopback_is_listened_on(where: str, word: str) -> None:
    with pytest.raises(RobotError, match=word):
        Emulator(Controller(KinematicArm(load_rig().arm.home)), where)


def test_elsewhere_it_listens_only_where_it_is_told_to() -> None:
    """An address that is no machine's: it gets as far as the operating system."""
    with pytest.raises(RobotError, match=r"cannot listen on 192\.0\.2\.1"):
        Emulator(Controller(KinematicArm(load_rig().arm.home)), "192.0.2.1", anywhere=True)


def test_a_taken_port_is_named_and_nothing_stays_open() -> None:
    with emulators.emulated() as emulator:
        with pytest.raises(RobotError, match="30004"):
            Emulator(Controller(KinematicArm(load_rig().arm.home)), emulator.address)
        listening = [s.getsockname()[0] for s in emulator._listeners]
        assert set(listening) == {emulator.address}
    with pytest.raises(OSError):
        socket.create_connection((emulator.address, RTDE_PORT), 0.5)


def test_the_clock_keeps_wall_time_up_to_what_it_says_it_lost() -> None:
    with emulators.emulated() as emulator:
        begin, wall = emulator.controller.time, time.monotonic()
        time.sleep(1.0)
        passed = emulator.controller.time - begin
        elapsed = time.monotonic() - wall
    assert passed <= elapsed + 0.06
    assert passed + emulator.behind_s >= elapsed - 0.06 - 0.05


def test_clients_that_talk_nonsense_are_cut_off_and_the_clock_goes_on() -> None:
    rng = np.random.default_rng(3)
    with emulators.emulated() as emulator:
        for port in (RTDE_PORT, DASHBOARD_PORT, GRIPPER_PORT):
            for _ in range(10):
                with socket.create_connection((emulator.address, port), 2.0) as sock:
                    sock.sendall(b"\x00\x01" + rng.bytes(3000))
        deadline = time.monotonic() + 5.0
        while emulator.malformed < 10 and time.monotonic() < deadline:
            time.sleep(0.02)
        assert emulator.malformed >= 10
        before, deadline = emulator.controller.ticks, time.monotonic() + 5.0
        while emulator.controller.ticks == before and time.monotonic() < deadline:
            time.sleep(0.02)
        assert emulator.controller.ticks > before
        assert emulator.call(lambda: emulator.controller.uploads) == 0


def test_what_a_call_raises_comes_back_to_the_caller() -> None:
    def fail() -> None:
        raise ConfigError("no")

    with emulators.emulated() as emulator, pytest.raises(ConfigError):
        emulator.call(fail)


@pytest.mark.parametrize(
    ("text", "fault"), [("freeze", PlannedFault("freeze", 5.0)), ("local@2.5", PlannedFault("local", 2.5))]
)
def test_faults_are_read(text: str, fault: PlannedFault) -> None:
    assert parse_fault(text) == fault


@pytest.mark.parametrize(("text", "error"), [("fire", UnknownNameError), ("freeze@soon", ConfigError)])
def test_what_is_no_fault_is_refused(text: str, error: type[Exception]) -> None:
    with pytest.raises(error):
        parse_fault(text)


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_happens_once_after_its_time_of_running_program(name: str) -> None:
    with emulators.emulated() as emulator:
        plan = FaultPlan([PlannedFault(name, 0.0)])
        emulator.call(lambda: plan(emulator))
        assert plan.happened == []
        emulator.call(lambda: emulator.controller.start_program("def rtde_control():\nend"))
        emulator.call(lambda: plan(emulator))
        emulator.frozen = False
        emulator.call(lambda: plan(emulator))
        assert [n for _, n in plan.happened] == [name]
