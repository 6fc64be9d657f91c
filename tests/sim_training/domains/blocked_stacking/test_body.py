"""The robot of Blocked Stacking: its configurations and its shape."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.sim_training.domains.blocked_stacking.body import (
    ARM,
    BASE_RADIUS,
    GAP,
    Configuration,
    bounds,
    box,
    overlap,
    together,
)
from resync_robot.sim_training.domains.blocked_stacking.vocabulary import WORLD

configurations = st.builds(
    Configuration,
    st.floats(0.3, 4.2),
    st.floats(0.3, 1.7),
    st.floats(-3.1, 3.1),
    st.floats(*ARM),
    st.floats(*GAP),
)


@given(configurations)
def test_features_say_all_of_a_configuration(at: Configuration) -> None:
    back = Configuration.of(at.features())
    np.testing.assert_allclose(
        [back.x, back.y, back.theta, back.arm, back.gap], [at.x, at.y, at.theta, at.arm, at.gap], atol=1e-12
    )


@given(configurations, st.floats(-1, 1), st.floats(-1, 1))
def test_local_is_the_inverse_of_at(at: Configuration, ahead: float, aside: float) -> None:
    np.testing.assert_allclose(at.local(at.at(ahead, aside)), (ahead, aside), atol=1e-12)


@given(configurations, st.lists(st.floats(-5, 5), min_size=5, max_size=5))
def test_nothing_moves_it_beyond_what_it_can(at: Configuration, step: list[float]) -> None:
    then = at.moved(step)
    assert BASE_RADIUS <= then.x <= WORLD[0] - BASE_RADIUS and BASE_RADIUS <= then.y <= WORLD[1] - BASE_RADIUS
    assert ARM[0] <= then.arm <= ARM[1] and GAP[0] <= then.gap <= GAP[1] and -math.pi <= then.theta <= math.pi


@given(configurations)
def test_bounds_are_around_its_parts(at: Configuration) -> None:
    base, bar, palm, left, right = at.parts()
    for around, polygons in zip(at.bounds(), ((base,), (bar, palm), (left,), (right,)), strict=True):
        x, y = np.array([p for polygon in polygons for p in polygon]).T
        np.testing.assert_allclose(around, (x.min(), y.min(), x.max(), y.max()), atol=2e-3)
    middles = [np.mean(part, axis=0) for part in (base, palm, left, right)]
    np.testing.assert_allclose(at.middles(), middles, atol=1e-9)


def test_how_much_rectangles_overlap() -> None:
    a = box(0.0, 0.0, 0.0, 1.0, 1.0)
    assert math.isclose(overlap(a, box(0.9, 0.2, 0.0, 1.0, 1.0)), 0.1)
    assert overlap(a, box(1.1, 0.0, 0.0, 1.0, 1.0)) <= 0
    # Their bounds overlap, and they do not.
    assert overlap(a, box(1.0, 1.0, math.pi / 4, 1.0, 1.0)) <= 0
    assert overlap(a, box(0.8, 0.8, math.pi / 4, 1.0, 1.0)) > 0
    np.testing.assert_allclose(bounds(1.0, 2.0, math.pi / 2, 4.0, 2.0), (0.0, 0.0, 2.0, 4.0), atol=1e-12)
    assert together((0, 1, 2, 3), (1, 0, 3, 2)) == (0, 0, 3, 3)
