"""A wrong camera matrix and a bending lens are seen; a right one is left alone."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from resync_robot.calibration.detect import Corners
from resync_robot.calibration.intrinsics import check_intrinsics
from resync_robot.core.errors import CalibrationError
from resync_robot.core.rig import load_rig
from tests.calibration import synthetic
from tests.calibration.synthetic import INTRINSICS, SPEC

CAMERA = load_rig().camera("wrist")


def views(count: int = 15, most_tilt_deg: float = 45.0, lens: float = 0.0) -> list[Corners]:
    rng = np.random.default_rng(0)
    found = []
    for _ in range(count):
        pose = synthetic.draw_pose(rng, most_tilt_deg)
        ids = np.flatnonzero(synthetic.visible(pose))
        turn = cv2.Rodrigues(pose[:3, :3])[0]
        px = cv2.projectPoints(SPEC.corners[ids], turn, pose[:3, 3], INTRINSICS, np.array([lens, 0, 0, 0, 0]))[0]
        found.append(Corners(ids, px[:, 0] + rng.normal(0, 0.1, (len(ids), 2))))
    return found


def test_a_right_matrix_is_confirmed() -> None:
    found = check_intrinsics(SPEC, CAMERA, views())
    assert found.rig_px < 1.0 and found.distortion_px < 1.0
    assert found.held_out_px == pytest.approx(0.1 * np.sqrt(2), rel=0.2)
    np.testing.assert_array_less(np.abs(found.matrix - INTRINSICS)[[0, 1, 0, 1], [0, 1, 2, 2]], 5 * found.sigma_px)


def test_a_wrong_matrix_and_a_bending_lens_are_seen() -> None:
    wrong = replace(CAMERA, fx=CAMERA.fx * 1.05, cx=CAMERA.cx + 6)
    found = check_intrinsics(SPEC, wrong, views())
    assert found.rig_px > 8.0
    assert found.matrix[0, 0] == pytest.approx(308.6, abs=2.0)
    assert check_intrinsics(SPEC, CAMERA, views(lens=-0.2)).distortion_px > 5.0


def test_too_few_or_too_flat_views_are_refused() -> None:
    with pytest.raises(CalibrationError, match="7 usable views"):
        check_intrinsics(SPEC, CAMERA, views(7))
    flat = views(10, most_tilt_deg=0.01)
    with pytest.raises(CalibrationError, match="do not determine"):
        check_intrinsics(SPEC, CAMERA, flat)
