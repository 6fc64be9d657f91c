"""What goes wrong between the driver and a controller, brought about on an emulated one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from resync_robot.core.episode import read_episode
from resync_robot.core.episode_records import EpisodeMeta
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.rig import Rig
from resync_robot.hardware.base import (
    SERVO_PERIOD,
    Command,
    ProtectiveStopError,
    RobotError,
    RobotState,
    SafetyError,
    StaleError,
)
from resync_robot.hardware.emulator.controller import SafetyMode
from resync_robot.hardware.emulator.faults import FAULTS
from resync_robot.hardware.emulator.server import Emulator
from resync_robot.hardware.joint_moves import travel
from resync_robot.hardware.stream import Stream
from resync_robot.hardware.ur7e import Ur7e
from tests.hardware.ur7e.motions import during_motion, is_still, link_of, swing, wait_for

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize(
    ("fault", "word"),
    [
        ("emergency-stop", "emergency stop is pressed"),
        ("system-emergency-stop", "emergency stop of the system"),
        ("safeguard-stop", "safeguard"),
        ("automatic-safeguard-stop", "safeguard"),
        ("enabling-stop", "enabling device is not held"),
        ("recovery", "outside its safety limits"),
        ("violation", "VIOLATION"),
        ("safety-fault", "safety system has a fault"),
        ("program-stop", "control program was stopped"),
        ("local", "control program was stopped"),
        ("power-off", "control program was stopped"),
    ],
)
def test_a_stop_ends_the_motion_and_nothing_resumes_it(
    machine: Emulator, robot: Ur7e, rig: Rig, fault: str, word: str
) -> None:
    with robot:
        error = during_motion(robot, rig, lambda: machine.call(lambda: FAULTS[fault](machine)))
        assert word in str(error)
        assert wait_for(lambda: is_still(machine))
        uploads = machine.controller.uploads
        with pytest.raises(RobotError):
            robot.servo(robot.state().q, 0.1)
        # The cause goes away by itself: still nothing moves until somebody connects anew.
        machine.call(lambda: machine.controller.set_safety(SafetyMode.NORMAL))
        begin = machine.controller.time
        assert wait_for(lambda: machine.controller.time > begin + 0.3), "the emulated clock stands still"
        with pytest.raises(RobotError):
            robot.servo(rig.arm.home, 0.1)
    assert machine.controller.uploads == uploads == 1
    assert machine.controller.program is None


def test_a_protective_stop_is_acknowledged_after_5_s_and_begins_where_the_arm_is(
    machine: Emulator, robot: Ur7e, rig: Rig
) -> None:
    with robot:
        error = during_motion(robot, rig, lambda: machine.call(machine.controller.protective_stop))
        assert isinstance(error, ProtectiveStopError)
        stopped = machine.controller.time
        # Early: the controller refuses, and it stays locked.
        assert machine.call(machine.controller.unlock_protective_stop) is False
        robot.acknowledge_stop()
        assert machine.controller.time - stopped >= 5.0
        assert machine.controller.safety_mode is SafetyMode.NORMAL
        here = robot.state().q
        stream = Stream(robot, rig)
        before = len(machine.controller.wire or [])
        stream.run(stream.target, 0.1)
        wire = machine.controller.wire or []
        assert len(wire) > before
        np.testing.assert_allclose(wire[before][1], here, atol=1e-6)


def test_an_acknowledgement_that_comes_too_early_is_an_error(
    machine: Emulator, robot: Ur7e, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("resync_robot.hardware.ur7e.UNLOCK_AFTER_S", 0.5)
    with robot:
        during_motion(robot, rig, lambda: machine.call(machine.controller.protective_stop))
        with pytest.raises(ProtectiveStopError, match="was not released: Cannot unlock"):
            robot.acknowledge_stop()
        assert machine.controller.safety_mode is SafetyMode.PROTECTIVE_STOP
        # Once it is old enough, the same robot takes it.
        monkeypatch.undo()
        robot.acknowledge_stop()
        assert machine.controller.safety_mode is SafetyMode.NORMAL
        assert robot.state().time > 5.0


def test_a_stop_that_stays_locked_is_an_error(
    machine: Emulator, robot: Ur7e, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    with robot:
        during_motion(robot, rig, lambda: machine.call(machine.controller.protective_stop))
        monkeypatch.setattr(machine.controller, "unlock_protective_stop", lambda: True)
        with pytest.raises(ProtectiveStopError, match="stays locked"):
            robot.acknowledge_stop()
        with pytest.raises(RobotError, match="not connected"):
            robot.servo(rig.arm.home, 0.1)
    assert machine.controller.uploads == 1


def test_a_second_protective_stop_waits_again(machine: Emulator, robot: Ur7e, rig: Rig) -> None:
    with robot:
        during_motion(robot, rig, lambda: machine.call(machine.controller.protective_stop))
        robot.acknowledge_stop()
        travel(Stream(robot, rig), rig.arm.home)
        during_motion(robot, rig, lambda: machine.call(machine.controller.protective_stop))
        stopped = machine.controller.time
        robot.acknowledge_stop()
        assert machine.controller.time - stopped >= 5.0
        assert machine.controller.protective_stops == 2


def test_silence_of_the_controller_stops_the_motion(machine: Emulator, robot: Ur7e, rig: Rig) -> None:
    """Data stops, but what we send would still be obeyed: the arm must get nothing more."""
    muted: list[float] = []
    moving = [0.0]

    def watch(emulator: Emulator) -> None:
        if np.abs(emulator.controller.velocity).max() > 1e-9:
            moving[0] = emulator.controller.time

    def mute() -> None:
        machine.mute = True
        muted.append(machine.controller.time)

    machine.call(lambda: machine.every_tick.append(watch))
    with robot:
        error = during_motion(robot, rig, lambda: machine.call(mute))
        assert isinstance(error, StaleError)
        assert rig.controller is not None
        assert wait_for(lambda: machine.controller.time > moving[0] + 0.2), "the emulated clock stands still"
        # On the emulator's own clock.
        assert muted[0] < moving[0] <= muted[0] + rig.controller.freshness + 0.050
        assert is_still(machine)
        with pytest.raises(StaleError):
            robot.state()


def test_a_frozen_controller_is_noticed(machine: Emulator, robot: Ur7e, rig: Rig) -> None:
    with robot:
        began = time.monotonic()
        error = during_motion(robot, rig, lambda: setattr(machine, "frozen", True))
        assert isinstance(error, StaleError)
        assert time.monotonic() - began < 5.0
        machine.frozen = False
    assert wait_for(lambda: machine.controller.program is None)


def test_a_controller_that_is_switched_off_is_one_error_and_no_zombie(machine: Emulator, robot: Ur7e, rig: Rig) -> None:
    with robot:
        process = link_of(robot)
        began = time.monotonic()
        error = during_motion(robot, rig, machine.close)
        assert isinstance(error, StaleError)
        assert time.monotonic() - began < 8.0
        with pytest.raises(RobotError):
            robot.servo(rig.arm.home, 0.1)
    assert process.poll() is not None


def test_a_dropped_link_is_one_error_one_upload_and_no_zombie(machine: Emulator, robot: Ur7e, rig: Rig) -> None:
    with robot:
        process = link_of(robot)
        error = during_motion(robot, rig, lambda: machine.call(machine.drop_link))
        assert isinstance(error, StaleError)
        assert wait_for(lambda: machine.controller.program is None)
        time.sleep(0.5)
    # The client may hang in its attempts to reconnect, for longer than the driver waits.
    assert process.poll() is not None, "reaped, not left as a zombie"
    assert machine.controller.uploads == 1
    assert machine.controller.program is None
    assert is_still(machine)


def test_a_dropped_link_leaves_a_whole_recording(machine: Emulator, robot: Ur7e, rig: Rig, tmp_path: Path) -> None:
    meta = EpisodeMeta.of(rig, library_hash="", domain="", scenario="", goal="", seed=0, backend="ur7e")
    times: list[float] = []
    with robot, EpisodeWriter(tmp_path / "episode.mcap", meta) as writer:

        def record(state: RobotState, command: Command) -> None:
            times.append(state.time)
            writer.joints(state.time, state.q, state.qd, state.opening, command.sent, command.requested)

        during_motion(robot, rig, lambda: machine.call(machine.drop_link), [record])
        dropped = robot.clock()
    episode = read_episode(tmp_path / "episode.mcap")
    assert episode.damage is None
    np.testing.assert_allclose([joints.time for joints in episode.joints()], times, atol=1e-6)
    assert len(times) > 20 and times[-1] > dropped - 2.0


def test_a_killed_link_process_is_noticed(machine: Emulator, robot: Ur7e, rig: Rig) -> None:
    with robot:
        process = link_of(robot)
        error = during_motion(robot, rig, lambda: process.send_signal(signal.SIGSEGV))
        assert "SIGSEGV" in str(error)
        assert wait_for(lambda: is_still(machine) and machine.controller.program is None)


DRIVER = """
import sys, numpy as np
from resync_robot.hardware.robotiq import Robotiq
from resync_robot.hardware.stream import Stream
from resync_robot.hardware.joint_moves import travel
from resync_robot.hardware.ur7e import Ur7e
from resync_robot.core.joints import JointTarget
from tests import emulators
rig = emulators.rig_at(sys.argv[1])
with Ur7e(rig, Robotiq(sys.argv[1])) as robot:
    stream = Stream(robot, rig)
    for k in range(100000):
        q = rig.arm.home.copy()
        q[0] += 0.2 * np.sin(0.04 * k)
        stream.run(JointTarget(q, 0.1), 0.02)
        if k == 20:
            print("moving", robot._link.process.pid, flush=True)
"""


@pytest.mark.parametrize("link_too", [False, True], ids=["driver", "driver and link"])
def test_a_killed_client_leaves_the_robot_stopped(machine: Emulator, link_too: bool) -> None:
    """With the link alive it brakes and ends its program; without, the controller's own watchdog has to."""
    process = subprocess.Popen(
        [sys.executable, "-c", DRIVER, machine.address], stdout=subprocess.PIPE, text=True, cwd=ROOT,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *(p for p in sys.path if p)])},
    )  # fmt: skip
    try:
        assert process.stdout is not None
        link = int(process.stdout.readline().split()[1])
        program = machine.controller.program
        assert program is not None
        process.kill()
        if link_too:
            os.kill(link, signal.SIGKILL)
        assert wait_for(lambda: machine.controller.program is None, 5.0)
        assert wait_for(lambda: is_still(machine), 2.0)
        assert program.ended.startswith("watchdog" if link_too else "the client ended it")
    finally:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


@pytest.mark.parametrize(
    ("fault", "word"),
    [
        ("gripper-silent", "emergency stop"),
        ("gripper-fault", "current is too"),
        ("gripper-gone", "ended the conversation"),
    ],
)
def test_a_gripper_in_trouble_ends_the_motion(machine: Emulator, robot: Ur7e, rig: Rig, fault: str, word: str) -> None:
    with robot:
        error = during_motion(robot, rig, lambda: machine.call(lambda: FAULTS[fault](machine)))
        assert word in str(error)
        assert wait_for(lambda: is_still(machine)), "it brakes along the way that was sent with the last setpoints"


def test_too_much_force_stops_the_stream(machine: Emulator, robot: Ur7e, rig: Rig) -> None:
    with robot:
        stream = Stream(robot, rig)
        swing(stream, rig, 0.2)
        machine.controller.arm.force[:] = (0.0, 0.0, 400.0)  # type: ignore[attr-defined]
        with pytest.raises(SafetyError, match="force") as caught:
            swing(stream, rig, 2.0, begin=0.2)
        assert caught.value.quantity == "force"
        assert wait_for(lambda: is_still(machine))


def test_a_knock_is_braked_for_within_a_few_ticks(machine: Emulator, robot: Ur7e, rig: Rig) -> None:
    """10 ms of force, which who looks once in 0.1 s does not see; on the emulator's clock."""
    knocked: list[float] = []

    def knock(emulator: Emulator) -> None:
        moving = abs(emulator.controller.velocity[0]) > 0.3
        if knocked or moving:
            knocked.append(emulator.controller.time)
            emulator.controller.arm.force[2] = 400.0 * (len(knocked) <= 5)  # type: ignore[attr-defined]

    with robot:
        stream = Stream(robot, rig)
        swing(stream, rig, 0.2)
        machine.call(lambda: machine.every_tick.append(knock))
        with pytest.raises(SafetyError, match="feels 400 N"):
            swing(stream, rig, 4.0, begin=0.2)
        assert wait_for(lambda: is_still(machine))
        wire = machine.controller.wire or []
    times, speed = np.array([t for t, _ in wire[1:]]), np.diff([q[0] for _, q in wire]) / SERVO_PERIOD
    after = times > knocked[0]
    fastest = times[after][np.argmax(np.abs(speed[after]))]
    assert fastest - knocked[0] < 0.030
    assert times[np.abs(speed) > 1e-6][-1] - knocked[0] < 0.150
