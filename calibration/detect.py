"""A board in a picture: its corners to a fraction of a pixel, or the reason why this picture is of no use."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from resync_robot.calibration.board import BoardSpec
from resync_robot.core import spatial

MAGNIFICATION = 3
"""Before the search for markers: a cell of two pixels is too little for the decoder, of six it is enough."""


@dataclass(frozen=True, kw_only=True)
class Gate:
    """What a picture must be like to be used."""

    least_corners: int = 12
    """Corners of the board found in it."""
    least_square_px: float = 12.0
    """Mean side of a square; a board that is farther away locates badly."""
    most_blur_px: float = 2.2
    """Width of the step from black to white; a sharp picture has 1 to 1.7. Blur means motion, and then the arm's pose
    belongs to another moment."""
    most_misfit_px: float = 1.0
    """Root mean square distance of the corners from any flat board of that size: misread markers, a bent board."""


@dataclass(frozen=True)
class Corners:
    """Corners of the board seen in one picture.

    Attributes:
        ids: (n,) their numbers on the board, ascending.
        px: (n, 2) where they are, pixels, the centre of the first pixel being (0, 0).
    """

    ids: Int[np.ndarray, " n"]
    px: Float[np.ndarray, "n 2"]


@dataclass(frozen=True)
class Rejected:
    """Attributes: `reason` says what is wrong with the picture and what would mend it."""

    reason: str


@dataclass(frozen=True)
class Sighting:
    """A picture that passed the gate.

    Attributes:
        cam_T_board: (4, 4) from this picture alone.
        depth: of the board's centre, m.
        blur_px, square_px, misfit_px: see `Gate`.
    """

    corners: Corners
    cam_T_board: Float[np.ndarray, "4 4"]
    depth: float
    blur_px: float
    square_px: float
    misfit_px: float


class BoardDetector:
    """Finds one board in pictures of one camera.

    Args:
        spec: the board.
        intrinsics: (3, 3) camera matrix, px.
        gate: what a picture must be like.
    """

    def __init__(self, spec: BoardSpec, intrinsics: Float[np.ndarray, "3 3"], gate: Gate | None = None) -> None:
        self._spec, self._intrinsics, self._gate = spec, np.asarray(intrinsics, dtype=np.float64), gate or Gate()
        charuco = cv2.aruco.CharucoParameters()
        charuco.tryRefineMarkers = True
        self._detector = cv2.aruco.CharucoDetector(spec.opencv, charuco)

    def __call__(self, colour: UInt8[np.ndarray, "h w 3"]) -> Sighting | Rejected:
        """Look for the board in an RGB picture."""
        grey = cv2.cvtColor(np.ascontiguousarray(colour), cv2.COLOR_RGB2GRAY)
        corners, markers = self.find(grey)
        if corners is None:
            return Rejected((markers and self._other_layout(grey)) or self._why_no_board(grey, markers))
        gate = self._gate
        if len(corners.ids) < gate.least_corners:
            return Rejected(
                f"only {len(corners.ids)} corners of the board are in sight, {gate.least_corners} are needed: "
                "show more of it, free of glare"
            )
        pose, misfit = locate(self._spec, corners, self._intrinsics)
        if pose is None or misfit > gate.most_misfit_px:
            return Rejected(
                self._other_layout(grey)
                or f"the corners lie {misfit:.1f} px from those of any flat board, {gate.most_misfit_px} is allowed: "
                "wrong marker numbers, a bent board, or one of another layout"
            )
        side, depth = self._square_px(pose), float(spatial.apply(pose, self._spec.centre[None])[0, 2])
        if side < gate.least_square_px:
            return Rejected(
                f"too far away ({depth:.2f} m): a square spans {side:.1f} px, {gate.least_square_px:g} are needed"
            )
        blur = self._blur(grey, pose)
        if blur > gate.most_blur_px:
            return Rejected(
                f"blurred: the step from black to white takes {blur:.1f} px, {gate.most_blur_px:g} are allowed: "
                "let the arm stand still, focus, give more light"
            )
        return Sighting(corners, pose, depth, blur, side, misfit)

    def find(self, grey: UInt8[np.ndarray, "h w"]) -> tuple[Corners | None, int]:
        """The corners, None where there are fewer than four; and how many markers of the dictionary were seen."""
        large = cv2.resize(grey, None, fx=MAGNIFICATION, fy=MAGNIFICATION, interpolation=cv2.INTER_CUBIC)
        px, ids, _, markers = self._detector.detectBoard(large)
        if ids is None or len(ids) < 4:
            return None, 0 if markers is None else len(markers)
        order = np.argsort(ids.ravel())
        # OpenCV 4.11 counts these from the edge of the first pixel, half a pixel more than everywhere else (a drawn
        # board comes out 0.5 px to the lower right at any magnification); uncorrected that is 0.8 mm at half a metre.
        px = px.reshape(-1, 2)[order].astype(np.float64) / MAGNIFICATION - 0.5
        return Corners(ids.ravel()[order].astype(int), px), len(markers)

    def _other_layout(self, grey: np.ndarray) -> str | None:
        """What to say where a board of the other layout is seen, which the same numbers of squares and markers have."""
        if self._spec.rows % 2:
            return None
        other = replace(self._spec, legacy=not self._spec.legacy)
        corners, _ = BoardDetector(other, self._intrinsics, self._gate).find(grey)
        if corners is None or len(corners.ids) < self._gate.least_corners:
            return None
        if locate(other, corners, self._intrinsics)[1] > self._gate.most_misfit_px:
            return None
        if other.legacy:
            return "the board has the layout that OpenCV drew before version 4.6: give --board.legacy"
        return "the board has the layout that OpenCV draws since version 4.6: leave out --board.legacy"

    def _why_no_board(self, grey: np.ndarray, markers: int) -> str:
        if markers:
            return (
                f"{markers} markers of {self._spec.dictionary} are in sight but too few corners between them: "
                "show more of the board, move nearer, or give the printed board's --board.columns and --board.rows"
            )
        return (
            f"no board of {self._spec.dictionary} in the picture (mean brightness {grey.mean():.0f} of 255): "
            "is it in sight, lit, and printed with this dictionary?"
        )

    def _square_px(self, pose: np.ndarray) -> float:
        """Square root of the mean area that a square covers in the picture."""
        width, height = self._spec.size
        outline = np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]])
        area = cv2.contourArea(project(self._intrinsics, pose, outline).astype(np.float32))
        return float(np.sqrt(area / (self._spec.columns * self._spec.rows)))

    def _blur(self, grey: np.ndarray, pose: np.ndarray) -> float:
        """Contrast over steepest slope across the squares' sides, px; the worse of the two directions of sides.

        Each side is crossed in its middle, over the white rim that the marker leaves.
        """
        spec, half = self._spec, 0.35 * self._spec.square
        picture = grey.astype(np.float32)

        def values(points: np.ndarray) -> np.ndarray:
            px = project(self._intrinsics, pose, points).astype(np.float32)
            return cv2.remap(
                picture, px[None, :, 0], px[None, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )[0]

        columns, rows = np.meshgrid(np.arange(spec.columns), np.arange(spec.rows))
        dark = ((columns + rows) % 2 == spec.first_black).ravel()
        centres = (np.stack([columns.ravel(), rows.ravel()], -1) + 0.5) * spec.square
        black = np.median(values(_flat(centres[dark])))
        worst = 0.0
        for axis in (0, 1):
            step = np.zeros(2)
            step[axis] = 1.0
            inner = (columns if axis == 0 else rows).ravel() > 0
            sides = (centres - 0.5 * spec.square * step)[inner]
            along = np.linspace(-half, half, 41)
            lines = sides[:, None] + along[None, :, None] * step
            ends = project(self._intrinsics, pose, _flat(lines[:, [0, -1]].reshape(-1, 2))).reshape(-1, 2, 2)
            length_px = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)
            seen = values(_flat(lines.reshape(-1, 2))).reshape(len(sides), -1)
            middle = slice(10, 31)
            slope = np.abs(np.diff(seen[:, middle], axis=1)).max(axis=1) / (length_px / 40)
            contrast = np.percentile(seen[:, middle], 95) - black
            widths = contrast / np.maximum(slope, 1e-3)
            worst = max(worst, float(np.median(widths)))
        return worst


def project(
    intrinsics: Float[np.ndarray, "3 3"], cam_T_frame: Float[np.ndarray, "*b 4 4"], points: Float[np.ndarray, "*b n 3"]
) -> Float[np.ndarray, "*b n 2"]:
    """Pixels of points given in a frame; a point behind the camera is taken as 1 mm before it."""
    seen = spatial.apply(cam_T_frame, points)
    scaled = seen[..., :2] / np.maximum(seen[..., 2:], 1e-3)
    return scaled * intrinsics[[0, 1], [0, 1]] + intrinsics[:2, 2]


def locate(
    spec: BoardSpec, corners: Corners, intrinsics: Float[np.ndarray, "3 3"]
) -> tuple[Float[np.ndarray, "4 4"] | None, float]:
    """cam_T_board from one picture and the root mean square distance of its corners, px; None where there is none.

    A flat board seen from afar looks nearly the same tilted either way; both solutions are refined and compared.
    """
    points, px = spec.corners[corners.ids], np.ascontiguousarray(corners.px)
    best: tuple[Any, float] = (None, np.inf)
    try:
        count, turns, shifts, _ = cv2.solvePnPGeneric(points, px, intrinsics, None, flags=cv2.SOLVEPNP_IPPE)
        for turn, shift in zip(turns[:count], shifts[:count], strict=True):
            turn, shift = cv2.solvePnPRefineLM(points, px, intrinsics, None, turn, shift)
            pose = spatial.transform(cv2.Rodrigues(turn)[0], shift.ravel())
            misfit = float(np.sqrt(np.mean(np.sum((project(intrinsics, pose, points) - px) ** 2, -1))))
            if misfit < best[1] and np.isfinite(pose).all() and pose[2, 3] > 0:
                best = pose, misfit
    except cv2.error:
        # Corners on one line have no pose; OpenCV says so with an error of its own.
        return None, np.inf
    return best


def _flat(xy: np.ndarray) -> np.ndarray:
    return np.concatenate([xy, np.zeros((len(xy), 1))], -1)
