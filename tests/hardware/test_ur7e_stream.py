"""What a stream looks like on the wire, at the emulator's end."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig
from resync_robot.hardware.base import SERVO_PERIOD
from resync_robot.hardware.emulator.judge import Judge
from resync_robot.hardware.emulator.server import Emulator
from resync_robot.hardware.joint_moves import travel
from resync_robot.hardware.robotiq import Robotiq
from resync_robot.hardware.stream import Stream
from resync_robot.hardware.ur7e import Ur7e
from tests import emulators
from tests.hardware.adversary import KINDS, MOVES, TAKEN, assert_nothing_out_of_limits, attack, starts
from tests.stalls import never_excused

pytestmark = pytest.mark.realtime
REFUSED = [kind for kind in KINDS if kind not in MOVES]


@pytest.fixture
def machine() -> Iterator[Emulator]:
    emulators.need_client()
    with emulators.emulated() as emulator:
        yield emulator


def wire_of(machine: Emulator) -> list[np.ndarray]:
    """Every setpoint that arrived."""
    return [q for _, q in machine.controller.wire or []]


@never_excused()
def assert_judged_sound(judge: Judge, at_least: int) -> None:
    assert judge.broken == 0, "; ".join(judge.reasons)
    assert judge.count >= at_least


def swing(stream: Stream, rig: Rig, seconds: float, pause_every: int = 0) -> None:
    """Targets at 10 Hz, of a path that no two of them continue exactly; with pauses it starves."""
    for k in range(round(seconds / 0.1)):
        q = rig.arm.home + 0.12 * np.sin(0.31 * k * np.array([1, 0.3, 0.4, 1, 1, 2])) * np.array([1, 0.3, 0.3, 1, 1, 1])
        stream.run(JointTarget(q, 0.1), 0.1)
        if pause_every and k % pause_every == pause_every - 1:
            time.sleep(0.15)


def test_limits_hold_on_the_wire_and_every_setpoint_arrives(machine: Emulator) -> None:
    rig = emulators.rig_at(machine.address)
    with Ur7e(rig, Robotiq(machine.address)) as robot:
        stream = Stream(robot, rig)
        swing(stream, rig, 3.0)
        stream.stop()
        late = stream.late
    wire = wire_of(machine)
    assert_nothing_out_of_limits(wire, rig)
    assert len(wire) >= 1500
    if late == 0:
        np.testing.assert_allclose(wire[-1], stream.target.arm, atol=1e-9)


def test_a_late_target_is_a_braked_arm_that_goes_on(machine: Emulator) -> None:
    rig = emulators.rig_at(machine.address)
    with Ur7e(rig, Robotiq(machine.address)) as robot:
        stream = Stream(robot, rig)
        swing(stream, rig, 2.0, pause_every=4)
        assert stream.late >= 1
        stream.stop()
        assert stream.settle(tolerance=5e-3)
        np.testing.assert_allclose(robot.state().q, stream.target.arm, atol=5e-3)
    assert_nothing_out_of_limits(wire_of(machine), rig)


@pytest.mark.parametrize("start", ["home", "position", "clearance", "floor", "workspace"])
@pytest.mark.parametrize("count", [400, pytest.param(20_000, marks=pytest.mark.slow)])
def test_no_adversarial_target_shows_on_the_wire(machine: Emulator, count: int, start: str) -> None:
    """A command is one target given to the stream, whether taken or refused; 100,000 from all five starts.

    One in ten is of a kind that may move the arm, for 20 to 200 ms; the others show that nothing of them is sent. The
    emulator judges what it receives as it comes. Each start has an arm of its own: from wherever the targets have led
    one, the straight way to the next start may be forbidden.
    """
    rng = np.random.default_rng(list(start.encode()))
    rig = emulators.rig_at(machine.address)
    judge = machine.controller.judge = Judge(rig.arm)
    with Ur7e(rig, Robotiq(machine.address)) as robot:
        stream = Stream(robot, rig)
        travel(stream, starts(rig)[start])
        kinds = [MOVES[k // 10 % len(MOVES)] if k % 10 == 0 else REFUSED[k % len(REFUSED)] for k in range(count)]
        answers = [attack(stream, rig, kind, rng) for kind in kinds]
        stream.stop()
    assert_judged_sound(judge, at_least=count // 2)
    assert_nothing_out_of_limits(wire_of(machine), rig)
    assert count / 20 < answers.count(TAKEN) < count / 2
    assert {"position", start} - {"home"} < set(answers)


BARE_LOOP = """
import sys, time
due, times = time.monotonic(), []
for _ in range(int(sys.argv[1])):
    due += 0.002
    time.sleep(max(0.0, due - time.monotonic()))
    if time.monotonic() > due + 0.002:
        due = time.monotonic()
    times.append(time.monotonic())
print(*times)
"""


def periods_of_a_bare_loop(count: int) -> np.ndarray:
    """The same waiting as the link does, in a process that does nothing else."""
    done = subprocess.run([sys.executable, "-c", BARE_LOOP, str(count)], capture_output=True, text=True, check=True)
    return np.diff([float(t) for t in done.stdout.split()])


@pytest.mark.parametrize("seconds", [5.0, pytest.param(60.0, marks=pytest.mark.slow)])
def test_a_stream_keeps_its_limits_and_its_period(
    machine: Emulator, seconds: float, record_property: Callable[[str, object], None]
) -> None:
    """Limits by what the emulator received; the period by when the link sent, beside a loop that only waits."""
    rig = emulators.rig_at(machine.address)
    judge = machine.controller.judge = Judge(rig.arm)
    bare, periods, late = [], [], 0
    with Ur7e(rig, Robotiq(machine.address)) as robot:
        # In turns, so that whatever else the machine does befalls both.
        for _ in range(round(seconds)):
            bare.append(periods_of_a_bare_loop(round(0.5 / SERVO_PERIOD)))
            stream, before = Stream(robot, rig), len(robot.sent_at())
            swing(stream, rig, 1.0)
            periods.append(np.diff(robot.sent_at()[before:]))
            stream.stop()
            assert stream.settle(tolerance=5e-3)
            late += stream.late
    # Across the seams of targets as well: an acceleration that jumped there would be a jerk beyond its limit.
    assert_judged_sound(judge, at_least=round(500 * seconds))
    assert_nothing_out_of_limits(wire_of(machine), rig)
    sent = np.concatenate(periods)
    p50, p99, alone = np.median(sent), np.quantile(sent, 0.99), np.quantile(np.concatenate(bare), 0.99)
    for name, value in (("p50_ms", 1e3 * p50), ("p99_ms", 1e3 * p99), ("p99_ratio", p99 / alone), ("late", late)):
        record_property(name, round(float(value), 3))
        print(f"{name} = {value:.3f}")
    assert p50 == pytest.approx(SERVO_PERIOD, rel=0.02)
    assert p99 / alone <= 1.5
