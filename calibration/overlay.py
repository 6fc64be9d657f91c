"""Pictures and figures that show at a glance what a number hides: the board's corners, and the simulated scene, drawn
over what the camera saw."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from resync_robot.calibration.board import BoardSpec
from resync_robot.calibration.detect import Corners, project
from resync_robot.core.errors import CalibrationError
from resync_robot.core.files import PNG, check_output, unwritable, write_bytes

ZOOM = 3
SEEN, PREDICTED, SIMULATED = (40, 200, 60), (230, 40, 160), (0, 190, 255)
SEARCH_PX = 12
"""How far off the robot's outline is looked for."""
LEAST_OUTLINE_PX = 60
"""Pixels of outline below which the robot is not in the picture."""


def draw_corners(
    colour: UInt8[np.ndarray, "h w 3"],
    spec: BoardSpec,
    intrinsics: Float[np.ndarray, "3 3"],
    corners: Corners,
    cam_T_board: Float[np.ndarray, "4 4"],
    title: str,
) -> UInt8[np.ndarray, "H W 3"]:
    """The picture enlarged, with corners seen (green circles), corners and outline where arm and calibration put them
    (magenta), and ten times the difference as a line."""
    picture = cv2.resize(colour, None, fx=ZOOM, fy=ZOOM, interpolation=cv2.INTER_CUBIC)
    predicted = project(intrinsics, cam_T_board, spec.corners[corners.ids])
    width, height = spec.size
    outline = project(intrinsics, cam_T_board, np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]]))
    cv2.polylines(picture, [_fixed(outline)], True, PREDICTED, 1, cv2.LINE_AA, shift=4)
    for seen, there in zip(corners.px, predicted, strict=True):
        begin, end, far = _fixed(np.stack([seen, there, seen + 10 * (there - seen)]))
        cv2.circle(picture, _point(begin), 5 * 16, SEEN, 1, cv2.LINE_AA, shift=4)
        cv2.drawMarker(picture, _point(end // 16), PREDICTED, cv2.MARKER_CROSS, 7, 1)
        cv2.line(picture, _point(begin), _point(far), PREDICTED, 1, cv2.LINE_AA, shift=4)
    return _titled(picture, title)


def draw_scene(
    colour: UInt8[np.ndarray, "h w 3"],
    simulated: UInt8[np.ndarray, "h w 3"],
    robot: Bool[np.ndarray, "h w"],
    title: str,
) -> UInt8[np.ndarray, "H W 3"]:
    """Left the picture; right the simulation half transparent over it, its edges and the robot's outline drawn."""
    left, over = (cv2.resize(p, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC) for p in (colour, simulated))
    right = cv2.addWeighted(left, 0.6, over, 0.4, 0.0)
    edges = cv2.Canny(cv2.cvtColor(over, cv2.COLOR_RGB2GRAY), 60, 150) > 0
    right[edges] = SIMULATED
    mask = cv2.resize(robot.astype(np.uint8), (left.shape[1], left.shape[0]), interpolation=cv2.INTER_NEAREST)
    outlines, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(right, outlines, -1, PREDICTED, 1)
    return _titled(np.hstack([left, right]), title)


@dataclass(frozen=True)
class Outline:
    """How the robot's outline, as the simulation expects it, lies on the picture.

    Attributes:
        shift_px: (2,) right and down, that would bring it onto the edges of the picture.
        misfit_px: median distance of the outline from an edge, after that shift.
    """

    shift_px: Float[np.ndarray, "2"]
    misfit_px: float

    @property
    def error_px(self) -> float:
        return float(np.linalg.norm(self.shift_px))

    @property
    def at_the_limit(self) -> bool:
        """Does the best shift lie on the border of the search, so that the true one may be larger?"""
        return bool(np.abs(self.shift_px).max() >= SEARCH_PX)


def compare_outline(colour: UInt8[np.ndarray, "h w 3"], robot: Bool[np.ndarray, "h w"]) -> Outline | None:
    """Find the robot's outline among the edges of a picture; None where too little of the robot is in sight.

    Chamfer matching (Barrow 1977): the shift at which the outline lies nearest to edges, by truncated distance.
    """
    mask = robot.astype(np.uint8)
    # Both sides of the outline: the edge in the picture lies between them.
    cross = np.ones((3, 3), np.uint8)
    border = (cv2.dilate(mask, cross) - cv2.erode(mask, cross)).astype(bool)
    # Where the picture ends the robot's mask does too, and no edge of the scene is there.
    border[:2], border[-2:], border[:, :2], border[:, -2:] = False, False, False, False
    rows, columns = np.nonzero(border)
    if len(rows) < LEAST_OUTLINE_PX:
        return None
    smooth = cv2.GaussianBlur(cv2.cvtColor(np.ascontiguousarray(colour), cv2.COLOR_RGB2GRAY), (3, 3), 0)
    edges = cv2.Canny(smooth, 20, 60)
    distance = cv2.distanceTransform((edges == 0).astype(np.uint8), cv2.DIST_L2, 5)
    far = float(SEARCH_PX)
    padded = cv2.copyMakeBorder(distance, SEARCH_PX, SEARCH_PX, SEARCH_PX, SEARCH_PX, cv2.BORDER_CONSTANT, value=far)
    steps = range(-SEARCH_PX, SEARCH_PX + 1)
    costs = np.array(
        [
            [np.minimum(padded[rows + SEARCH_PX + dy, columns + SEARCH_PX + dx], 4.0).mean() for dx in steps]
            for dy in steps
        ]
    )
    y, x = np.unravel_index(costs.argmin(), costs.shape)
    dy, dx = int(y) - SEARCH_PX, int(x) - SEARCH_PX
    left = padded[rows + SEARCH_PX + dy, columns + SEARCH_PX + dx]
    return Outline(np.array([dx, dy], dtype=float), float(np.median(left)))


def save_picture(path: Path, picture: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write a PNG, whole or not at all. Raises ConfigError or DiskError."""
    ok, data = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    if not ok:
        raise CalibrationError(f"a picture of shape {picture.shape} cannot be written as PNG")
    check_output(path, PNG)
    try:
        write_bytes(path, data.tobytes())
    except OSError as error:
        raise unwritable(path, error, "give another folder with --out") from None


def _fixed(px: np.ndarray) -> np.ndarray:
    """Enlarged pixel coordinates with four binary places, as OpenCV draws them."""
    return np.round(((px + 0.5) * ZOOM - 0.5) * 16).clip(-(2**20), 2**20).astype(np.int32)


def _point(values: np.ndarray) -> tuple[int, int]:
    return int(values[0]), int(values[1])


def _titled(picture: np.ndarray, title: str) -> np.ndarray:
    bar = np.full((26, picture.shape[1], 3), 30, np.uint8)
    cv2.putText(bar, title, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (235, 235, 235), 1, cv2.LINE_AA)
    return np.vstack([bar, picture])
