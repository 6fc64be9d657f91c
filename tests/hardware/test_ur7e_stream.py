"""What a stream looks like on the wire, at the emulator's end."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest

from hardware.base import SERVO_PERIOD
from hardware.emulator.server import Emulator
from hardware.robotiq import Robotiq
from hardware.stream import Stream
from hardware.ur7e import Ur7e
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig
from tests import emulators
from tests.hardware.adversary import KINDS, assert_nothing_out_of_limits, attack

pytestmark = pytest.mark.realtime


@pytest.fixture
def machine() -> Iterator[Emulator]:
    emulators.need_client()
    with emulators.emulated() as emulator:
        yield emulator


def wire_of(machine: Emulator) -> list[np.ndarray]:
    """Every setpoint that arrived."""
    return [q for _, q in machine.controller.wire or []]


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


@pytest.mark.parametrize("count", [2_000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_no_adversarial_target_shows_on_the_wire(machine: Emulator, count: int) -> None:
    rng = np.random.default_rng(0)
    rig = emulators.rig_at(machine.address)
    with Ur7e(rig, Robotiq(machine.address)) as robot:
        stream = Stream(robot, rig)
        # Every one that is taken moves the arm for 20 ms; one in fifty keeps it moving.
        kinds = [KINDS[k % len(KINDS)] if k % 50 == 0 else KINDS[2 + k % (len(KINDS) - 2)] for k in range(count)]
        taken = sum(attack(stream, rig, kind, rng) for kind in kinds)
        stream.stop()
    assert 0 < taken < count / 2
    assert_nothing_out_of_limits(wire_of(machine), rig)


@pytest.mark.slow
def test_a_minute_of_streaming_keeps_its_period(machine: Emulator) -> None:
    rig = emulators.rig_at(machine.address)
    with Ur7e(rig, Robotiq(machine.address)) as robot:
        stream = Stream(robot, rig)
        swing(stream, rig, 60.0)
        stream.stop()
    assert_nothing_out_of_limits(wire_of(machine), rig)
    times = np.array([t for t, _ in machine.controller.wire or []])
    # The emulator stamps arrivals with its tick: on a quiet machine nearly every tick brings one.
    assert np.median(np.diff(times)) == pytest.approx(SERVO_PERIOD, abs=1e-9)
