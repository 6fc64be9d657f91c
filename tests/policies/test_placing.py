"""Where a block is put down: with room on all sides, on the table first, and nowhere where there is none."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.policies.grasp import SPARE, finger_clearance, finger_corners
from resync_robot.policies.placing import ANOTHER, REGION, free_places
from resync_robot.policies.scripted import ScriptedSettings
from tests import scenes
from tests.policies.followers import RIG
from tests.scenes import B0, BOX_X, INNER, WIDTH

HERE = np.array([BOX_X, 0.0])


def everywhere(places: np.ndarray) -> np.ndarray:
    return np.ones(len(places), dtype=bool)


def within(place: np.ndarray) -> bool:
    return bool(np.all(np.abs(place[:2] - HERE) < INNER / 2))


def needs(yaw: float = 0.0) -> np.ndarray:
    opening = WIDTH + 2 * ScriptedSettings().release_clearance
    return finger_corners(np.zeros(2), yaw, opening, RIG.gripper)


def places(state: State, reaches=everywhere, yaw: float = 0.0) -> list[np.ndarray]:  # type: ignore[no-untyped-def]
    return free_places(state, (B0,), WIDTH, needs(yaw), HERE, reaches)


def beside(state: State) -> list[Object]:
    return [b for b in state.of_type(B0.type) if b != B0]


spots = st.tuples(st.floats(-0.12, 0.12), st.floats(-0.33, 0.33), st.floats(-3.0, 3.0))


@settings(max_examples=40)
@given(others=st.lists(spots, max_size=3), yaw=st.floats(-3.0, 3.0))
def test_however_it_is_turned_a_block_that_was_put_down_can_be_picked_again(
    others: list[tuple[float, float, float]], yaw: float
) -> None:
    state = scenes.scene({"b0": (0.0, 0.0)} | {f"b{i}": place for i, place in enumerate(others, start=1)}).initial
    found = places(state)
    assert found, "three blocks never fill table and box"
    opening = WIDTH + 2 * ScriptedSettings().approach_clearances[0]
    for x, y, ground in found:
        fingers = finger_corners(np.array([x, y]), yaw, opening, RIG.gripper)
        assert finger_clearance(state, fingers, 0.02, beside(state)).min() > SPARE
        assert ground == (scenes.FLOOR if within(np.array([x, y])) else 0.0)
    assert all(np.linalg.norm(a[:2] - b[:2]) >= ANOTHER for a, b in combinations(found, 2))


def test_the_table_comes_before_the_box_where_blocks_are_dragged_about() -> None:
    found = [within(place) for place in places(scenes.scene({"b0": (0.0, 0.0)}).initial)]
    assert found == sorted(found) and not found[0] and found[-1]
    (floor, *_) = places(scenes.scene({"b0": (0.0, 0.0)}).initial, lambda p: np.array([within(q) for q in p]))
    assert within(floor)


def test_of_places_with_room_enough_the_nearest_is_first() -> None:
    state = scenes.scene({"b0": (0.0, 0.0)}).initial
    for side in (-1.0, 1.0):
        first = free_places(state, (B0,), WIDTH, needs(), np.array([BOX_X, side * 0.3]), everywhere)[0]
        assert np.sign(first[1]) == side
        assert np.linalg.norm(first[:2] - [BOX_X, side * 0.3]) < 0.05


def test_in_a_full_scene_it_is_put_where_there_is_room_as_the_hand_is_turned() -> None:
    """A lane between blocks, along y, in which fingers find room before and behind a block, and none beside it."""
    columns = [side * (WIDTH + 0.012 + n * (WIDTH + 0.02)) for n in range(4) for side in (-1, 1)]
    crowd = [(x, y, 0.0) for x in columns for y in np.arange(-0.45, 0.46, WIDTH + 0.002)]
    state = scenes.scene({"b0": (0.0, 0.0)} | {f"b{i}": place for i, place in enumerate(crowd, start=1)}).initial
    found = places(state)
    assert found and all(abs(x - BOX_X) < 0.01 for x, _, _ in found)
    assert places(state, yaw=np.pi / 2) == []


def test_what_the_hand_does_not_reach_is_no_place_and_where_all_is_full_there_is_none() -> None:
    state = scenes.scene({"b0": (0.0, 0.0)}).initial
    assert all(p[1] > 0 for p in places(state, lambda p: p[:, 1] > 0))
    assert places(state, lambda p: np.zeros(len(p), dtype=bool)) == []
    step = WIDTH + 0.01
    grid = [(x, y) for x in np.arange(-0.2, 0.2, step) for y in np.arange(REGION[1, 0], REGION[1, 1] + step, step)]
    crowd = {"b0": (0.0, 0.0)} | {f"b{i}": place for i, place in enumerate(grid, start=1)}
    assert places(scenes.scene(crowd).initial) == []
