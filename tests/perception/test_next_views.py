"""Few pictures show each place from two sides, clear of the hand and of the box's walls, and are quick to get to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.fittings import DRAWER as BUILT
from resync_robot.core.rig import Rig
from resync_robot.perception import sights
from resync_robot.perception.next_views import FROM_TWO_SIDES, SECOND_EYE, next_views
from resync_robot.perception.scan import FURNISHED, LEAST_TIP_HEIGHT, Scan
from tests.furnished_scenes import drawer_features, lid_features
from tests.scenes import BOX_X, CORNER, INNER, box_features

BOX = box_features()
CORNERS = [(BOX_X + i * CORNER, j * CORNER) for i in (-1, 1) for j in (-1, 1)]


@pytest.fixture(scope="module")
def scan(rig: Rig) -> Scan:
    return Scan(rig)


@pytest.fixture(scope="module")
def furnished(rig: Rig) -> Scan:
    return Scan(rig, FURNISHED)


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


DRAWERS = {opening: drawer_features(opening) for opening in (0.0, BUILT.travel)}
SIGHTS = {
    "lid": sights.of_lid(lid_features(on=False)),
    "closed drawer": sights.of_drawer(DRAWERS[0.0], BUILT),
    "open drawer": sights.of_drawer(DRAWERS[BUILT.travel], BUILT),
}


def shows(rig: Rig, q: np.ndarray, points: np.ndarray) -> bool:
    camera = rig.camera("wrist")
    x, y, z = spatial.apply(spatial.inverse(camera_at(rig, q)), points).T
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    return bool(np.all((u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)))


@pytest.mark.parametrize("name", SIGHTS)
def test_two_views_show_all_edges_of_a_lid_or_a_drawer(rig: Rig, furnished: Scan, name: str) -> None:
    solids = sights.cabinet_and_front(DRAWERS[BUILT.travel if "open" in name else 0.0], BUILT)
    views = next_views(furnished, rig, [], BOX, rig.arm.home, False, [SIGHTS[name]], solids)
    assert len(views) == 2
    assert all(any(shows(rig, q, patch) for q in views) for patch in SIGHTS[name].patches)


def test_a_front_is_looked_at_from_where_both_eyes_see_it_past_its_cabinet(rig: Rig, furnished: Scan) -> None:
    cabinet, front = sights.cabinet_and_front(DRAWERS[0.0], BUILT)
    views = next_views(furnished, rig, [], BOX, rig.arm.home, False, [SIGHTS["closed drawer"]], [cabinet, front])
    edge = [patch for patch in SIGHTS["closed drawer"].patches if patch[:, 2].max() < cabinet.half[2]]
    for patch in edge:
        seen_by = [q for q in views if shows(rig, q, patch)]
        eyes = [camera_at(rig, q) @ np.array([[0, 0, 0, 1], [SECOND_EYE, 0, 0, 1]]).T for q in seen_by]
        ways = [e[:3, i] + np.linspace(0, 1, 200)[:, None, None] * (patch - e[:3, i]) for e in eyes for i in (0, 1)]
        clear = [not cabinet.contains(w).any() for w in ways]
        assert any(all(clear[i : i + 2]) for i in range(0, len(clear), 2))


def test_few_views_show_every_place_in_a_box_from_two_sides(rig: Rig, furnished: Scan) -> None:
    sight = sights.of_box(BOX)
    views = next_views(furnished, rig, [], BOX, rig.arm.home, False, [sight])
    assert 2 < len(views) <= 4
    assert all(any(shows(rig, q, patch) for q in views) for patch in sight.once)
    for patch in sight.from_two_sides:
        place = patch[:, :2].mean(axis=0)
        away = [camera_at(rig, q)[:2, 3] - place for q in views if shows(rig, q, patch)]
        directions = np.array([a / np.linalg.norm(a) for a in away])
        assert (directions @ directions.T).min() < FROM_TWO_SIDES


def test_once_is_enough_where_nothing_asks_for_two_sides(rig: Rig, scan: Scan) -> None:
    block = sights.of_block((0.48, 0.0))
    once = replace(block, once=block.from_two_sides, from_two_sides=())
    assert len(next_views(scan, rig, [], BOX, rig.arm.home, False, [once])) == 1


def test_nobody_looks_at_a_place_through_something_solid(rig: Rig, furnished: Scan) -> None:
    place = np.array([0.48, 0.0, 0.05])
    quickest, _ = next_views(furnished, rig, [place[:2]], BOX, rig.arm.home, False)
    between = (place + camera_at(rig, quickest)[:3, 3]) / 2
    solid = sights.Solid(spatial.transform(None, between), np.full(3, 0.02))
    views = next_views(furnished, rig, [place[:2]], BOX, rig.arm.home, False, solids=[solid])
    assert len(views) == 2
    for q in views:
        eye = camera_at(rig, q)[:3, 3]
        assert not solid.contains(eye + np.linspace(0, 1, 200)[:, None] * (place - eye)).any()
