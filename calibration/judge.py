"""How good a calibration is, by views that it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from resync_robot.calibration.detect import project
from resync_robot.calibration.hand_eye import Calibrator, HandEye, View
from resync_robot.core import spatial
from resync_robot.core.errors import CalibrationError

FOLDS = 5
DESCRIBES = 1.6
"""Factor up to which the plain figure may depart from the pooled one by chance: twenty views leave a sixth (sigma)."""


@dataclass(frozen=True)
class Errors:
    """Per view: where it puts the board's centre against where it is, how it turns it, and where its corners appear.

    Of one picture each: the noise of its pixels and of the arm's pose is in them, as it is in any use of the camera.

    Attributes:
        mm, deg, px: (n,) each; `px` is root mean square over a view's corners.
    """

    mm: Float[np.ndarray, " n"]
    deg: Float[np.ndarray, " n"]
    px: Float[np.ndarray, " n"]

    @property
    def rms(self) -> tuple[float, float, float]:
        """Root mean squares: mm, degrees, px."""
        return rms(self.mm), rms(self.deg), rms(self.px)


def judge(
    calibrator: Calibrator,
    views: Sequence[View],
    mount_T_cam: Float[np.ndarray, "4 4"],
    other_T_board: Float[np.ndarray, "4 4"],
) -> Errors:
    """Errors of the given poses on the given views."""
    spec = calibrator.spec
    rows = []
    for view in views:
        located = spatial.inverse(view.mount_T_other) @ mount_T_cam @ view.cam_T_board
        centres = [spatial.apply(pose, spec.centre[None])[0] for pose in (located, other_T_board)]
        turn = spatial.rotation_vector(located[:3, :3].T @ other_T_board[:3, :3])
        predicted = calibrator.predicted(view, mount_T_cam, other_T_board)
        misses = project(calibrator.intrinsics, predicted, spec.corners[view.corners.ids]) - view.corners.px
        rows.append(
            [
                1000 * np.linalg.norm(centres[0] - centres[1]),
                np.degrees(np.linalg.norm(turn)),
                np.sqrt(np.mean(np.sum(misses**2, -1))),
            ]
        )
    return Errors(*np.array(rows).reshape(-1, 3).T)


@dataclass(frozen=True)
class HeldOutErrors(Errors):
    """Errors of views that a calibration has not seen, few and of unequal worth: a steep view tells the board's turn
    much better than a flat one, so the plain mean of twenty squares hangs on a handful of them.

    Attributes:
        scale: (n,) how far each view is off, in units of what pixels and arm are expected to give, over all six
            directions at once.
        expected: (n, 2) mm and degrees that these give.
    """

    scale: Float[np.ndarray, " n"]
    expected: Float[np.ndarray, "n 2"]

    @property
    def rms(self) -> tuple[float, float, float]:
        """Root mean squares: mm, degrees, px. The first two as expected, times how much the views are off as a whole;
        as they are where that does not describe them."""
        plain = super().rms
        pooled = [rms(self.scale) * rms(self.expected[:, i]) for i in (0, 1)]
        mm, deg = (p if 1 / DESCRIBES < r / p < DESCRIBES else r for p, r in zip(pooled, plain, strict=False))
        return mm, deg, plain[2]


def held_out(calibrator: Calibrator, views: Sequence[View], result: HandEye) -> HeldOutErrors:
    """Errors on each kept view by a calibration from the other folds: an honest figure from the views at hand.

    Raises:
        CalibrationError: without a fold there are too few views, or too flat ones.
    """
    good = [v for v, k in zip(views, result.kept, strict=True) if k]
    folds: list[Errors] = []
    shares: list[tuple[float, float, float]] = []
    for fold in range(FOLDS):
        rest = [v for i, v in enumerate(good) if i % FOLDS != fold]
        try:
            part = calibrator.solve(rest)
        except CalibrationError as error:
            raise CalibrationError(
                f"no honest judgement: with a fifth of the views held out, {error.what}",
                "take more views: resync-robot calibrate hand-eye --poses 20",
            ) from None
        folds.append(judge(calibrator, good[fold::FOLDS], part.mount_T_cam, part.other_T_board))
        shares += [_against_noise(calibrator, v, part.mount_T_cam, part.other_T_board) for v in good[fold::FOLDS]]
    shared = np.array(shares)
    return HeldOutErrors(
        mm=np.concatenate([e.mm for e in folds]),
        deg=np.concatenate([e.deg for e in folds]),
        px=np.concatenate([e.px for e in folds]),
        scale=shared[:, 0],
        expected=shared[:, 1:],
    )


def _against_noise(
    calibrator: Calibrator, view: View, mount_T_cam: np.ndarray, other_T_board: np.ndarray
) -> tuple[float, float, float]:
    """How far a view is off in units of the expected noise, and what that noise alone gives in mm and degrees."""
    predicted = calibrator.predicted(view, mount_T_cam, other_T_board)
    about = spatial.transform(None, calibrator.spec.centre)
    covariance = calibrator.location_covariance(view, mount_T_cam, other_T_board)
    off = spatial.inverse(predicted @ about) @ view.cam_T_board @ about
    error = np.concatenate([spatial.rotation_vector(off[:3, :3]), off[:3, 3]])
    scale = np.sqrt(error @ np.linalg.solve(covariance, error) / 6)
    variance = np.diag(covariance)
    return float(scale), 1000 * float(np.sqrt(variance[3:].sum())), float(np.degrees(np.sqrt(variance[:3].sum())))


def board_by(calibrator: Calibrator, views: Sequence[View], mount_T_cam: Float[np.ndarray, "4 4"]) -> np.ndarray:
    """(4, 4) other_T_board as a given calibration sees it in the middle of all views: what a check compares with."""
    placed = np.stack([spatial.inverse(v.mount_T_other) @ mount_T_cam @ v.cam_T_board for v in views])
    u, _, vt = np.linalg.svd(np.median(placed[:, :3, :3], axis=0))
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    centre = np.median(spatial.apply(placed, calibrator.spec.centre[None])[:, 0], axis=0)
    return spatial.transform(rotation, centre - rotation @ calibrator.spec.centre)


def rms(values: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
