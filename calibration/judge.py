"""How good a calibration is, by views that it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from calibration.detect import project
from calibration.hand_eye import Calibrator, HandEye, View
from resync_robot.core import spatial
from resync_robot.core.errors import CalibrationError

FOLDS = 5


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


def held_out(calibrator: Calibrator, views: Sequence[View], result: HandEye) -> Errors:
    """Errors on each kept view by a calibration from the other folds: an honest figure from the views at hand.

    Raises:
        CalibrationError: without a fold there are too few views, or too flat ones.
    """
    good = [v for v, k in zip(views, result.kept, strict=True) if k]
    folds: list[Errors] = []
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
    return Errors(*(np.concatenate([getattr(e, name) for e in folds]) for name in ("mm", "deg", "px")))


def board_by(calibrator: Calibrator, views: Sequence[View], mount_T_cam: Float[np.ndarray, "4 4"]) -> np.ndarray:
    """(4, 4) other_T_board as a given calibration sees it in the middle of all views: what a check compares with."""
    placed = np.stack([spatial.inverse(v.mount_T_other) @ mount_T_cam @ v.cam_T_board for v in views])
    u, _, vt = np.linalg.svd(np.median(placed[:, :3, :3], axis=0))
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    centre = np.median(spatial.apply(placed, calibrator.spec.centre[None])[:, 0], axis=0)
    return spatial.transform(rotation, centre - rotation @ calibrator.spec.centre)


def rms(values: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
