"""A camera is found where it is; views that disagree are found; what does not determine a pose is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.calibration.board import BoardSpec
from resync_robot.calibration.hand_eye import Calibrator, View, difference, second_tilt_deg
from resync_robot.core import spatial
from resync_robot.core.errors import CalibrationError
from tests.calibration import synthetic
from tests.calibration.synthetic import INTRINSICS, SPEC

MOUNTS = pytest.mark.parametrize("arm_moves_board", [False, True], ids=["eye-in-hand", "eye-to-base"])


def made(seed: int, arm_moves_board: bool, count: int = 20, tilt: float = 45.0, **noise: float):
    rng = np.random.default_rng(seed)
    setup = synthetic.draw_setup(rng, arm_moves_board, **noise)
    calibrator = Calibrator(SPEC, INTRINSICS, arm_moves_board)
    return rng, setup, calibrator, synthetic.draw_views(rng, setup, count, tilt)


@MOUNTS
def test_without_noise_the_pose_is_exact(arm_moves_board: bool) -> None:
    _, setup, calibrator, views = made(0, arm_moves_board, 10, pixel_px=0.0, arm_position=0.0)
    found = calibrator.solve(views)
    assert difference(found.mount_T_cam, setup.mount_T_cam) == pytest.approx((0, 0), abs=1e-3)
    assert difference(found.other_T_board, setup.other_T_board) == pytest.approx((0, 0), abs=1e-3)
    assert found.kept.all() and found.scale == pytest.approx(1.0, abs=1e-5)


@MOUNTS
def test_with_the_noise_of_a_real_rig_it_is_close_and_says_how_close(arm_moves_board: bool) -> None:
    errors, sigmas = [], []
    for seed in range(4):
        _, setup, calibrator, views = made(seed, arm_moves_board)
        found = calibrator.solve(views)
        errors.append(difference(found.mount_T_cam, setup.mount_T_cam))
        sigmas.append((1000 * found.position_sigma, np.degrees(found.rotation_sigma)))
        assert found.noise_scale == pytest.approx(1.0, abs=0.15)
    position, rotation = np.median(errors, axis=0)
    assert position < 0.6 and rotation < 0.12
    assert 0.3 < np.sqrt(np.mean(np.square(np.array(errors) / sigmas))) < 2.0


@MOUNTS
def test_all_corners_together_beat_the_closed_form(arm_moves_board: bool) -> None:
    gains = []
    for seed in range(4):
        _, setup, calibrator, views = made(seed + 10, arm_moves_board)
        closed, _, apart = calibrator._closed_form(views)
        assert apart[0] < 10.0
        found = calibrator.solve(views)
        gains.append(difference(closed, setup.mount_T_cam)[0] / difference(found.mount_T_cam, setup.mount_T_cam)[0])
    assert np.median(gains) > 1.2


@MOUNTS
@pytest.mark.parametrize("seed", range(3))
def test_five_bad_views_of_25_are_found_and_no_good_one_is_blamed(arm_moves_board: bool, seed: int) -> None:
    rng, setup, calibrator, views = made(seed, arm_moves_board, 25)
    found = calibrator.solve(synthetic.spoil(rng, setup, views))
    assert found.kept.tolist() == [False] * 5 + [True] * 20
    assert (found.distances[:5] > 1.0).all() and (found.distances[5:] <= 1.0).all()
    assert difference(found.mount_T_cam, setup.mount_T_cam)[0] < 1.0


def test_the_order_of_the_views_does_not_matter() -> None:
    rng, setup, calibrator, views = made(3, False, 20)
    views = synthetic.spoil(rng, setup, views)
    order = rng.permutation(len(views))
    first, second = calibrator.solve(views), calibrator.solve([views[i] for i in order])
    assert (first.kept[order] == second.kept).all()
    assert difference(first.mount_T_cam, second.mount_T_cam) == pytest.approx((0, 0), abs=1e-3)


@settings(max_examples=5)
@given(st.integers(0, 1000))
def test_where_the_world_begins_does_not_matter(seed: int) -> None:
    """flange_T_cam is the same if every pose of the arm is given in another world."""
    _, _, calibrator, views = made(4, False, 10)
    elsewhere = synthetic.jolt(np.random.default_rng(seed), 1.0, 1.0)
    shifted = [replace(v, mount_T_other=v.mount_T_other @ elsewhere) for v in views]
    here, there = calibrator.solve(views), calibrator.solve(shifted)
    assert difference(here.mount_T_cam, there.mount_T_cam) == pytest.approx((0, 0), abs=2e-3)
    expected = spatial.inverse(elsewhere) @ here.other_T_board
    assert difference(there.other_T_board, expected) == pytest.approx((0, 0), abs=2e-3)


def refused(calibrator: Calibrator, views: list[View]) -> str:
    with pytest.raises(CalibrationError) as error:
        calibrator.solve(views)
    assert error.value.fix
    return str(error.value)


def test_too_few_views_are_refused() -> None:
    _, _, calibrator, views = made(0, False, 7)
    assert "7 usable views" in refused(calibrator, views)
    assert "0 usable views" in refused(calibrator, [])


def test_too_flat_views_are_refused() -> None:
    _, _, calibrator, views = made(0, False, 12, tilt=6.0)
    said = refused(calibrator, views)
    assert "too flat" in said and "--most-tilt" in said


def test_one_view_again_and_again_is_refused() -> None:
    _, _, calibrator, views = made(0, False, 1)
    assert refused(calibrator, views * 10)


def test_a_board_that_moved_half_way_is_refused() -> None:
    rng, setup, calibrator, views = made(0, False, 10)
    after = synthetic.draw_views(rng, synthetic.moved(rng, setup, 0.05), 10)
    assert "board moved" in refused(calibrator, views + after)


@pytest.mark.parametrize("true_square", [0.030, 0.033])
def test_a_board_of_another_size_is_refused_with_its_true_size(true_square: float) -> None:
    _, _, _, views = made(1, False, 16)
    # The views are of a board of SPEC.square; whoever calibrates believes in another size.
    believed = BoardSpec(square=SPEC.square**2 / true_square, marker=0.024)
    calibrator = Calibrator(believed, INTRINSICS, False)
    mistaken = [calibrator.view(v.name, spatial.inverse(v.mount_T_other), v.corners) for v in views]
    said = refused(calibrator, mistaken)
    assert "measures squares of" in said
    measured = float(said.split("--board.square ")[1].split()[0])
    assert measured == pytest.approx(SPEC.square, rel=0.01)


def test_tilt_counts_the_second_axis_only() -> None:
    def view(turn: np.ndarray) -> View:
        return View("", spatial.transform(turn), synthetic.Corners(np.arange(4), np.zeros((4, 2))), np.eye(4))

    spin = [view(spatial.rotation_about("z", a)) for a in np.linspace(-1, 1, 9)]
    assert second_tilt_deg(spin) == pytest.approx(0.0, abs=1e-6)
    tilted = [*spin, *(view(spatial.rotation_about("x", a)) for a in np.linspace(-1, 1, 9))]
    assert second_tilt_deg(tilted) > 15.0
