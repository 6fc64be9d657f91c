from __future__ import annotations

import numpy as np

from resync_robot.deployment.hand_trace import LOW, REACH, HandTrace
from tests import scenes
from tests.scenes import B0, B1

STATE = scenes.scene({"b0": (0.0, 0.0), "b1": (0.0, 0.2)}).initial
PLACE = STATE.get(B0, "x", "y")


def trace(*tips: tuple[float, float, float]) -> HandTrace:
    followed = HandTrace()
    for tip in tips:
        followed.follow(np.array([*(PLACE + tip[:2]), tip[2]]))
    return followed


def test_a_hand_that_stays_above_everything_touches_nothing() -> None:
    high = trace((0.0, 0.0, LOW + 0.01), (0.0, 0.1, LOW + 0.01))
    assert high.last is None and high.touched(STATE) == ()


def test_blocks_near_the_way_of_a_low_hand_may_have_moved_and_no_others() -> None:
    assert trace((REACH - 0.01, 0.0, 0.03)).touched(STATE) == (B0,)
    assert trace((REACH + 0.01, 0.0, 0.03)).touched(STATE) == ()
    assert trace((0.0, 0.0, 0.03), (0.0, 0.2, 0.03)).touched(STATE) == (B0, B1)


def test_what_the_hand_moved_it_left_where_it_was_low_last() -> None:
    moved = trace((0.0, 0.0, 0.03), (0.1, 0.0, 0.03), (0.1, 0.0, 0.3))
    np.testing.assert_allclose(moved.last, PLACE + [0.1, 0.0])
    moved.clear()
    assert moved.last is None and moved.touched(STATE) == ()
