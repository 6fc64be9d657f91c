"""Objects as boxes, and as markers of a scene."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.fittings import DRAWER as DRAWER_SHAPE
from resync_robot.core.fittings import LID as LID_SHAPE
from resync_robot.core.solids import (
    BOX_FLOOR,
    Cuboid,
    box_shapes,
    boxes,
    cabinet_shapes,
    drawer_shapes,
    lid_shapes,
    outline,
    scene_markers,
)
from resync_robot.core.state import State
from resync_robot.core.symbols import ROUND, SE2, Type
from resync_robot.core.vocabulary import BLOCK, BOX, DRAWER, ROBOT

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
ORANGE = (1.0, 0.5, 0.0, 1.0)
BLOCK_0 = np.array([0.4, 0.1, 0.02, *UPRIGHT, 0.06, 0.05, 0.04])
TRAY = np.array([0.45, 0.0, 0.005, *UPRIGHT, 0.3, 0.2, 0.11, 0.03])


def within(shapes: list[Cuboid], points: np.ndarray) -> np.ndarray:
    """(n,) is each point in some solid?"""
    return np.any([np.all(np.abs(points - s.centre) <= s.half + 1e-9, axis=1) for s in shapes], axis=0)


def ends(shapes: list[Cuboid]) -> np.ndarray:
    """(2, 3) of the box around them."""
    return np.array([np.min([s.centre - s.half for s in shapes], 0), np.max([s.centre + s.half for s in shapes], 0)])


@given(inner_x=st.floats(0.25, 0.35), inner_y=st.floats(0.25, 0.35), seed=st.integers(0, 1000))
def test_the_box_is_empty_inside_and_closed_around(inner_x: float, inner_y: float, seed: int) -> None:
    wall_z, thickness = 0.11, 0.03
    shapes = box_shapes(inner_x, inner_y, wall_z, thickness)
    half = np.array([inner_x, inner_y]) / 2
    rng = np.random.default_rng(seed)
    free = rng.uniform([*(-half + 1e-6), 1e-6], [*(half - 1e-6), 0.3], (200, 3))
    assert not within(shapes, free).any()
    along, height = rng.uniform(-1, 1, 40) * (half + thickness).min(), rng.uniform(-BOX_FLOOR, wall_z - 1e-6, 40)
    for side in (-1, 1):
        for depth in (1e-6, thickness - 1e-6):
            x = np.full(40, side * (half[0] + depth))
            y = np.full(40, side * (half[1] + depth))
            assert within(shapes, np.stack([x, np.clip(along, -half[1], half[1]), height], 1)).all()
            assert within(shapes, np.stack([np.clip(along, -half[0], half[0]), y, height], 1)).all()
    low, high = ends(shapes)
    np.testing.assert_allclose(high, [*(half + thickness), wall_z], atol=1e-9)
    np.testing.assert_allclose(low, [*(-half - thickness), -BOX_FLOOR], atol=1e-9)


def test_a_lid_is_as_large_as_it_says_and_its_knob_stands_on_it() -> None:
    low, high = ends(lid_shapes(LID_SHAPE.size))
    np.testing.assert_allclose(high - low, [*LID_SHAPE.size[:2], LID_SHAPE.size[2] + LID_SHAPE.knob[2]])
    assert low[2] == -LID_SHAPE.size[2] / 2


def test_a_tray_is_hollow_and_passes_through_the_face_of_its_cabinet() -> None:
    tray, handle = drawer_shapes(DRAWER_SHAPE.front)
    deep, wide, tall = DRAWER_SHAPE.tray
    floor = DRAWER_SHAPE.floor - DRAWER_SHAPE.lift - DRAWER_SHAPE.front[2] / 2
    rng = np.random.default_rng(0)
    inner = rng.uniform([-deep, -wide / 2, floor], [-DRAWER_SHAPE.front[0] / 2, wide / 2, floor + tall], (200, 3))
    inner[:, 0] = np.clip(inner[:, 0], -deep, -DRAWER_SHAPE.front[0] / 2 - 1e-4)
    assert not within([*tray, *handle], inner + [0, 0, 1e-6]).any()
    closed = ends([s for s in tray if s.half[0] != DRAWER_SHAPE.front[0] / 2])
    cabinet = cabinet_shapes()
    # In the frame of the face, on the table.
    moved = [
        Cuboid(s.centre + [DRAWER_SHAPE.front[0] / 2, 0, DRAWER_SHAPE.lift + DRAWER_SHAPE.front[2] / 2], s.half)
        for s in tray[1:]
    ]
    assert closed[0, 0] + DRAWER_SHAPE.front[0] / 2 > -DRAWER_SHAPE.cabinet[0]
    for part in moved:
        corners = part.centre + part.half * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        assert not within(cabinet, corners).any()


@given(opening=st.floats(0.0, DRAWER_SHAPE.travel), yaw=st.floats(-np.pi, np.pi))
def test_a_drawer_is_drawn_with_its_cabinet_which_stays_where_it_is(opening: float, yaw: float) -> None:
    face = spatial.transform(spatial.matrix_from_quat(spatial.quat_from_yaw(yaw)), np.array([0.2, -0.4, 0.0]))
    middle = (DRAWER_SHAPE.front[0] / 2 + opening, 0.0, DRAWER_SHAPE.lift + DRAWER_SHAPE.front[2] / 2)
    front = face @ spatial.transform(None, np.array(middle))
    drawer = np.array([*front[:3, 3], *spatial.quat_from_yaw(yaw), opening, *DRAWER_SHAPE.front])
    middles, halves = boxes(DRAWER("d"), drawer)
    np.testing.assert_allclose(2 * halves[0], DRAWER_SHAPE.front, err_msg="first comes the front")
    cabinet = cabinet_shapes()
    stands = middles[-len(cabinet) :] @ front[:3, :3].T + front[:3, 3]
    np.testing.assert_allclose(stands, [(face @ [*part.centre, 1.0])[:3] for part in cabinet], atol=1e-9)


def test_whatever_has_a_size_is_a_body() -> None:
    middles, halves = boxes(BLOCK("b0"), BLOCK_0)
    np.testing.assert_allclose([middles[0], 2 * halves[0]], [np.zeros(3), BLOCK_0[7:]])


def test_a_scene_shows_all_but_what_has_no_place_or_size() -> None:
    weight = Type("weight", ("mass",))
    hand = np.array([0.0, 0.0, 0.3, *UPRIGHT, 0.1])
    state = State({BLOCK("b0"): BLOCK_0, BOX("box"): TRAY, ROBOT("r"): hand, weight("w"): np.ones(1)})
    solid, outlined = (scene_markers(state, ORANGE, edges) for edges in (False, True))
    assert [(m.name, m.number) for m in outlined] == [("b0", 0), *(("box", i) for i in range(5))]
    assert {(m.colour, m.outlined, m.text) for m in outlined} == {(ORANGE, True, "")}
    assert [m.text for m in solid if m.text] == ["b0", "box"]
    np.testing.assert_allclose(outlined[0].pose[:3, 3], BLOCK_0[:3])
    np.testing.assert_allclose(outlined[0].size, BLOCK_0[7:])
    name = next(m for m in solid if m.text == "b0")
    assert name.pose[2, 3] > 0.04 and name.number == 1


def test_the_outline_of_a_thing_in_the_plane_turns_with_it() -> None:
    bar = Type("bar", (*SE2, "wide", "long"), pose=SE2, extents=("long", "wide"))
    corners = outline(bar("b"), np.array([1.0, 2.0, np.pi / 2, 0.2, 0.6]))
    np.testing.assert_allclose(sorted(corners.round(9).tolist()), [[0.9, 1.7], [0.9, 2.3], [1.1, 1.7], [1.1, 2.3]])
    np.testing.assert_allclose(corners[0], [0.9, 2.3], err_msg="its front left corner, seen along the bar")
    disc = Type("disc", (*SE2, "d"), pose=SE2, extents=("d", "d"), symmetry=ROUND)
    around = outline(disc("d"), np.array([1.0, 2.0, 0.3, 0.5])) - (1.0, 2.0)
    np.testing.assert_allclose(np.linalg.norm(around, axis=1), 0.25)
    np.testing.assert_allclose(around.mean(0), 0.0, atol=1e-12)
    assert outline(Type("spot", SE2, pose=SE2)("s"), np.array([1.0, 2.0, 0.0])).tolist() == [[1.0, 2.0]]
