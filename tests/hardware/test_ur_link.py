"""The link's process and the driver around it, with a client that does what the test says: no controller is needed."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig
from resync_robot.hardware.base import (
    SERVO_PERIOD,
    Command,
    Connected,
    GripperState,
    Halt,
    RealtimeRobot,
    RobotError,
    SafetyError,
    StaleError,
)
from resync_robot.hardware.safety import Guard
from resync_robot.hardware.stream import PIECE, Stream
from resync_robot.hardware.ur7e import Ur7e
from resync_robot.hardware.ur_memory import SNAPSHOT, LinkMemory
from resync_robot.hardware.ur_process import LinkProcess
from tests import emulators
from tests.hardware.adversary import assert_nothing_out_of_limits

CLIENT = Path(__file__).parent / "client"


class Hand(Connected):
    """A gripper that is wherever it is sent."""

    opening = 0.1

    def connect(self) -> None: ...

    def close(self) -> None: ...

    def state(self) -> GripperState:
        return GripperState(self.opening, object_detected=False)

    def move(self, opening: float) -> None:
        self.opening = opening


class Lab:
    """Drivers with the stand-in for their client, and what that was sent."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self._log = folder / "sent"
        monkeypatch.syspath_prepend(CLIENT)
        monkeypatch.setenv("CLIENT_LOG", str(self._log))
        monkeypatch.setenv("CLIENT_Q", " ".join(map(str, self.rig(5.0).arm.home)))
        self._monkeypatch = monkeypatch
        self.stopped: list[str] = []
        self.knowledge = Halt.STOPPED
        """What an attempt to stop the program on the dashboard leaves."""
        self.drivers: list[Ur7e] = []

    @staticmethod
    def rig(freshness: float) -> Rig:
        """With slow first runs confirmed, and time enough for a busy machine."""
        return emulators.rig_at("127.0.0.1", freshness=freshness, lead=0.08)

    def connect(self, fault: str = "", freshness: float = 5.0) -> Ur7e:
        """A driver whose link has begun."""
        self._monkeypatch.setenv("CLIENT_FAULT", fault)
        driver = Ur7e(self.rig(freshness), Hand())
        driver._link = LinkProcess("127.0.0.1", driver._settings(), self._stop_program)
        self.drivers.append(driver)
        return driver

    def _stop_program(self) -> Halt:
        self.stopped.append("program")
        return self.knowledge

    def lines(self) -> list[str]:
        return self._log.read_text().splitlines()

    def wire(self) -> list[np.ndarray]:
        return [np.array([float(x) for x in line.split()]) for line in self.lines() if line != "end"]


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    lab = Lab(tmp_path, monkeypatch)
    yield lab
    for driver in lab.drivers:
        driver.close()


def turned(rig: Rig, angle: float) -> JointTarget:
    q = rig.arm.home.copy()
    q[0] += angle
    return JointTarget(q, 0.1)


def wait_for(condition: Callable[[], bool], seconds: float = 10.0) -> bool:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.005)
    return condition()


def test_a_writer_that_dies_at_any_moment_leaves_a_whole_snapshot() -> None:
    file = LinkMemory.new_file()
    memory, rng = LinkMemory(file), np.random.default_rng(0)
    os.close(file)
    for _ in range(30):
        child = os.fork()
        if child == 0:
            now = np.zeros((), SNAPSHOT)
            while True:
                now["time"] += 1.0
                now["q"] = now["heard"] = now["time"]
                memory.publish(now)
        time.sleep(rng.uniform(0.001, 0.005))
        for alive in (True, False):
            if not alive:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
            seen = memory.snapshot()
            assert (seen["q"] == seen["time"]).all() and seen["heard"] == seen["time"]
    assert seen["time"] > 0


def recorded(lab: Lab, driver: Ur7e, limit: tuple[float, ...] | None, goal: JointTarget) -> list[Command]:
    """What recorders are told while the arm is asked to go to `goal` and to stay there."""
    commands: list[Command] = []
    stream = Stream(driver, lab.rig(5.0), recorders=[lambda state, command: commands.append(command)])
    if limit is not None:
        stream.limit_effort(limit)
    for _ in range(2):
        commands.append(stream.run(goal, 0.5))
    return commands


def assert_recorded_as_sent(lab: Lab, commands: list[Command]) -> None:
    # Before the first it is where the arm rests.
    order = {tuple(q): i for i, q in enumerate([lab.rig(5.0).arm.home, *lab.wire()])}
    rows = [order[tuple(command.sent.arm)] for command in commands]
    assert rows == sorted(rows)


def test_what_is_recorded_as_sent_is_what_went_out_then(lab: Lab) -> None:
    goal = turned(lab.rig(5.0), 0.3)
    driver = lab.connect()
    np.testing.assert_array_equal(driver.last_sent().arm, lab.rig(5.0).arm.home)
    commands = recorded(lab, driver, None, goal)
    assert_recorded_as_sent(lab, commands)
    moving = [c.sent.arm[0] for c in commands if 0.01 < c.sent.arm[0] - lab.rig(5.0).arm.home[0] < 0.29]
    # A busy machine starves the arm, which rests then; a piece of the way has five recordings.
    assert len(moving) > 5 and len(set(moving)) > 0.4 * len(moving), "not once for each piece of the way"


def test_a_setpoint_that_the_client_refuses_is_not_recorded_as_sent(lab: Lab) -> None:
    driver = lab.connect("refuse")
    with pytest.raises(RobotError, match="control program took no more setpoints"):
        Stream(driver, lab.rig(5.0)).run(turned(lab.rig(5.0), 0.05), 1.0)
    assert len(driver.sent_at()) == len(lab.wire())
    np.testing.assert_array_equal(driver.last_sent().arm, lab.wire()[-1])


def test_of_an_arm_that_yields_is_recorded_where_it_was_sent_not_where_it_was_asked_to_be(lab: Lab) -> None:
    goal = turned(lab.rig(5.0), 0.0)
    commands = recorded(lab, lab.connect("press"), (20.0, 20.0, 20.0, 6.0, 6.0, 6.0), goal)
    assert_recorded_as_sent(lab, commands)
    np.testing.assert_array_equal([c.requested.arm for c in commands], [goal.arm] * len(commands))
    assert np.abs(commands[-1].sent.arm - goal.arm).max() > 0.02


@pytest.mark.parametrize("table_z", [0.0, 0.05])
def test_an_arm_that_yields_keeps_to_its_guards_heights(lab: Lab, table_z: float) -> None:
    """Pulled down, it would go on to the table; the guard's floor is 20 mm below the tip."""
    rig = lab.rig(5.0)
    driver, floor = lab.connect("pull"), rig.tip_pose(rig.arm.home)[2, 3] - 0.02
    guard = Guard(driver, rig, table_z, margin=table_z - floor)
    stream = Stream(driver, rig, guard=guard)
    stream.limit_effort((20.0, 20.0, 20.0, 6.0, 6.0, 6.0))
    stream.run(stream.target, 1.0)
    lowest = rig.tip_pose(np.array(lab.wire()))[:, 2, 3].min()
    assert floor <= lowest < floor + 0.01


def test_a_knock_of_10_ms_is_too_much_force_and_braked_for_at_once(lab: Lab) -> None:
    rig, driver = lab.rig(5.0), lab.connect("knock")
    stream = Stream(driver, rig)
    with pytest.raises(SafetyError, match="the tip feels 400 N; allowed: 300 N") as caught:
        stream.run(turned(rig, 1.0), 2.0, travel=True)
    assert caught.value.quantity == "force"
    braked = len(lab.wire())
    stream.run(turned(rig, 0.4), 1.0, travel=True)
    assert wait_for(lambda: len(lab.wire()) >= braked + 500)
    wire = np.array(lab.wire())
    assert_nothing_out_of_limits(list(wire), rig)
    speed = np.diff(wire[:braked, 0]) / SERVO_PERIOD
    assert speed[399] > 0.3
    assert (np.diff(np.diff(speed)[399:405]) < 0).all(), "it slows down from the next setpoint on"
    # v / a + a / j, and a few ticks of what it gained before.
    fastest = speed[399] / rig.arm.acceleration_limit[0] + rig.arm.acceleration_limit[0] / rig.arm.jerk_limit[0]
    assert braked - 400 < fastest / SERVO_PERIOD + 10


def test_a_way_to_rest_is_taken_once_and_stays_the_drivers_own(lab: Lab) -> None:
    driver, q = lab.connect(), lab.rig(5.0).arm.home
    words, way = driver._require_link().words, np.tile(q, (30, 1))
    driver.play(np.tile(q, (10, 1)), np.full(10, 0.1), way)
    written = words["stops"].tobytes()
    assert wait_for(lambda: bool(words["resting"]))
    time.sleep(0.1)
    assert words["stops"].tobytes() == written
    assert len(lab.wire()) == 40


@pytest.mark.parametrize("knowledge", Halt)
def test_a_link_that_crashes_has_its_program_stopped_and_shows_nobody_its_traceback(
    lab: Lab, knowledge: Halt, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    lab.knowledge = knowledge
    driver = lab.connect("raise")
    with caplog.at_level("DEBUG", logger="resync_robot.hardware.ur_process"):
        with pytest.raises(
            StaleError, match=r"lost \(its process ended with code 4: the library has a bad day\)"
        ) as error:
            Stream(driver, lab.rig(5.0)).run(turned(lab.rig(5.0), 0.05), 1.0)
        assert lab.stopped == ["program"] and "stopped" not in str(error.value)
        assert driver.halt() is knowledge
    # Whoever could not be asked then is asked once more at the end.
    assert lab.stopped == ["program"] * (1 if knowledge is Halt.STOPPED else 2)
    assert capfd.readouterr().err == ""
    assert "RuntimeError: the library has a bad day" in caplog.text, "for whoever looks for the defect"
    warned = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert warned == ([] if knowledge is Halt.STOPPED else [Halt.UNKNOWN.value])


def test_a_controller_that_answers_again_at_the_end_is_believed(lab: Lab) -> None:
    lab.knowledge = Halt.UNKNOWN
    driver = lab.connect("raise")
    with pytest.raises(StaleError):
        Stream(driver, lab.rig(5.0)).run(turned(lab.rig(5.0), 0.05), 1.0)
    lab.knowledge = Halt.STOPPED
    assert driver.halt() is driver.halt() is Halt.STOPPED


def test_at_a_usual_end_the_controllers_word_is_enough(lab: Lab) -> None:
    driver = lab.connect()
    assert driver.halt() is Halt.STOPPED and lab.stopped == []
    assert lab.lines()[-1] == "end"


@pytest.mark.parametrize("knowledge", Halt)
def test_a_program_that_does_not_end_when_it_is_asked_to_is_not_taken_for_ended(lab: Lab, knowledge: Halt) -> None:
    lab.knowledge = knowledge
    driver = lab.connect("stays")
    assert driver.halt() is knowledge and lab.stopped == ["program"]


def test_a_program_that_takes_no_setpoints_may_still_run(lab: Lab) -> None:
    driver = lab.connect("refuse")
    with pytest.raises(RobotError, match="took no more setpoints"):
        Stream(driver, lab.rig(5.0)).run(turned(lab.rig(5.0), 0.05), 1.0)
    lab.knowledge = Halt.UNKNOWN
    assert driver.halt() is Halt.UNKNOWN and lab.stopped == ["program"]


def test_of_a_robot_that_was_never_connected_nothing_has_to_be_known(lab: Lab) -> None:
    driver = Ur7e(lab.rig(5.0), Hand())
    assert driver.halt() is None


def test_a_link_that_cannot_begin_says_why(lab: Lab, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "numpy.py").write_text("raise ImportError('no numpy here')")
    monkeypatch.syspath_prepend(broken)
    with pytest.raises(RobotError, match=r"the link did not start .*no numpy here"):
        lab.connect()
    assert lab.stopped == []


def test_a_stop_is_named_though_its_reason_is_read_after_it(lab: Lab) -> None:
    with pytest.raises(RobotError, match="emergency stop of the system"):
        Stream(lab.connect("stop"), lab.rig(5.0)).run(turned(lab.rig(5.0), 0.05), 1.0)


def test_a_time_that_is_no_number_is_silence(lab: Lab) -> None:
    rig = lab.rig(0.5)
    with pytest.raises(StaleError):
        stream = Stream(lab.connect("no time", freshness=0.5), rig)
        for _ in range(50):
            stream.run(turned(rig, 0.05), 0.1)


@pytest.mark.parametrize(("fault", "says"), [("no fraction", "nan"), ("no speed", "0")])
def test_a_speed_that_is_none_is_not_moved_at_and_hinders_nothing_else(lab: Lab, fault: str, says: str) -> None:
    driver = lab.connect(fault)
    assert isinstance(driver, RealtimeRobot)
    stream = Stream(driver, lab.rig(5.0))
    with pytest.raises(RobotError, match=f"slider stands at {says}\n"):
        stream.run(turned(lab.rig(5.0), 0.05), 0.1)
    assert lab.wire() == []


def test_what_the_clients_library_prints_does_not_hold_up_the_setpoints(lab: Lab) -> None:
    """A pipe takes 64 KiB, sixteen setpoints' worth here."""
    stream = Stream(lab.connect("chatter"), lab.rig(5.0))
    stream.run(turned(lab.rig(5.0), 0.05), 0.5)
    assert wait_for(lambda: len(lab.wire()) >= 250)


def test_a_link_that_never_began_leaves_the_others_program_alone(lab: Lab) -> None:
    with pytest.raises(RobotError, match="another program controls"):
        lab.connect("in use")
    assert lab.stopped == []


def test_a_controller_that_keeps_another_centre_of_the_payload_is_not_driven(lab: Lab) -> None:
    with pytest.raises(RobotError, match=r"payload \[1\.2, 0\.0, 0\.0, 0\.1\] instead of \[1\.2, 0\.0, 0\.0, 0\.06\]"):
        lab.connect("centre")
    assert lab.stopped == ["program"]
    assert lab.wire() == []


@pytest.mark.parametrize("starved", [False, True], ids=["playing", "resting"])
def test_a_link_that_hangs_is_silent_and_not_waited_for(
    lab: Lab, starved: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("resync_robot.hardware.ur_process.END_S", 0.2)
    driver = lab.connect("hang", freshness=0.5)
    stream = Stream(driver, lab.rig(0.5))
    if starved:
        # The way to rest is under way for ever.
        driver._require_link().words["link_epoch"] += 1
        threading.Timer(0.1, lambda: driver._link.process.send_signal(signal.SIGSTOP)).start()
    begin = time.monotonic()
    with pytest.raises(StaleError, match="said nothing"):
        stream.run(turned(lab.rig(0.5), 0.05), 1.0)
    assert time.monotonic() - begin < 5.0


def test_a_driver_that_lets_go_brakes_at_once_however_long_the_block(lab: Lab) -> None:
    rig = lab.rig(5.0)
    driver = lab.connect()
    stream, ended = Stream(driver, rig), []

    def move() -> None:
        try:
            stream.run(turned(rig, 1.0), 8.0, travel=True)
        except RobotError as error:
            ended.append(error)

    mover = threading.Thread(target=move)
    words = driver._require_link().words
    mover.start()
    assert wait_for(lambda: int(words["sent"]) > 400)
    before = int(words["sent"])
    driver.close()
    mover.join()
    assert ended and lab.lines()[-1] == "end"
    wire = lab.wire()
    assert_nothing_out_of_limits(wire, rig)
    speed = np.abs(np.diff(wire, axis=0)).max(axis=1)
    assert speed[before - 20] > 1e-4, "it was moving"
    np.testing.assert_array_equal(wire[-1], wire[-2])
    # A piece, the lead, and what was sent while this process was told; then the way to rest.
    assert len(wire) - before < 2 * PIECE + 100
