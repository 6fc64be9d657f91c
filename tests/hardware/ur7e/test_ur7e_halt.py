"""What is known of a robot that is steered no more, in every way in which that can come about, on an emulated one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from resync_robot.core.rig import Rig
from resync_robot.hardware.base import Halt, RobotError, StaleError
from resync_robot.hardware.emulator.controller import SafetyMode
from resync_robot.hardware.emulator.server import DASHBOARD_PORT, Emulator
from resync_robot.hardware.stream import Stream
from resync_robot.hardware.ur7e import Ur7e
from tests.hardware.ur7e.motions import during_motion, is_still, link_of, swing, wait_for

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).parents[3]


def close_dashboard(machine: Emulator) -> None:
    """Nobody listens there any more; the rest of the machine goes on."""
    for listener in [s for s in machine._listeners if s.getsockname()[1] == DASHBOARD_PORT]:
        del machine._listeners[listener]
        listener.close()


def mute(machine: Emulator) -> None:
    machine.mute = True


def freeze(machine: Emulator) -> None:
    machine.frozen = True


ALIVE: dict[str, Callable[[Emulator, Ur7e], object]] = {
    "the link crashes": lambda m, r: link_of(r).send_signal(signal.SIGSEGV),
    "the link is killed": lambda m, r: link_of(r).kill(),
    "the link hangs": lambda m, r: link_of(r).send_signal(signal.SIGSTOP),
    "the connection drops": lambda m, r: m.call(m.drop_link),
    "no data comes": lambda m, r: m.call(lambda: mute(m)),
    "the program is stopped": lambda m, r: m.call(lambda: m.controller.stop_program("on the teach pendant")),
    "an emergency stop": lambda m, r: m.call(lambda: m.controller.set_safety(SafetyMode.ROBOT_EMERGENCY_STOP)),
    "the gripper is gone": lambda m, r: m.call(m.drop_gripper),
}
"""Whatever happens here, the controller can still be asked."""
DEAD: dict[str, Callable[[Emulator, Ur7e], object]] = {
    "the controller is gone": lambda m, r: m.close(),
    "the controller is frozen": lambda m, r: m.call(lambda: freeze(m)),
    "the link is killed and there is no dashboard": lambda m, r: (
        m.call(lambda: close_dashboard(m)), link_of(r).kill(),
    ),
}  # fmt: skip
"""And here it cannot."""


@pytest.mark.parametrize("what", ALIVE)
def test_where_the_controller_answers_its_word_is_had(
    machine: Emulator, robot: Ur7e, rig: Rig, what: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with robot:
        error = during_motion(robot, rig, lambda: ALIVE[what](machine, robot))
        assert "has been stopped" not in str(error)
        assert robot.halt() is Halt.STOPPED
        assert machine.controller.program is None, "it is so"
    assert robot.halt() is Halt.STOPPED
    assert wait_for(lambda: is_still(machine))
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize("what", DEAD)
def test_where_it_does_not_nobody_says_that_the_robot_has_stopped(
    machine: Emulator,
    robot: Ur7e,
    rig: Rig,
    what: str,
    capfd: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    with robot:
        error = during_motion(robot, rig, lambda: DEAD[what](machine, robot))
        assert "stopped" not in str(error)
        assert robot.halt() is Halt.UNKNOWN
    assert robot.halt() is Halt.UNKNOWN
    machine.frozen = False
    warned = [record.getMessage() for record in caplog.records if record.name == "resync_robot.hardware.ur7e"]
    assert len(warned) == 1 and warned[0].startswith(f"{Halt.UNKNOWN.value} (")
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize("goes", [False, True], ids=["at rest", "in motion"])
def test_a_controller_that_goes_before_the_end_leaves_nothing_known(
    machine: Emulator, robot: Ur7e, rig: Rig, goes: bool
) -> None:
    """Without an error that anybody saw before: the program was to end in order."""
    with robot:
        stream = Stream(robot, rig)
        if goes:
            swing(stream, rig, 0.3)
        machine.close()
        assert robot.halt() is Halt.UNKNOWN


def test_a_controller_that_thaws_before_the_end_is_believed(machine: Emulator, robot: Ur7e, rig: Rig) -> None:
    with robot:
        error = during_motion(robot, rig, lambda: machine.call(lambda: freeze(machine)))
        assert isinstance(error, StaleError)
        machine.frozen = False
        assert robot.halt() is Halt.STOPPED


def test_a_program_that_stays_is_not_taken_for_stopped(
    machine: Emulator, robot: Ur7e, rig: Rig, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("resync_robot.hardware.dashboard.END_S", 0.0)
    monkeypatch.setattr(machine.controller, "stop_program", lambda why: None)
    with robot:
        process = link_of(robot)
        process.kill()
        assert wait_for(lambda: process.poll() is not None)
        # Its watchdog has not bitten yet.
        assert machine.controller.program is not None
        with pytest.raises(RobotError, match="SIGKILL"):
            robot.servo(rig.arm.home, 0.1)
        assert robot._halt is Halt.UNKNOWN
        # By the end it has.
        assert wait_for(lambda: machine.controller.program is None)
        assert robot.halt() is Halt.STOPPED
    assert not [record for record in caplog.records if record.name == "resync_robot.hardware.ur7e"]


def test_an_usual_end_is_known(machine: Emulator, robot: Ur7e, rig: Rig) -> None:
    with robot:
        swing(Stream(robot, rig), rig, 0.3)
        process, program = link_of(robot), machine.controller.program
        assert robot.halt() is Halt.STOPPED
    assert process.returncode == 0
    assert program is not None and program.ended.startswith("the client ended it")
    # What is asked for after the end is told by the last state that was heard.
    assert robot.clock() == pytest.approx(machine.controller.time, abs=1.0)


DRIVER = """
import sys, numpy as np
from resync_robot.hardware.base import RobotError
from resync_robot.hardware.robotiq import Robotiq
from resync_robot.hardware.stream import Stream
from resync_robot.hardware.ur7e import Ur7e
from resync_robot.core.joints import JointTarget
from tests import emulators
rig = emulators.rig_at(sys.argv[1])
try:
    with Ur7e(rig, Robotiq(sys.argv[1])) as robot:
        stream = Stream(robot, rig)
        for k in range(int(sys.argv[2])):
            q = rig.arm.home.copy()
            q[0] += 0.2 * np.sin(0.04 * k)
            stream.run(JointTarget(q, 0.1), 0.02)
            if k == 20:
                print(robot._link.process.pid, flush=True)
    print("done", stream.late)
except RobotError as error:
    print(error)
"""


@pytest.mark.parametrize("asleep", [False, True], ids=["Ctrl-Z", "the computer sleeps"])
def test_after_a_pause_nobody_blames_a_cable(machine: Emulator, asleep: bool) -> None:
    """A suspended driver has a link that holds the arm, and goes on; one whose link stood still as well has lost it."""
    process = subprocess.Popen(
        [sys.executable, "-c", DRIVER, machine.address, "60" if not asleep else "100000"],
        stdout=subprocess.PIPE, text=True, cwd=ROOT,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *(p for p in sys.path if p)])},
    )  # fmt: skip
    try:
        assert process.stdout is not None
        both = [process.pid, *([int(line)] if (line := process.stdout.readline()) and asleep else [])]
        for one in both:
            os.kill(one, signal.SIGSTOP)
        time.sleep(3.5)
        for one in reversed(both):
            os.kill(one, signal.SIGCONT)
        said = process.communicate(timeout=60)[0]
    finally:
        process.kill()
        process.wait()
    if asleep:
        assert said.startswith("this program stood still for ") and "start again" in said and "cable" not in said
    else:
        assert said.startswith("done ")
