"""Corners are found where they are; a picture of no use is refused with the reason."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.calibration.board import BoardSpec
from resync_robot.calibration.detect import BoardDetector, Gate, Rejected, Sighting, locate, project
from resync_robot.core import spatial
from tests.calibration import synthetic
from tests.calibration.synthetic import INTRINSICS, SPEC

DETECT = BoardDetector(SPEC, INTRINSICS)


def pose(tilt: float = 0.4, depth: float = 0.42) -> np.ndarray:
    turn = spatial.rotation_about("x", tilt) @ spatial.rotation_about("z", 0.3)
    return spatial.transform(turn, np.array([0.01, 0.0, depth]) - turn @ SPEC.centre)


def reason(picture: np.ndarray, detect: BoardDetector = DETECT) -> str:
    verdict = detect(picture)
    assert isinstance(verdict, Rejected)
    return verdict.reason


@pytest.mark.parametrize("seed", range(4))
def test_corners_are_found_where_they_are(seed: int) -> None:
    true = synthetic.draw_pose(np.random.default_rng(seed))
    found = DETECT(synthetic.photograph(true))
    assert isinstance(found, Sighting)
    misses = found.corners.px - project(INTRINSICS, true, SPEC.corners[found.corners.ids])
    # A systematic half pixel, of the finder's or of the magnification's, would show in the mean.
    assert np.abs(misses.mean(0)).max() < 0.06
    assert np.sqrt((misses**2).mean()) < 0.15
    shift = spatial.apply(found.cam_T_board, SPEC.centre[None]) - spatial.apply(true, SPEC.centre[None])
    assert np.linalg.norm(shift) < 1e-3
    assert (np.diff(found.corners.ids) > 0).all()


def test_a_picture_without_a_board_is_refused() -> None:
    assert "no board" in reason(np.full((240, 424, 3), 128, np.uint8))
    assert "brightness 0" in reason(np.zeros((240, 424, 3), np.uint8))


def test_another_board_is_refused_as_such() -> None:
    other = BoardDetector(BoardSpec(columns=6, rows=8, dictionary="5x5_50"), INTRINSICS)
    assert "no board of 5x5_50" in reason(synthetic.photograph(pose()), other)


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("columns", [6, 7])
def test_a_board_of_the_other_layout_of_opencv_is_named(legacy: bool, columns: int) -> None:
    printed = BoardSpec(columns=columns, square=0.028, marker=0.021, legacy=legacy)
    picture = synthetic.photograph(pose(), printed)
    said = reason(picture, BoardDetector(replace(printed, legacy=not legacy), INTRINSICS))
    assert said.endswith("before version 4.6: give --board.legacy" if legacy else "4.6: leave out --board.legacy")
    found = BoardDetector(printed, INTRINSICS)(picture)
    assert isinstance(found, Sighting) and found.blur_px < 2.0
    assert np.linalg.norm(found.cam_T_board[:3, 3] - pose()[:3, 3]) < 2e-3


def test_a_board_in_another_layout_is_refused() -> None:
    other = BoardDetector(BoardSpec(columns=9, rows=5, square=0.032, marker=0.024), INTRINSICS)
    said = reason(synthetic.photograph(pose()), other)
    assert "layout" in said or "too few corners" in said or "corners of the board" in said


def test_a_blurred_picture_is_refused_though_its_corners_are_found() -> None:
    sharp = synthetic.photograph(pose(depth=0.3))
    blurred = cv2.GaussianBlur(sharp, (0, 0), 1.3)
    assert "blurred" in reason(blurred)
    assert isinstance(DETECT(sharp), Sighting)
    smeared = cv2.filter2D(sharp, -1, np.ones((1, 4)) / 4)
    assert "blurred" in reason(smeared), "motion along one axis is blur too"


def test_a_far_board_is_refused() -> None:
    near_only = BoardDetector(SPEC, INTRINSICS, Gate(least_square_px=24.0))
    assert "too far away (0.4" in reason(synthetic.photograph(pose(depth=0.45)), near_only)


def test_a_board_that_is_mostly_out_of_sight_is_refused() -> None:
    picture = synthetic.photograph(pose())
    picture[:, 215:] = 128
    assert "corners of the board are in sight" in reason(picture)
    picture[:, 190:] = 128
    assert "too few corners between them: show more" in reason(picture)


def test_a_bent_board_is_refused() -> None:
    picture = synthetic.photograph(pose(0.0, 0.35))
    y, x = np.mgrid[:240, :424].astype(np.float32)
    bent = cv2.remap(picture, x + 6 * np.sin(y / 30).astype(np.float32), y, cv2.INTER_LINEAR)
    assert "flat board" in reason(bent)


def test_corners_on_a_line_have_no_pose() -> None:
    corners = synthetic.Corners(np.arange(4), np.column_stack([np.arange(4) * 20.0, np.full(4, 50.0)]))
    found, misfit = locate(SPEC, corners, INTRINSICS)
    assert found is None or np.isfinite(misfit)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(1, 90), st.integers(1, 90))
def test_no_picture_crashes_it(seed: int, height: int, width: int) -> None:
    noise = np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)
    assert isinstance(DETECT(noise), Rejected | Sighting)
