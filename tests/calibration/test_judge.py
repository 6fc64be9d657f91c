"""The error reported on held-out views is the error on views that nobody has seen."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.calibration.hand_eye import Calibrator, Noise
from resync_robot.calibration.judge import HeldOutErrors, board_by, held_out, judge
from resync_robot.core import spatial
from resync_robot.core.errors import CalibrationError
from tests.calibration import synthetic
from tests.calibration.synthetic import INTRINSICS, SPEC


def calibrator() -> Calibrator:
    return Calibrator(SPEC, INTRINSICS, False)


def test_held_out_errors_are_those_on_fresh_views() -> None:
    ratios = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        setup = synthetic.draw_setup(rng, False)
        views = synthetic.draw_views(rng, setup, 20)
        found = calibrator().solve(views)
        reported = held_out(calibrator(), views, found)
        assert reported.mm.shape == reported.deg.shape == reported.px.shape == (20,)
        fresh = synthetic.draw_views(rng, setup, 80)
        true = judge(calibrator(), fresh, found.mount_T_cam, setup.other_T_board)
        ratios.append(np.array(reported.rms) / true.rms)
    assert np.median(ratios, axis=0) == pytest.approx(np.ones(3), abs=0.2)


def test_the_truth_is_judged_faultless_and_a_shift_by_its_length() -> None:
    rng = np.random.default_rng(0)
    setup = synthetic.draw_setup(rng, False, pixel_px=0.0, arm_position=0.0)
    views = synthetic.draw_views(rng, setup, 5)
    exact = judge(calibrator(), views, setup.mount_T_cam, setup.other_T_board)
    assert exact.rms == pytest.approx((0, 0, 0), abs=1e-3)
    shifted = setup.mount_T_cam @ spatial.transform(None, np.array([0.0, 0.003, 0.0]))
    found = judge(calibrator(), views, shifted, setup.other_T_board)
    assert found.mm == pytest.approx(np.full(5, 3.0), abs=1e-2)
    assert found.deg == pytest.approx(np.zeros(5), abs=1e-2)
    assert (found.px > 1.0).all()


def test_the_board_is_placed_in_the_middle_of_the_views() -> None:
    rng = np.random.default_rng(1)
    setup = synthetic.draw_setup(rng, False)
    views = synthetic.spoil(rng, setup, synthetic.draw_views(rng, setup, 20))
    board = board_by(calibrator(), views, setup.mount_T_cam)
    off = spatial.apply(board, SPEC.centre[None]) - spatial.apply(setup.other_T_board, SPEC.centre[None])
    assert np.linalg.norm(off) < 1e-3, "a quarter of the views being bad must not pull it away"


def test_views_that_are_too_few_to_hold_any_out_are_refused() -> None:
    rng = np.random.default_rng(0)
    setup = synthetic.draw_setup(rng, False)
    views = synthetic.draw_views(rng, setup, 8)
    with pytest.raises(CalibrationError, match="no honest judgement"):
        held_out(calibrator(), views, calibrator().solve(views))


@pytest.mark.parametrize("arm_moves_board", [False, True])
def test_what_noise_does_to_a_view_is_foretold(arm_moves_board: bool) -> None:
    rng = np.random.default_rng(3)
    noise = Noise()
    setup = synthetic.draw_setup(rng, arm_moves_board, arm_rotation=noise.arm_rotation)
    one = Calibrator(SPEC, INTRINSICS, arm_moves_board, noise)
    pose = setup.mount_T_cam @ synthetic.draw_pose(rng) @ spatial.inverse(setup.other_T_board)
    flange = pose if arm_moves_board else spatial.inverse(pose)
    errors = judge(one, synthetic.views_from(rng, setup, [flange] * 300), setup.mount_T_cam, setup.other_T_board)
    view = synthetic.views_from(rng, setup, [flange])[0]
    variance = np.diag(one.location_covariance(view, setup.mount_T_cam, setup.other_T_board))
    assert errors.rms[0] == pytest.approx(1000 * np.sqrt(variance[3:].sum()), rel=0.12)
    assert errors.rms[1] == pytest.approx(np.degrees(np.sqrt(variance[:3].sum())), rel=0.12)


def test_errors_that_noise_does_not_describe_are_reported_as_they_are() -> None:
    mm, deg, px = np.full(20, 2.0), np.full(20, 0.1), np.full(20, 0.3)
    expected = np.tile([0.5, 0.1], (20, 1))
    odd = HeldOutErrors(mm, deg, px, np.full(20, 1.2), expected)
    assert odd.rms == pytest.approx((2.0, 0.12, 0.3))
    usual = HeldOutErrors(mm / 4 * 1.3, deg, px, np.full(20, 1.2), expected)
    assert usual.rms == pytest.approx((0.6, 0.12, 0.3))
