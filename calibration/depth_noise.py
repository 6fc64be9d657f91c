"""How bad a depth camera is, from pictures of something flat that it stands still before.

The disparity of a plane is a linear function of the pixel, whatever way the plane stands: what is left of it after a
fit is the camera's own. What changes between pictures is noise; what does not, and repeats with every pixel of
disparity, is the matcher's ripple.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from resync_robot.core.errors import CalibrationError
from resync_robot.core.rig import CameraRig
from resync_robot.core.sensor_noise import SensorNoise
from resync_robot.core.world import CameraFrame

LEAST_FRAMES = 5
LEAST_FLAT = 0.2
"""Share of the picture that the plane must fill."""
LEAST_SPAN_PX = 2.0
"""Of disparity over the plane, or its ripple cannot be told from its place."""
FLAT_WITHIN_PX = 0.6
TILE = 16
"""px."""


@dataclass(frozen=True)
class NoiseFit:
    """Attributes: `noise`, with what pictures of a plane can tell and the rest as it was; `span_px` of disparity that
    they cover; `flat`, the share of the picture that the plane fills."""

    noise: SensorNoise
    span_px: float
    flat: float


def fit_noise(camera: CameraRig, stills: Sequence[Sequence[CameraFrame]]) -> NoiseFit:
    """Fit noise of disparity and colour, ripple, holes and exposure; what happens at edges stays as in the rig.

    Args:
        stills: for each place the pictures taken there, the camera and everything before it at rest.

    Raises:
        CalibrationError: too few pictures, some of another size than the camera's, nothing flat, or a plane seen too
            squarely.
    """
    fewest = min((len(s) for s in stills), default=0)
    if fewest < LEAST_FRAMES:
        raise CalibrationError(
            f"{fewest} pictures of one place; at least {LEAST_FRAMES} are needed", "give --frames 12"
        )
    size = camera.height, camera.width
    strange = {f.depth.shape for s in stills for f in s} - {size}
    if strange:
        height, width = strange.pop()
        raise CalibrationError(
            f"a picture of {width} x {height} px; the rig says that '{camera.name}' has {size[1]} x {size[0]}",
            "give the rig file of this camera with --rig",
        )
    given = camera.noise
    focal_baseline = given.focal_at_848_px * camera.width / 848 * given.baseline
    parts = [_one_place(focal_baseline, frames) for frames in stills]
    span = max(p.span_px for p in parts)
    if span < LEAST_SPAN_PX:
        raise CalibrationError(
            f"the flat surface spans {span:.1f} px of disparity, at least {LEAST_SPAN_PX:g} are needed",
            "look at the table from a slant, so that one side of the picture is nearer",
        )
    variance = float(np.mean([p.variance for p in parts])) - given.disparity_step_px**2 / 12
    telling = [p.ripple for p in parts if p.span_px >= LEAST_SPAN_PX]
    noise = replace(
        given,
        disparity_sigma_px=float(np.sqrt(max(variance, 0.0))),
        ripple_px=float(np.mean(telling)),
        hole_share=float(np.mean([p.holes for p in parts])),
        exposure_sigma=float(np.sqrt(np.mean([p.exposure for p in parts]))),
        white_balance_sigma=float(np.sqrt(np.mean([p.balance for p in parts]))),
        colour_sigma=float(np.sqrt(np.mean([p.colour for p in parts]))),
    )
    return NoiseFit(noise, span, float(np.mean([p.flat for p in parts])))


@dataclass(frozen=True)
class _Place:
    """What one place says; `variance`, `exposure`, `balance`, `colour` are variances."""

    variance: float
    ripple: float
    holes: float
    span_px: float
    flat: float
    exposure: float
    balance: float
    colour: float


def _one_place(focal_baseline: float, frames: Sequence[CameraFrame]) -> _Place:
    depth = np.stack([f.depth for f in frames]).astype(np.float64) * CameraFrame.DEPTH_UNIT_M
    seen = depth > 0
    disparity = focal_baseline / np.where(seen, depth, np.inf)
    count = seen.sum(axis=0)
    mean = disparity.sum(axis=0) / np.maximum(count, 1)
    rows, columns = np.nonzero(count >= LEAST_FRAMES)
    flat, ripple = _plane(rows, columns, mean[rows, columns], seen.shape[1:])
    rows, columns = rows[flat], columns[flat]
    on_plane = disparity[:, rows, columns]
    there = seen[:, rows, columns]
    away = np.where(there, on_plane - mean[rows, columns], 0.0)
    freedom = there.sum(axis=0) - 1
    # By the median: a few pixels at the rim of the plane see something else in some of the pictures.
    per_pixel = (away**2).sum(axis=0) / chi2.median(freedom)
    holes = _holes(seen, rows, columns)
    exposure, balance, colour = _colour(np.stack([f.colour for f in frames]))
    span = np.ptp(np.percentile(mean[rows, columns], [2, 98]))
    return _Place(
        float(np.median(per_pixel)),
        ripple,
        float(holes),
        float(span),
        len(rows) / seen[0].size,
        exposure,
        balance,
        colour,
    )


def _plane(
    rows: np.ndarray, columns: np.ndarray, disparity: np.ndarray, shape: tuple[int, ...]
) -> tuple[np.ndarray, float]:
    """Which pixels lie on the plane that most of them share, and the amplitude of the ripple on it, px."""
    keep = np.ones(len(rows), dtype=bool)
    linear = np.column_stack([np.ones(len(rows)), rows / shape[0], columns / shape[1]])
    # The median of a coarse grid of differences would do as a start; a trimmed fit gets there as well in some rounds.
    for limit in (8.0, 4.0, 2.0, 1.0, FLAT_WITHIN_PX, FLAT_WITHIN_PX):
        if keep.sum() < LEAST_FLAT * shape[0] * shape[1]:
            raise CalibrationError(
                f"{100 * keep.sum() / (shape[0] * shape[1]):.0f} % of the picture show one flat surface, at least "
                f"{100 * LEAST_FLAT:.0f} % are needed",
                "clear the table, or hold the camera before a wall",
            )
        place, *_ = np.linalg.lstsq(linear[keep], disparity[keep], rcond=None)
        keep = np.abs(disparity - linear @ place) < limit
    phase = 2 * np.pi * (linear @ place)
    design = np.column_stack([linear, np.sin(phase), np.cos(phase)])[keep]
    fit, *_ = np.linalg.lstsq(design, disparity[keep], rcond=None)
    return keep, float(np.hypot(*fit[3:]))


def _holes(seen: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> float:
    """Share of pixels without depth where there should be one. The median of tiles that lie on the plane: edges,
    shadows and the blind band lose pixels in ways of their own."""
    _, height, width = seen.shape
    mask = np.zeros((height, width))
    mask[rows, columns] = 1.0
    height, width = height // TILE * TILE, width // TILE * TILE

    def tiles(values: np.ndarray) -> np.ndarray:
        return values[:height, :width].reshape(height // TILE, TILE, width // TILE, TILE).mean(axis=(1, 3))

    on_plane = tiles(mask) > 0.98
    return float(np.median(1.0 - tiles(seen.mean(axis=0))[on_plane])) if on_plane.any() else 0.0


def _colour(pictures: Float[np.ndarray, "k h w 3"]) -> tuple[float, float, float]:
    """Variances of log exposure, of log white balance, and of a value (of 255)."""
    values = pictures.astype(np.float64)
    # A value at the end of the scale has lost its noise.
    inside = ((values > 15) & (values < 240)).all(axis=(0, 3))
    if inside.sum() < 1000:
        raise CalibrationError("the pictures are too dark or too bright to tell their noise", "mend light or exposure")
    picked = values[:, inside]
    gain = np.log(picked.mean(axis=1))
    exposure = gain.mean(axis=1)
    balance = gain - exposure[:, None]
    levelled = picked / np.exp(gain - gain.mean(axis=0))[:, None]
    # Rounding to whole values is a twelfth of its own.
    noise = max(float(levelled.var(axis=0, ddof=1).mean()) - 1 / 12, 0.0)
    # The mean of three channels carries a third of the white balance's variance, and hides as much of it.
    spread = float(balance.var(axis=0, ddof=1).mean()) * 1.5
    return max(float(exposure.var(ddof=1)) - spread / 3, 0.0), spread, noise
