"""What lids and drawers take up, and where nothing may be put that a drawer opens to."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.fittings import DRAWER, LID
from resync_robot.core.state import State
from resync_robot.policies.fittings import footprints, in_a_way, knob_top
from resync_robot.policies.grasp import finger_clearance, travel_height
from resync_robot.policies.placing import free_places
from tests import furnished_scenes as furnished
from tests import scenes
from tests.furnished_scenes import THE_DRAWER, THE_LID
from tests.scenes import B0

BLOCKS = {"b0": (0.0, 0.0), "b1": (0.08, 0.08)}
HALF_OPEN = 0.10


def scene(**given: np.ndarray) -> State:
    return furnished.furnished(BLOCKS, **given).initial


def from_front(state: State, ahead: float, beside: float) -> np.ndarray:
    """(1, 2) in the world, of a point in the frame of the drawer's front."""
    return (spatial.pose_from_features(state[THE_DRAWER][:7]) @ np.array([ahead, beside, 0.0, 1.0]))[None, :2]


@pytest.mark.parametrize("yaw", [np.pi, np.pi - 0.2])
def test_a_drawer_is_solid_where_its_parts_are_and_hollow_between_them(yaw: float) -> None:
    state = scene(drawer=furnished.drawer_features(HALF_OPEN, yaw))
    half, edge = DRAWER.front[0] / 2, DRAWER.tray[1] / 2 + DRAWER.wall / 2
    inside = [
        (0.0, 0.1),
        (half + DRAWER.reach - 0.005, 0.02),
        (-half - HALF_OPEN - 0.05, 0.0),
        (-half - 0.04, edge),
        (-half - 0.04, -edge),
    ]
    outside = [(-half - HALF_OPEN / 2, 0.0), (half + DRAWER.reach + 0.02, 0.0), (-half - 0.04, edge + 0.03)]
    for places, solid in ((inside, True), (outside, False)):
        for ahead, beside in places:
            room = finger_clearance(state, from_front(state, ahead, beside), 0.02, [])[0]
            assert bool(room < 0) is solid, (ahead, beside)
    middle = finger_clearance(state, from_front(state, -half - HALF_OPEN / 2, 0.0), 0.02, [])[0]
    assert middle == pytest.approx(HALF_OPEN / 2)


def test_fingers_over_what_is_low_have_room() -> None:
    state = scene()
    plate, knob = state.get(THE_LID, "x", "y") + [0.1, 0.0], state.get(THE_LID, "x", "y")
    for place, top in ((plate, LID.size[2]), (knob, knob_top(state, THE_LID))):
        below, above = (finger_clearance(state, place[None], z, [])[0] for z in (top - 0.003, top + 0.003))
        assert below < 0 < above


@pytest.mark.parametrize("opening", [0.0, HALF_OPEN, DRAWER.travel])
def test_the_way_of_a_drawer_is_the_same_however_far_it_is_open(opening: float) -> None:
    closed, state = scene(), scene(drawer=furnished.drawer_features(opening))
    rng = np.random.default_rng(0)
    points = rng.uniform([0.1, 0.2], [0.7, 0.6], (400, 2))
    np.testing.assert_array_equal(in_a_way(state, points, 0.01), in_a_way(closed, points, 0.01))
    assert 0.1 < in_a_way(closed, points, 0.01).mean() < 0.9
    open_wide = scene(drawer=furnished.drawer_features(DRAWER.travel))
    handle = from_front(open_wide, DRAWER.front[0] / 2 + DRAWER.reach - 0.005, 0.0)
    assert in_a_way(closed, handle, 0.0)[0] and not in_a_way(closed, handle - [[0.02, 0.0]], 0.0)[0]


def test_nothing_is_put_down_on_a_lid_or_where_a_drawer_opens() -> None:
    state = scene()
    here, corners = np.array([0.48, 0.0]), scenes.WIDTH / 2 * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    for x, y, _ in free_places(state, (B0,), scenes.WIDTH, corners, here, lambda p: np.ones(len(p), bool)):
        place = np.array([[x, y]])
        assert all(solid.away(place)[0] > scenes.WIDTH / 2 for solid in footprints(state))
        assert not in_a_way(state, place, scenes.WIDTH / 2)[0]


def test_the_hand_travels_over_lid_and_cabinet_and_higher_with_what_hangs_from_it() -> None:
    on, off = scene(lid=furnished.lid_features()), scene()
    assert travel_height(on, None) > max(knob_top(on, THE_LID), DRAWER.cabinet[2])
    low = State({o: off[o] for o in off if o != THE_DRAWER})
    assert travel_height(low, None) < DRAWER.cabinet[2]
    assert travel_height(on, THE_LID) >= travel_height(off, None) + LID.size[2] + LID.knob[2]
    assert travel_height(off, B0) == pytest.approx(travel_height(off, None) + scenes.HEIGHT)
