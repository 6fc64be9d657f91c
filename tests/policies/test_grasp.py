"""Which way the hand turns beside a wall, how much room its fingers have, and how high it travels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.policies.grasp import (
    SPARE,
    best_approach,
    best_yaw,
    carried_with,
    finger_clearance,
    finger_corners,
    travel_height,
)
from tests import scenes
from tests.policies.followers import RIG
from tests.scenes import B0, B1, B2, BOX_X, CORNER, HEIGHT, INNER, WALL, WIDTH

GRIPPER = RIG.gripper
OPENING = WIDTH + 0.024
GRASP_Z = scenes.FLOOR + HEIGHT / 2


def chosen(blocks: dict, box_yaw: float = 0.0, current: float = 0.0, **more: object) -> float:
    """The yaw for b0 in the frame of the box, in [0, pi): how the pads close does not know front from back."""
    state = scenes.scene(blocks, box_yaw=box_yaw).initial
    along = float(spatial.yaw_of(state.get(B0, "qw", "qx", "qy", "qz")))
    yaw = best_yaw(state, B0, along, GRASP_Z, OPENING, GRIPPER, current, **more)
    return float((yaw - box_yaw + 1e-9) % np.pi)


@pytest.mark.parametrize("box_yaw", [0.0, 0.2, -0.15])
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("block_yaw", [0.0, np.pi / 2])
def test_beside_a_wall_the_pads_close_along_it(side: int, box_yaw: float, block_yaw: float) -> None:
    # At yaw 0 the pads close along y.
    assert chosen({"b0": (side * CORNER, 0.0, block_yaw)}, box_yaw) == pytest.approx(0.0, abs=1e-6)
    assert chosen({"b0": (0.0, side * CORNER, block_yaw)}, box_yaw) == pytest.approx(np.pi / 2, abs=1e-6)


def test_beside_a_block_the_pads_close_along_its_side() -> None:
    beside = 0.0, WIDTH + 0.005
    assert chosen({"b0": (0.0, 0.0), "b1": beside}) == pytest.approx(np.pi / 2, abs=1e-6)
    # Unless that block is in the hand.
    assert chosen({"b0": (0.0, 0.0), "b1": beside}, ignore=B1) == pytest.approx(0.0, abs=1e-6)


OPENINGS = WIDTH + 0.024, WIDTH + 0.016, WIDTH + 0.010


@given(gap=st.floats(0.001, 0.04))
def test_fingers_open_less_where_more_does_not_fit_and_no_less_than_that(gap: float) -> None:
    """Blocks at four sides, `gap` m away: a finger must fit in, with something to spare."""
    beside = WIDTH + gap
    around = {"b1": (beside, 0.0), "b2": (-beside, 0.0), "b3": (0.0, beside), "b4": (0.0, -beside)}
    state = scenes.scene({"b0": (0.0, 0.0)} | around).initial
    yaw, opening = best_approach(state, B0, 0.0, GRASP_Z, OPENINGS, GRIPPER, 0.0)
    assert opening in OPENINGS
    needs = [(o - WIDTH) / 2 + GRIPPER.finger_thickness for o in OPENINGS]
    if gap > needs[-1]:
        assert (opening - WIDTH) / 2 + GRIPPER.finger_thickness < gap, "the fingers fit"
    else:
        assert opening == OPENINGS[0], "no opening helps, so none is given up for it"
    if gap > needs[0] + SPARE:
        assert opening == OPENINGS[0]
    assert yaw == best_yaw(state, B0, 0.0, GRASP_Z, opening, GRIPPER, 0.0)


@pytest.mark.parametrize("turn", [0.3, -0.3, 1.2])
def test_in_the_open_the_smallest_turn_wins(turn: float) -> None:
    yaw = chosen({"b0": (0.0, 0.0, turn)}, current=0.0)
    smallest = min((turn + k * np.pi / 2 for k in range(-2, 3)), key=abs)
    assert yaw == pytest.approx(smallest % np.pi, abs=1e-6)


def test_fingers_stand_at_both_sides_across_the_closing_axis() -> None:
    corners = finger_corners(np.array([0.4, 0.1]), np.pi / 2, 0.08, GRIPPER) - [0.4, 0.1]
    assert corners.shape == (8, 2)
    # At yaw 90 degrees they close along x.
    assert np.abs(corners[:, 0]).min() == pytest.approx(0.04)
    assert np.abs(corners[:, 0]).max() == pytest.approx(0.04 + GRIPPER.finger_thickness)
    assert np.abs(corners[:, 1]).max() == pytest.approx(GRIPPER.finger_width / 2)


STATE = scenes.scene({"b0": (0.0, 0.0), "b1": (-0.1, 0.0)}).initial


def room(x: float, y: float, z: float = GRASP_Z, others: tuple = ()) -> float:
    """Clearance at a point in the frame of the box."""
    return float(finger_clearance(STATE, np.array([BOX_X + x, y]), z, others))


def test_room_is_positive_inside_and_outside_the_box_and_negative_in_a_wall() -> None:
    assert room(0.0, 0.0) == pytest.approx(INNER / 2)
    assert room(INNER / 2 - 0.004, 0.05) == pytest.approx(0.004)
    assert room(INNER / 2 + 0.01, 0.0) == pytest.approx(-0.01)
    assert room(INNER / 2 + WALL + 0.007, 0.0) == pytest.approx(0.007)


def test_walls_and_blocks_below_the_tip_are_no_obstacle() -> None:
    above_rim = scenes.FLOOR + scenes.RIM + 0.01
    assert room(INNER / 2 + 0.01, 0.0, z=above_rim) == np.inf
    assert room(-0.1, 0.0, z=scenes.FLOOR + HEIGHT + 0.01, others=(B1,)) == pytest.approx(0.05)


def test_room_around_another_block_is_counted_from_its_sides() -> None:
    assert room(-0.1, 0.0, others=(B1,)) == pytest.approx(-WIDTH / 2)
    assert room(-0.1 + WIDTH / 2 + 0.003, 0.0, others=(B1,)) == pytest.approx(0.003)


@given(
    st.lists(
        st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.just(0.0), st.floats(0.0, 0.2)), min_size=1, max_size=3
    )
)
def test_hand_and_carried_block_travel_over_everything(places: list[tuple[float, ...]]) -> None:
    state = scenes.scene({f"b{i}": p for i, p in enumerate(places)}).initial
    stud = 0.012
    for carried in (None, B0):
        height = travel_height(state, carried)
        lowest = height - (HEIGHT if carried else 0.0)
        assert lowest > scenes.FLOOR + scenes.RIM
        for block in state.of_type(B0.type):
            if carried is None or block not in carried_with(state, carried):
                assert lowest > state.get(block, "z")[0] + HEIGHT / 2 + stud


@given(st.lists(st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)), min_size=1, max_size=20))
def test_the_room_of_many_points_is_that_of_each(points: list[tuple[float, float]]) -> None:
    state = scenes.scene({"b0": (0.02, 0.01, 0.5), "b1": (-0.1, 0.0, -0.3)}, box_yaw=0.15).initial
    at = np.array(points) + [BOX_X, 0.0]
    together = finger_clearance(state, at, GRASP_Z, (B0, B1))
    each = [float(finger_clearance(state, p, GRASP_Z, (B0, B1))) for p in at]
    np.testing.assert_allclose(together, each, atol=1e-12)


def test_a_tower_held_by_its_lowest_block_rides_along_and_is_not_travelled_over() -> None:
    """Its upper block was counted among what stands in the way: each motion took the tower higher by its own height."""
    up = 0.2
    held = (0.0, 0.0, 0.3, up)
    alone = scenes.scene({"b0": held, "b2": (0.1, 0.1)}).initial
    tower = scenes.scene({"b0": held, "b1": (0.004, 0.0, 0.2, up + HEIGHT), "b2": (0.1, 0.1)}).initial
    assert carried_with(tower, B0) == (B0, B1) and carried_with(tower, B1) == (B1,)
    assert travel_height(tower, B0) == travel_height(alone, B0) < up
    beside = scenes.scene({"b0": held, "b1": (0.03, 0.0, 0.2, up + HEIGHT), "b2": (0.1, 0.1, 0.0, up - HEIGHT)}).initial
    assert carried_with(beside, B0) == (B0,) and B2 in beside
