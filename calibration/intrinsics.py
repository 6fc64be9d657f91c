"""Is the camera matrix of the rig file right? Zhang's method (2000) as in OpenCV, compared pixel by pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from resync_robot.calibration.board import BoardSpec
from resync_robot.calibration.detect import Corners, locate
from resync_robot.core.errors import CalibrationError
from resync_robot.core.rig import CameraRig

LEAST_VIEWS = 8
MOST_SIGMA = 0.02
"""Of the focal length, relative: beyond it an estimate tells nothing about a camera from the factory."""
LEAST_TILT_DEG = 10.0
"""Root mean square tilt of the board against the picture plane. Seen square on, a near board with a short focal length
looks like a far one with a long one, and the estimate's own sigma does not tell (it is linear)."""


@dataclass(frozen=True)
class Intrinsics:
    """What views of the board say about a camera.

    Attributes:
        matrix: (3, 3) px, a lens without distortion assumed, as the rig file does.
        sigma_px: (4,) one standard deviation of fx, fy, cx, cy.
        held_out_px: root mean square error of the corners in views that were not used, with `matrix`.
        rig_px: how far apart the rig file's camera and `matrix` see a point, at worst over the picture.
        distortion_px: what a lens with radial distortion would differ by, at worst over the picture.
        misfits_px: (n,) per view.
    """

    matrix: Float[np.ndarray, "3 3"]
    sigma_px: Float[np.ndarray, "4"]
    held_out_px: float
    rig_px: float
    distortion_px: float
    misfits_px: Float[np.ndarray, " n"]


def check_intrinsics(spec: BoardSpec, camera: CameraRig, views: Sequence[Corners]) -> Intrinsics:
    """Estimate the camera matrix from pictures of the board, and compare.

    Raises:
        CalibrationError: too few views, or views that do not determine it.
    """
    if len(views) < LEAST_VIEWS:
        raise CalibrationError(
            f"{len(views)} usable views of the board; at least {LEAST_VIEWS} are needed",
            "resync-robot calibrate intrinsics --poses 20",
        )
    tilt = np.degrees(np.sqrt(np.mean(np.square([_tilt(spec, camera, v) for v in views]))))
    if tilt < LEAST_TILT_DEG:
        raise CalibrationError(
            f"the views do not determine the focal length: the board is tilted by {tilt:.1f} degrees (rms), at least "
            f"{LEAST_TILT_DEG:g} are needed",
            "add views tilted by 20 to 40 degrees: resync-robot calibrate intrinsics --most-tilt 40",
        )
    pinhole = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1
    pinhole |= cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    matrix, _, sigma, misfits = _calibrate(spec, camera, views, pinhole)
    if not np.isfinite(matrix).all() or matrix[0, 0] <= 0 or sigma[0] > MOST_SIGMA * matrix[0, 0]:
        raise CalibrationError(
            f"the views do not determine the focal length ({matrix[0, 0]:.0f} +- {sigma[0]:.0f} px)",
            "add views tilted by 20 to 40 degrees: resync-robot calibrate intrinsics --most-tilt 40",
        )
    rest, held = [v for i, v in enumerate(views) if i % 5], views[::5]
    part, *_ = _calibrate(spec, camera, rest, pinhole)
    squares = []
    for corners in held:
        points = spec.corners[corners.ids]
        _, turn, shift = cv2.solvePnP(points, corners.px, part, None)
        px = cv2.projectPoints(points, turn, shift, part, None)[0][:, 0]
        squares.append(np.sum((px - corners.px) ** 2, -1))
    # One radial term: with more, the noise of the corners alone bends the picture's rim by a pixel.
    lens = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    full, distortion, _, _ = _calibrate(spec, camera, views, lens)
    grid = np.stack(np.meshgrid(np.linspace(0, camera.width - 1, 9), np.linspace(0, camera.height - 1, 7)), -1)
    grid = grid.reshape(-1, 2)
    bent = cv2.undistortPoints(grid[:, None], full, distortion, P=matrix)[:, 0]
    seen = cv2.undistortPoints(grid[:, None], matrix, None, P=camera.intrinsics)[:, 0]
    return Intrinsics(
        matrix,
        sigma,
        float(np.sqrt(np.mean(np.concatenate(squares)))),
        float(np.linalg.norm(seen - grid, axis=-1).max()),
        float(np.linalg.norm(bent - grid, axis=-1).max()),
        misfits,
    )


def _tilt(spec: BoardSpec, camera: CameraRig, corners: Corners) -> float:
    """Between the board's normal and the optical axis, rad, as the rig file's camera has it."""
    pose, _ = locate(spec, corners, camera.intrinsics)
    return 0.0 if pose is None else float(np.arccos(np.clip(pose[2, 2], -1, 1)))


def _calibrate(
    spec: BoardSpec, camera: CameraRig, views: Sequence[Corners], flags: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Camera matrix, distortion, sigmas of fx fy cx cy, misfit of each view."""
    try:
        _, matrix, distortion, _, _, sigma, _, misfits = cv2.calibrateCameraExtended(
            [spec.corners[v.ids].astype(np.float32) for v in views],
            [v.px.astype(np.float32) for v in views],
            (camera.width, camera.height), camera.intrinsics, np.zeros(5), flags=flags,
        )  # fmt: skip
    except cv2.error as error:
        raise CalibrationError(f"the views do not determine the camera matrix: {error.err}", "take others") from None
    return matrix, distortion, sigma.ravel()[:4], misfits.ravel()
