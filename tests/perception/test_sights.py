"""What must be seen of a thing lies where the thing is, and a cuboid hides what is behind it."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.fittings import DRAWER as BUILT
from resync_robot.core.fittings import LID as PLATE
from resync_robot.perception import sights
from tests.furnished_scenes import FACE, drawer_features, lid_features
from tests.scenes import BOX_X, INNER, box_features


def points_of(sight: sights.Sight) -> np.ndarray:
    return np.vstack(sight.patches)


@pytest.mark.parametrize("on", [True, False])
def test_of_a_lid_both_sides_of_each_edge_are_to_be_seen(on: bool) -> None:
    features = lid_features(on, yaw=0.3)
    local = spatial.apply(spatial.inverse(spatial.pose_from_features(features[:7])), points_of(sights.of_lid(features)))
    half = PLATE.size[0] / 2
    for axis in (0, 1):
        for end in (-half, half):
            near = local[np.abs(local[:, axis] - end) < 0.02]
            assert (np.abs(near[:, axis]) > half).any() and (np.abs(near[:, axis]) < half).any()
            assert np.ptp(near[:, 1 - axis]) >= 2 * half
    assert np.all(local[:, 2] > PLATE.size[2] / 2)


@pytest.mark.parametrize("opening", [0.0, BUILT.travel])
def test_of_a_drawer_the_top_of_the_cabinet_is_to_be_seen_and_the_front_however_far_it_is_open(opening: float) -> None:
    points = points_of(sights.of_drawer(drawer_features(opening), BUILT))
    high = points[:, 2] > BUILT.cabinet[2]
    for on, (least, most) in ((high, (0.0, BUILT.cabinet[0])), (~high, (-BUILT.travel - BUILT.front[0], 0.0))):
        assert least - 0.02 < points[on, 0].min() - FACE[0] < least + 1e-6
        assert most - 0.02 < points[on, 0].max() - FACE[0] < most + 0.02
        assert np.abs(points[on, 1] - FACE[1]).max() == pytest.approx(BUILT.cabinet[1] / 2, abs=0.02)


def test_a_look_into_a_box_makes_sure_of_a_block_in_each_corner() -> None:
    sight = sights.of_box(box_features())
    middles = np.array([patch[:, :2].mean(axis=0) for patch in sight.from_two_sides])
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            place = np.array([BOX_X + i * INNER / 2, j * INNER / 2])
            assert np.abs(middles - place).max(axis=1).min() <= sights.WITHIN_WALLS + 1e-9


def test_a_drawer_hides_what_is_inside_its_cabinet_or_its_front() -> None:
    cabinet, front = sights.cabinet_and_front(drawer_features(0.1), BUILT)
    inside, before = np.array([FACE[0] + 0.1, FACE[1], 0.1]), np.array([FACE[0] - 0.05, FACE[1], 0.05])
    in_front = np.array([FACE[0] - 0.106, FACE[1], 0.05])
    assert cabinet.contains(np.array([[inside, before], [in_front, inside]])).tolist() == [[True, False], [False, True]]
    assert front.contains(np.array([inside, before, in_front])).tolist() == [False, False, True]
