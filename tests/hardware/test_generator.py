"""Braking from a motion that is only known by its setpoints."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core.rig import load_rig
from resync_robot.hardware.generator import Generator, Motion
from tests.hardware.adversary import ROUNDING, assert_rates_hold

RIG = load_rig()


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 10_000), reach=st.sampled_from([1e-4, 0.01, 0.3, 3.0]), cut=st.floats(0.0, 1.0))
def test_a_halt_anywhere_in_a_motion_keeps_the_limits_and_ends_at_rest(seed: int, reach: float, cut: float) -> None:
    rng, generator = np.random.default_rng(seed), Generator(RIG.arm, 1.0)
    begin = Motion(RIG.arm.home, np.zeros(6), np.zeros(6))
    way = generator.towards(begin, RIG.arm.home + rng.uniform(-reach, reach, 6), np.zeros(6), 0.0)
    sent = np.concatenate([[RIG.arm.home] * 3, way.setpoints(1 + int(cut * way.duration / 0.002))])
    halt = generator.halt(sent[-3:])
    assert_rates_hold(np.concatenate([sent, halt, halt[-1:].repeat(3, 0)]), RIG)
    # Beyond where it would have turned round anyway it does not go on for longer than it must.
    slowest = (RIG.arm.velocity_limit / RIG.arm.acceleration_limit).max() + 3 * (
        RIG.arm.acceleration_limit / RIG.arm.jerk_limit
    ).max()
    assert len(halt) * 0.002 <= slowest + ROUNDING
