"""Our end of the dashboard, against the emulated one and against strangers."""

from __future__ import annotations

import socket

import pytest

from resync_robot.core.machines import ARMS
from resync_robot.hardware.base import RobotError
from resync_robot.hardware.dashboard import Dashboard
from tests import emulators


def test_a_ready_robot_is_ready() -> None:
    with emulators.emulated() as machine, Dashboard(machine.address) as dashboard:
        dashboard.require_ready()
        assert (dashboard.mode(), dashboard.safety()) == ("RUNNING", "NORMAL")


def test_the_arm_must_have_the_lengths_that_the_rig_says() -> None:
    """A UR7e is a UR5e in that; a name that is not known proves nothing."""
    with emulators.emulated() as machine, Dashboard(machine.address) as dashboard:
        for name in ("ur7e", "ur5e"):
            dashboard.require_arm(ARMS[name])
        for name in ("ur3e", "ur10e", "ur16e"):
            with pytest.raises(RobotError, match=rf"is a UR7, the rig file says {ARMS[name].title}\n.*\"ur7e\""):
                dashboard.require_arm(ARMS[name])
    with emulators.stranger(b"UR99\n") as port, Dashboard("127.0.0.1", port, timeout=0.5) as dashboard:
        dashboard.require_arm(ARMS["ur3e"])


@pytest.mark.parametrize(
    ("reply", "close"),
    [(b"hello\n", False), (b"x" * 8000, False), (b"", True), (b"\xff\xfe\n", False)],
    ids=["another server", "no end", "gone", "no text"],
)
def test_a_stranger_is_one_error(reply: bytes, close: bool) -> None:
    with (
        emulators.stranger(reply, close) as port,
        pytest.raises(RobotError),
        Dashboard("127.0.0.1", port, timeout=0.5) as dashboard,
    ):
        dashboard.require_ready()


def test_a_silent_server_is_one_error_in_time() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener, pytest.raises(RobotError, match="does not answer"):
        Dashboard("127.0.0.1", listener.getsockname()[1], timeout=0.2).connect()


def test_it_must_be_connected() -> None:
    with pytest.raises(RobotError, match="not connected"):
        Dashboard("127.0.0.1").ask("robotmode")


def test_a_program_is_stopped_only_by_the_controllers_own_word(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("resync_robot.hardware.dashboard.END_S", 0.2)
    with emulators.emulated() as machine, Dashboard(machine.address) as dashboard:
        assert dashboard.stop_program(), "none runs"
        machine.call(lambda: machine.controller.start_program("rtde_control"))
        # As in local control, where the order is refused.
        machine.call(lambda: setattr(machine.controller, "remote", False))
        assert not dashboard.stop_program() and machine.controller.program is not None
        machine.call(lambda: setattr(machine.controller, "remote", True))
        assert dashboard.stop_program() and machine.controller.program is None


def test_another_server_stops_no_program() -> None:
    with (
        emulators.stranger(b"Stopped\n") as port,
        Dashboard("127.0.0.1", port, timeout=0.5) as dashboard,
        pytest.raises(RobotError, match="is this a UR controller"),
    ):
        dashboard.stop_program()
