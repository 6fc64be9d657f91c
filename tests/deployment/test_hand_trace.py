from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core.fittings import DRAWER as BUILT
from resync_robot.core.fittings import LID as PLATE
from resync_robot.core.symbols import Object
from resync_robot.deployment.hand_trace import HALF_A_BLOCK, LOW, REACH, HandTrace
from tests import furnished_scenes, scenes
from tests.furnished_scenes import FACE, THE_DRAWER, THE_LID
from tests.scenes import B0, B1

STATE = scenes.scene({"b0": (0.0, 0.0), "b1": (0.0, 0.2)}).initial
PLACE = STATE.get(B0, "x", "y")
FURNISHED = furnished_scenes.furnished({"b0": (0.0, 0.0)}).initial
BESIDE = REACH - HALF_A_BLOCK


def trace(*tips: tuple[float, float, float]) -> HandTrace:
    followed = HandTrace()
    for tip in tips:
        followed.follow(np.array([*(PLACE + tip[:2]), tip[2]]))
    return followed


def at(x: float, y: float, in_hand: tuple[Object, ...] = ()) -> HandTrace:
    followed = HandTrace()
    followed.follow(np.array([x, y, 0.05]), in_hand)
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


@pytest.mark.parametrize(("beyond", "touched"), [(-0.10, True), (BESIDE - 0.01, True), (BESIDE + 0.01, False)])
def test_a_lid_may_have_moved_where_the_hand_was_on_it_or_beside_its_edge(beyond: float, touched: bool) -> None:
    x, y = FURNISHED.get(THE_LID, "x", "y")
    assert at(x + PLATE.size[0] / 2 + beyond, y).touched(FURNISHED) == ((THE_LID,) if touched else ())


@pytest.mark.parametrize("opening", [0.0, BUILT.travel])
def test_a_drawer_may_have_moved_where_the_hand_was_at_its_handle_in_its_tray_or_at_its_cabinet(opening: float) -> None:
    drawer = furnished_scenes.drawer_features(opening)
    state = furnished_scenes.furnished({"b0": (0.0, 0.0)}, drawer=drawer).initial
    handle = FACE[0] - opening - BUILT.front[0] - BUILT.reach
    for x in (handle, FACE[0] - 0.08, FACE[0] + BUILT.cabinet[0] + BESIDE - 0.01):
        assert at(x, FACE[1]).touched(state) == (THE_DRAWER,)
    assert at(FACE[0] + BUILT.cabinet[0] + BESIDE + 0.01, FACE[1]).touched(state) == ()


def test_a_lid_in_the_hand_reaches_further_than_the_fingers() -> None:
    x, y = FURNISHED.get(B0, "x", "y")
    beside = x - PLATE.size[0] / 2 - 0.01
    assert at(beside, y).touched(FURNISHED) == ()
    carrying = at(beside, y, (THE_LID,))
    assert carrying.touched(FURNISHED) == (B0,) and carrying.carried == {THE_LID}
    # At one and the same place, too, where the hand closes on it.
    closing = at(beside, y)
    closing.follow(np.array([beside, y, 0.05]), (THE_LID,))
    assert closing.touched(FURNISHED) == (B0,)
    closing.clear()
    assert not closing.carried
