"""What a stream looks like on the wire, at the emulator's end."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest

from hardware.base import SERVO_PERIOD, SafetyError
from hardware.emulator.server import Emulator
from hardware.robotiq import Robotiq
from hardware.stream import Stream
from hardware.ur7e import Ur7e
from resync_robot.core.errors import MotionError
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig
from tests import emulators

pytestmark = pytest.mark.realtime


ROUNDING = 1e-6


@pytest.fixture
def machine() -> Iterator[Emulator]:
    emulators.need_client()
    with emulators.emulated() as emulator:
        yield emulator


def assert_within_limits(machine: Emulator, rig: Rig) -> np.ndarray:
    """Every setpoint received, with the arm at rest before the first."""
    wire = np.array([q for _, q in machine.controller.wire or []])
    motion = np.concatenate([[rig.arm.home] * 3, wire])
    assert np.isfinite(motion).all()
    for limit in (rig.arm.velocity_limit, rig.arm.acceleration_limit, rig.arm.jerk_limit):
        motion = np.diff(motion, axis=0) / SERVO_PERIOD
        assert (np.abs(motion) <= limit * (1 + ROUNDING)).all()
    return wire


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
    wire = assert_within_limits(machine, rig)
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
    assert_within_limits(machine, rig)


def test_no_adversarial_target_shows_on_the_wire(machine: Emulator) -> None:
    rng = np.random.default_rng(0)
    rig = emulators.rig_at(machine.address)
    refused = 0
    with Ur7e(rig, Robotiq(machine.address)) as robot:
        stream = Stream(robot, rig)
        for k in range(2000):
            target = stream.target.arm + rng.normal(0, 0.01, 6)
            kind = k % 10
            if kind == 1:
                target[rng.integers(6)] = rng.choice([np.nan, np.inf, -np.inf, 1e300])
            elif kind == 2:
                target = target[: rng.integers(0, 6)]
            elif kind == 3:
                target += rng.choice([-1, 1]) * rng.uniform(0.5, 8.0)
            elif kind == 4:
                target = rng.uniform(-7, 7, 6)
            elif kind != 5:
                continue
            opening = rng.choice([0.1, np.nan, -1.0, 9.0]) if kind == 5 else 0.1
            try:
                stream.run(JointTarget(target, float(opening)), 0.02)
            except (SafetyError, MotionError):
                refused += 1
    assert refused > 800
    assert_within_limits(machine, rig)


@pytest.mark.slow
def test_a_minute_of_streaming_keeps_its_period(machine: Emulator) -> None:
    rig = emulators.rig_at(machine.address)
    with Ur7e(rig, Robotiq(machine.address)) as robot:
        stream = Stream(robot, rig)
        swing(stream, rig, 60.0)
        stream.stop()
    assert_within_limits(machine, rig)
    times = np.array([t for t, _ in machine.controller.wire or []])
    # The emulator stamps arrivals with its tick: on a quiet machine nearly every tick brings one.
    assert np.median(np.diff(times)) == pytest.approx(SERVO_PERIOD, abs=1e-9)
