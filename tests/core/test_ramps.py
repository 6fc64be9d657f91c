from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core.ramps import ramped

PERIOD = 0.02


@given(cruise=st.floats(0.0, 5.0), ramp=st.floats(0.05, 1.0))
def test_a_way_arrives_and_keeps_to_its_speed_and_to_the_acceleration_of_its_ramps(cruise: float, ramp: float) -> None:
    way = np.concatenate([[0.0, 0.0], ramped(cruise, ramp, PERIOD), [1.0]])
    assert way[-2] == 1.0 and np.all(np.diff(way) >= 0)
    if cruise > PERIOD:
        full = 1.0 / cruise
        speed = np.diff(way) / PERIOD
        assert speed.max() <= full * (1 + 1e-9)
        assert np.abs(np.diff(speed)).max() / PERIOD <= full * np.pi / 2 / ramp * (1 + 1e-6)


@pytest.mark.parametrize(("cruise", "seconds"), [(2.0, 2.4), (0.4, 0.8), (0.1, 0.4)])
def test_it_takes_a_ramp_longer_than_at_full_speed_and_less_where_it_never_gets_there(
    cruise: float, seconds: float
) -> None:
    assert len(ramped(cruise, 0.4, PERIOD)) == round(seconds / PERIOD)


def test_no_way_is_one_step() -> None:
    assert ramped(0.0, 0.3, PERIOD).tolist() == [1.0]
