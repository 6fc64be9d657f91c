"""Objects as boxes, and as markers of a scene."""

from __future__ import annotations

import numpy as np

from resync_robot.core.solids import boxes, outline, scene_markers
from resync_robot.core.state import State
from resync_robot.core.symbols import ROUND, SE2, Type
from resync_robot.core.vocabulary import BLOCK, BOX, DRAWER, ROBOT

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
ORANGE = (1.0, 0.5, 0.0, 1.0)
BLOCK_0 = np.array([0.4, 0.1, 0.02, *UPRIGHT, 0.06, 0.05, 0.04])
TRAY = np.array([0.45, 0.0, 0.005, *UPRIGHT, 0.3, 0.2, 0.11, 0.03])
FRONT = np.array([0.1, 0.2, 0.3, *UPRIGHT, 0.05, 0.02, 0.3, 0.1])


def test_a_box_is_floor_and_walls_around_its_inside() -> None:
    middles, halves = boxes(BOX("box"), TRAY)
    low, high = (middles - halves).min(axis=0), (middles + halves).max(axis=0)
    np.testing.assert_allclose(high, [0.18, 0.13, 0.11])
    np.testing.assert_allclose(low[:2], [-0.18, -0.13])
    inside = np.array([[0.0, 0.0, 0.05], [0.149, 0.099, 0.001], [-0.149, -0.099, 0.109]])
    assert not (np.abs(inside[:, None] - middles) < halves).all(axis=-1).any()


def test_whatever_has_a_size_is_a_body() -> None:
    for obj, features, size in ((BLOCK("b0"), BLOCK_0, BLOCK_0[7:]), (DRAWER("d"), FRONT, FRONT[8:])):
        middles, halves = boxes(obj, features)
        np.testing.assert_allclose([middles[0], 2 * halves[0]], [np.zeros(3), size])


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
