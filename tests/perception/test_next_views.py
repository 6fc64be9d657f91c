"""Few pictures show each place from two sides, clear of the hand and of the box's walls, and are quick to get to."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.rig import Rig
from resync_robot.perception.next_views import FROM_TWO_SIDES, next_views
from resync_robot.perception.scan import LEAST_TIP_HEIGHT, Scan
from tests.scenes import BOX_X, CORNER, INNER, box_features

BOX = box_features()
CORNERS = [(BOX_X + i * CORNER, j * CORNER) for i in (-1, 1) for j in (-1, 1)]


@pytest.fixture(scope="module")
def scan(rig: Rig) -> Scan:
    return Scan(rig)


def camera_at(rig: Rig, q: np.ndarray) -> np.ndarray:
    return rig.arm.world_T_base @ rig.arm.kinematics.forward(q) @ rig.camera("wrist").pose


def way(begin: np.ndarray, configurations: list[np.ndarray]) -> float:
    return sum(float(np.abs(b - a).max()) for a, b in zip([begin, *configurations], configurations, strict=False))


@pytest.mark.parametrize("place", [(0.48, 0.0), *CORNERS, (0.45, 0.28)])
@pytest.mark.parametrize("holding", [False, True])
def test_a_place_is_seen_whole_from_two_sides(rig: Rig, scan: Scan, place: tuple[float, float], holding: bool) -> None:
    camera = rig.camera("wrist")
    views = next_views(scan, rig, [np.array(place)], BOX, rig.arm.home, holding)
    assert len(views) == 2
    directions = []
    for q in views:
        assert rig.tip_pose(q)[2, 3] >= LEAST_TIP_HEIGHT - 1e-6
        pose = camera_at(rig, q)
        for dx, dy in ((-0.03, -0.03), (-0.03, 0.03), (0.03, -0.03), (0.03, 0.03)):
            x, y, z = spatial.apply(spatial.inverse(pose), np.array([[place[0] + dx, place[1] + dy, 0.05]]))[0]
            u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
            assert 0 < u < camera.width and 0 < v < camera.height
        directions.append(pose[:2, 3] - place)
    a, b = (d / np.linalg.norm(d) for d in directions)
    assert a @ b < FROM_TWO_SIDES


@pytest.mark.parametrize("place", CORNERS)
def test_a_corner_is_not_looked_into_over_its_walls(rig: Rig, scan: Scan, place: tuple[float, float]) -> None:
    for q in next_views(scan, rig, [np.array(place)], BOX, rig.arm.home, False):
        x, y = camera_at(rig, q)[:2, 3]
        assert max(abs(x - BOX_X), abs(y)) < INNER / 2 + 0.01


def test_two_views_do_for_places_that_are_near_each_other(rig: Rig, scan: Scan) -> None:
    places = [np.array([0.48, 0.0]), np.array([0.40, 0.10])]
    assert len(next_views(scan, rig, places, BOX, rig.arm.home, False)) == 2
    # Which one is named first does not matter, and the way is shorter than that of any whole round.
    turned = next_views(scan, rig, places[::-1], BOX, rig.arm.home, False)
    assert len(turned) == 2
    assert way(rig.arm.home, turned) < way(rig.arm.home, scan.configurations) / 2


def test_places_that_no_picture_shows_together_get_views_of_their_own(rig: Rig, scan: Scan) -> None:
    places = [np.array([0.40, 0.34]), np.array([0.52, -0.34])]
    views = next_views(scan, rig, places, BOX, rig.arm.home, False)
    assert 2 < len(views) <= 4


def test_the_views_are_those_that_are_near(rig: Rig, scan: Scan) -> None:
    place = np.array([0.48, 0.0])
    from_home = next_views(scan, rig, [place], BOX, rig.arm.home, False)
    turned = rig.arm.home + [0, 0, 0, 0, 0, np.pi / 2]
    from_there = next_views(scan, rig, [place], BOX, turned, False)
    assert way(turned, from_there) < way(turned, from_home)


def test_a_place_out_of_reach_is_not_looked_at(rig: Rig, scan: Scan) -> None:
    assert next_views(scan, rig, [np.array([1.6, 0.0])], BOX, rig.arm.home, False) == []
