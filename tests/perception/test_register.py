from __future__ import annotations

from dataclasses import replace

import numpy as np

from resync_robot.core import spatial
from resync_robot.core.rig import Rig
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.register import align_to_box
from resync_robot.perception.segment import ColourSegmenter
from resync_robot.perception.views import View, make_view
from tests.perception.raycast import CENTRE, FLOOR, INNER, RIM, THICKNESS, Table

BOX = np.array([*CENTRE, FLOOR, 1, 0, 0, 0, INNER, INNER, RIM - FLOOR, THICKNESS])
AT_BLOCK = np.array([[0.46, 0.28, 0.05], [0.46, -0.28, 0.05], [0.40, 0.10, 0.05]])


def displacement(view: View, true: View) -> float:
    """m, the mean by which the view misplaces points where blocks stand."""
    error = view.world_T_cam @ spatial.inverse(true.world_T_cam)
    return float(np.linalg.norm((spatial.apply(error, AT_BLOCK) - AT_BLOCK)[:, :2], axis=1).mean())


def test_views_are_moved_to_where_they_were_taken(rig: Rig, catalogue: Catalogue) -> None:
    rng = np.random.default_rng(0)
    camera = replace(rig.camera("wrist"), position_sigma=0.003, rotation_sigma=0.01)
    before, after = [], []
    for frame in Table(rig, catalogue).scan():
        true = make_view(frame, ColourSegmenter(catalogue), catalogue, rig)
        error = spatial.transform(spatial.rotation_about("z", rng.normal(0, 0.01)), np.array([0.0, 0.0, 0.0]))
        about = spatial.transform(None, true.world_T_cam[:3, 3])
        error = about @ error @ spatial.inverse(about)
        error[:2, 3] += rng.normal(0, 0.003, 2)
        wrong = true.moved(error @ true.world_T_cam)
        before.append(displacement(wrong, true))
        after.append(displacement(align_to_box(wrong, BOX, catalogue, camera), true))
    assert np.mean(before) > 0.003
    assert np.max(after) < 0.001


def test_a_camera_that_is_trusted_stays(rig: Rig, catalogue: Catalogue) -> None:
    frame = Table(rig, catalogue).scan()[1]
    view = make_view(frame, ColourSegmenter(catalogue), catalogue, rig)
    exact = replace(rig.camera("wrist"), position_sigma=0.0, rotation_sigma=0.0)
    elsewhere = BOX + np.array([0.003, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0])
    assert displacement(align_to_box(view, elsewhere, catalogue, exact), view) < 0.0006


def test_a_view_without_the_box_stays(rig: Rig, catalogue: Catalogue) -> None:
    view = make_view(Table(rig, catalogue).scan()[0], ColourSegmenter(catalogue), catalogue, rig)
    far = BOX + np.array([3.0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0])
    assert align_to_box(view, far, catalogue, rig.camera("wrist")) is view
