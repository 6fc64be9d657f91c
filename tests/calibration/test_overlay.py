"""What is drawn lies where it belongs, and a shifted robot is measured as shifted."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from resync_robot.calibration.detect import Corners, project
from resync_robot.calibration.overlay import PREDICTED, ZOOM, compare_outline, draw_corners, draw_scene, save_picture
from resync_robot.core.errors import ConfigError
from tests.calibration import synthetic
from tests.calibration.synthetic import INTRINSICS, SPEC


def scene(shift: tuple[int, int] = (0, 0)) -> tuple[np.ndarray, np.ndarray]:
    """A picture of a dark robot-like shape, and its mask."""
    mask = np.zeros((240, 424), np.uint8)
    x, y = shift
    cv2.fillPoly(mask, [np.array([[150 + x, 40 + y], [230 + x, 60 + y], [210 + x, 150 + y], [160 + x, 120 + y]])], 1)
    picture = np.where(mask[..., None] > 0, 60, 200).astype(np.uint8).repeat(3, -1)
    noise = np.random.default_rng(0).normal(0, 3, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8), mask.astype(bool)


@pytest.mark.parametrize("shift", [(0, 0), (3, 0), (0, -5), (-7, 8)])
def test_the_shift_of_the_robot_is_measured(shift: tuple[int, int]) -> None:
    picture, _ = scene(shift)
    found = compare_outline(picture, scene()[1])
    assert found is not None
    assert np.abs(found.shift_px - shift).max() <= 1.0
    assert found.error_px == pytest.approx(np.hypot(*shift), abs=1.5)
    assert found.misfit_px < 2.0
    assert not found.at_the_limit


def test_a_robot_further_off_than_is_searched_is_not_given_a_figure() -> None:
    found = compare_outline(scene((20, 0))[0], scene()[1])
    assert found is not None and found.at_the_limit


def test_without_a_robot_in_sight_there_is_nothing_to_measure() -> None:
    assert compare_outline(scene()[0], np.zeros((240, 424), dtype=bool)) is None


def test_corners_are_drawn_where_they_are_predicted() -> None:
    pose = synthetic.draw_pose(np.random.default_rng(0))
    ids = np.flatnonzero(synthetic.visible(pose))
    px = project(INTRINSICS, pose, SPEC.corners[ids])
    blank = np.full((240, 424, 3), 255, np.uint8)
    drawn = draw_corners(blank, SPEC, INTRINSICS, Corners(ids, px), pose, "title")
    assert drawn.shape[1] == 424 * ZOOM
    bar = drawn.shape[0] - 240 * ZOOM
    for x, y in (px + 0.5) * ZOOM - 0.5:
        near = drawn[round(y) + bar - 2 : round(y) + bar + 3, round(x) - 2 : round(x) + 3].reshape(-1, 3)
        assert (near == PREDICTED).all(-1).any()


def test_the_simulation_lies_over_the_right_half_only() -> None:
    picture, mask = scene()
    drawn = draw_scene(picture, np.zeros_like(picture), mask, "title")
    bar = drawn.shape[0] - 480
    left, right = drawn[bar:, :848], drawn[bar:, 848:]
    np.testing.assert_array_equal(left, cv2.resize(picture, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC))
    assert right.mean() < left.mean()


def test_a_picture_is_written_as_it_is(tmp_path: Path) -> None:
    picture, _ = scene()
    picture[..., 0] = 17
    save_picture(tmp_path / "new" / "a.png", picture)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "new" / "a.png"))[..., ::-1], picture)
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="cannot write"):
        save_picture(tmp_path / "file" / "a.png", picture)
