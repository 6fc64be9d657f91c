"""Where a camera sits in its mount, from views of one board under many poses of the arm.

Eye-in-hand and eye-to-base are one problem here: `cam_T_board = inverse(mount_T_cam) @ mount_T_other @ other_T_board`.
The wrist camera's mount is the flange and the board lies in the world; the front camera's mount is the world and the
board is held by the flange.

The way: the rotation by PARK and a linear position, over random handfuls of views, until most views agree (consensus);
PARK over those views, with SHAH as a cross-check; then all corners of all views at once, with the noise that the arm's
pose and the pixels really have: every view's corners are weighted by the covariance that both noises give them, so an
error of the arm, which moves all corners of a view together, is not taken for many small errors of pixels.

PARK: Park and Martin 1994. SHAH: Shah 2013. Both as in OpenCV 4.11.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares
from scipy.stats import chi2

from resync_robot.calibration.board import BoardSpec
from resync_robot.calibration.consensus import View, consensus, difference, park, second_tilt_deg
from resync_robot.calibration.detect import Corners, locate, project
from resync_robot.core import spatial
from resync_robot.core.errors import CalibrationError


@dataclass(frozen=True, kw_only=True)
class Noise:
    """What is expected of pixels and arm, one standard deviation per axis; decides what counts as an outlier."""

    pixel_px: float = 0.25
    arm_position: float = 0.3e-3
    """m, of the flange."""
    arm_rotation: float = 0.35e-3
    """rad, of the flange: 0.02 degrees."""


@dataclass(frozen=True, kw_only=True)
class Demands:
    """What a set of views must be like."""

    least_views: int = 8
    least_tilt_deg: float = 8.0
    """Root mean square turn of the camera against the board about the second of its axes: with less, the position is
    badly determined (1.4 mm instead of 0.4 at tilts below 10 degrees)."""
    most_left_out: float = 0.34
    """Share of views that may disagree before none can be believed."""
    most_scale_error: float = 0.01
    """Of the board's squares against the arm's metres."""
    most_disagreement_mm: float = 10.0
    """Between PARK and SHAH: more, and the views do not determine the pose."""
    outlier_p: float = 1e-5
    """Chance at which a good view may look so bad."""


@dataclass(frozen=True)
class HandEye:
    """A calibration.

    Attributes:
        mount_T_cam, other_T_board: (4, 4).
        kept: (n,) which views were used.
        distances: (n,) by how much each view disagrees, 1 being the most that a good view does.
        covariance: (6, 6) of mount_T_cam: rotation vector (rad), then position (m), in the camera's axes.
        noise_scale: factor by which the views scatter more than the expected noise explains.
        park_shah_mm, park_shah_deg: how far the two closed forms are apart.
        scale: board's squares as the arm measures them, over their nominal size.
    """

    mount_T_cam: Float[np.ndarray, "4 4"]
    other_T_board: Float[np.ndarray, "4 4"]
    kept: Bool[np.ndarray, " n"]
    distances: Float[np.ndarray, " n"]
    covariance: Float[np.ndarray, "6 6"]
    noise_scale: float
    park_shah_mm: float
    park_shah_deg: float
    scale: float

    @property
    def position_sigma(self) -> float:
        """m, root of the summed variances of the three axes."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))

    @property
    def rotation_sigma(self) -> float:
        """rad, likewise."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3])))


class Calibrator:
    """Solves for one camera.

    Args:
        spec: the board.
        intrinsics: (3, 3), px.
        arm_moves_board: the camera stands in the world and the flange holds the board; else the camera is on the
            flange. The arm's noise acts at the flange.
    """

    def __init__(
        self,
        spec: BoardSpec,
        intrinsics: Float[np.ndarray, "3 3"],
        arm_moves_board: bool,
        noise: Noise | None = None,
        demands: Demands | None = None,
    ) -> None:
        self.spec, self.intrinsics, self.arm_moves_board = spec, np.asarray(intrinsics, float), arm_moves_board
        self.noise, self.demands = noise or Noise(), demands or Demands()

    def view(self, name: str, world_T_flange: Float[np.ndarray, "4 4"], corners: Corners) -> View:
        """A view from what the arm and the picture said. Raises CalibrationError where the corners give no pose."""
        pose, _ = locate(self.spec, corners, self.intrinsics)
        if pose is None:
            raise CalibrationError(f"{name}: the corners lie on one line, so they have no pose", "leave this view out")
        arm = world_T_flange if self.arm_moves_board else spatial.inverse(world_T_flange)
        return View(name, arm, corners, pose)

    def solve(self, views: Sequence[View], seed: int = 0) -> HandEye:
        """Calibrate from `views`, leaving out those that disagree.

        Args:
            seed: of the random handfuls; another one gives the same result but for freak cases.

        Raises:
            CalibrationError: too few views, too little tilt, no majority that agrees, or a board of another size.
        """
        self._check_views(views)
        kept = consensus(self.spec, views, np.random.default_rng(seed))
        self._check_majority(kept, views)
        scale = self._check_scale([v for v, k in zip(views, kept, strict=True) if k])
        for _ in range(5):
            good = [v for v, k in zip(views, kept, strict=True) if k]
            self._check_tilt(good)
            closed, other, disagreement = self._closed_form(good)
            mount_T_cam, other_T_board, covariance, noise_scale, _ = self._refine(good, closed, other)
            # The scatter of the good views themselves says what is normal, but never less than expected.
            distances = self._distances(views, mount_T_cam, other_T_board) / max(1.0, noise_scale)
            now = distances <= 1.0
            if np.array_equal(now, kept):
                break
            self._check_majority(now, views)
            kept = now
        return HandEye(mount_T_cam, other_T_board, kept, distances, covariance, noise_scale, *disagreement, scale)

    def predicted(self, view: View, mount_T_cam: np.ndarray, other_T_board: np.ndarray) -> np.ndarray:
        """(4, 4) cam_T_board by the arm."""
        return spatial.inverse(mount_T_cam) @ view.mount_T_other @ other_T_board

    def location_covariance(self, view: View, mount_T_cam: np.ndarray, other_T_board: np.ndarray) -> np.ndarray:
        """(6, 6) of where a single view puts the board's centre, against where it is: rotation vector (rad), then
        position (m), in the board's axes. What the expected noise of pixels and arm gives."""
        about = spatial.transform(None, self.spec.centre)
        back, step = spatial.inverse(about), 1e-5
        base = self._misses(view, mount_T_cam, other_T_board)
        jacobian = np.stack(
            [
                (self._misses(view, mount_T_cam, other_T_board @ about @ _small(step * unit) @ back) - base) / step
                for unit in np.eye(6)
            ],
            -1,
        )
        solve = np.linalg.pinv(jacobian)
        arm = solve @ self._sensitivity(view, mount_T_cam, other_T_board)
        arm_variance = np.repeat([self.noise.arm_rotation**2, self.noise.arm_position**2], 3)
        return self.noise.pixel_px**2 * solve @ solve.T + arm * arm_variance @ arm.T

    # -- what a set of views must be like

    def _check_views(self, views: Sequence[View]) -> None:
        if len(views) < self.demands.least_views:
            raise CalibrationError(
                f"{len(views)} usable views of the board; at least {self.demands.least_views} are needed, 20 are good",
                "take more: resync-robot calibrate hand-eye --poses 20",
            )

    def _check_tilt(self, views: Sequence[View]) -> None:
        self._check_views(views)
        tilt = second_tilt_deg(views)
        if tilt < self.demands.least_tilt_deg:
            raise CalibrationError(
                f"the views are too flat: about its second axis the camera turns by {tilt:.1f} degrees (rms) against "
                f"the board, at least {self.demands.least_tilt_deg:g} are needed",
                "add views tilted by 20 to 40 degrees to both sides: resync-robot calibrate hand-eye --most-tilt 40",
            )

    def _check_majority(self, kept: np.ndarray, views: Sequence[View]) -> None:
        if np.mean(~kept) > self.demands.most_left_out:
            names = ", ".join(v.name for v, k in zip(views, kept, strict=True) if not k)
            raise CalibrationError(
                f"{np.sum(~kept)} of {len(views)} views do not fit one camera and one board ({names}): the board "
                "moved or slipped, the camera was touched, or the arm's poses are not those of the pictures",
                "fix the board, leave it and the camera untouched, and take all views anew",
            )

    def _check_scale(self, views: Sequence[View]) -> float:
        """The size of the board's squares by the arm's metres, over what it is said to be."""
        self._check_tilt(views)
        *_, scale = self._refine(views, *self._closed_form(views)[:2], free_scale=True)
        square = 1000 * self.spec.square
        if abs(scale - 1.0) > self.demands.most_scale_error:
            raise CalibrationError(
                f"the arm measures squares of {scale * square:.2f} mm, the board is said to have {square:.2f} mm",
                f"measure the print; then give --board.square {scale * self.spec.square:.5f} and its --board.marker "
                "(or mend the focal length: resync-robot calibrate intrinsics)",
            )
        return scale

    def _closed_form(self, views: Sequence[View]) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
        """PARK's mount_T_cam and other_T_board, and how far SHAH's camera is from it, (mm, degrees)."""
        camera = park(views)
        rotation, position, turn, shift = cv2.calibrateRobotWorldHandEye(
            [v.cam_T_board[:3, :3] for v in views], [v.cam_T_board[:3, 3] for v in views],
            [v.mount_T_other[:3, :3] for v in views], [v.mount_T_other[:3, 3] for v in views],
            method=cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH,
        )  # fmt: skip
        shah = spatial.inverse(spatial.transform(np.asarray(turn), np.ravel(shift)))
        board = spatial.inverse(spatial.transform(np.asarray(rotation), np.ravel(position)))
        millimetres, degrees = difference(camera, shah)
        if not np.isfinite(millimetres) or millimetres > self.demands.most_disagreement_mm:
            raise CalibrationError(
                f"two methods (PARK, SHAH) disagree by {millimetres:.1f} mm and {degrees:.2f} degrees on where the "
                "camera is: these views do not determine it",
                "take more views with larger and more varied tilts",
            )
        return camera, board, (millimetres, degrees)

    # -- refinement over all corners

    def _refine(
        self, views: Sequence[View], camera: np.ndarray, board: np.ndarray, free_scale: bool = False
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, float]:
        """mount_T_cam, other_T_board, covariance of the camera, noise scale, scale of the board (1 unless free)."""
        scale, count = 1.0, 13 if free_scale else 12
        for _ in range(2):
            # The weights depend on the solution a little: once more with those of the better one.
            whiteners = [self._whitener(self._sensitivity(v, camera, board)) for v in views]
            begin = camera, board, scale

            def residuals(x: np.ndarray, begin: tuple = begin, whiteners: list[np.ndarray] = whiteners) -> np.ndarray:
                moved = begin[0] @ _small(x[:6]), begin[1] @ _small(x[6:12]), begin[2] + x[12:].sum()
                return np.concatenate([w @ self._misses(v, *moved) for v, w in zip(views, whiteners, strict=True)])

            fit = least_squares(residuals, np.zeros(count), method="lm", x_scale=np.full(count, 1e-3))
            camera, board = camera @ _small(fit.x[:6]), board @ _small(fit.x[6:12])
            scale += fit.x[12:].sum()
        freedom = max(1, len(fit.fun) - count)
        noise_scale = float(np.sqrt(2 * fit.cost / freedom))
        # Scatter below the expected noise may be luck; the covariance then keeps the expected one.
        covariance = np.linalg.pinv(fit.jac.T @ fit.jac)[:6, :6] * max(1.0, noise_scale) ** 2
        return camera, board, covariance, noise_scale, float(scale)

    def _misses(self, view: View, camera: np.ndarray, board: np.ndarray, scale: float = 1.0) -> np.ndarray:
        """(2 n,) px between where the corners should be and where they were seen."""
        points = scale * self.spec.corners[view.corners.ids]
        return (project(self.intrinsics, self.predicted(view, camera, board), points) - view.corners.px).ravel()

    def _sensitivity(self, view: View, camera: np.ndarray, board: np.ndarray) -> np.ndarray:
        """(2 n, 6) px that the corners move by per rad and m of error of the flange."""
        step, base = 1e-5, self._misses(view, camera, board)
        columns = []
        for i in range(6):
            wiggle = _small(step * np.eye(6)[i])
            arm = view.mount_T_other @ wiggle if self.arm_moves_board else wiggle @ view.mount_T_other
            columns.append((self._misses(replace(view, mount_T_other=arm), camera, board) - base) / step)
        return np.stack(columns, -1)

    def _whitener(self, sensitivity: np.ndarray) -> np.ndarray:
        """(2 n, 2 n) that gives a view's misses unit covariance."""
        arm_variance = np.repeat([self.noise.arm_rotation**2, self.noise.arm_position**2], 3)
        covariance = sensitivity * arm_variance @ sensitivity.T
        covariance[np.diag_indices_from(covariance)] += self.noise.pixel_px**2
        return np.linalg.inv(np.linalg.cholesky(covariance))

    def _distances(self, views: Sequence[View], camera: np.ndarray, board: np.ndarray) -> np.ndarray:
        """(n,) of each view, the worse of two: how far its board is from its place, and how badly its corners fit a
        board wherever it is. Told apart, for a moved board would drown in the noise of fifty pixels."""
        found = []
        for view in views:
            sensitivity = self._sensitivity(view, camera, board)
            whiten = self._whitener(sensitivity)
            misses = whiten @ self._misses(view, camera, board)
            place = np.linalg.qr(whiten @ sensitivity)[0].T @ misses
            parts = np.array([place @ place, max(0.0, misses @ misses - place @ place)])
            limits = chi2.isf(self.demands.outlier_p, [6, max(1, len(misses) - 6)])
            found.append(np.sqrt((parts / limits).max()))
        return np.array(found)


def _small(x: np.ndarray) -> np.ndarray:
    """(4, 4) from a rotation vector (rad) and a shift (m)."""
    return spatial.transform(spatial.rotation_from_vector(x[:3]), x[3:])
