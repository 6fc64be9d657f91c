"""The points of one colour in space: which of them hang together, and whether they lie level."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float

from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.views import View, gather

LEAST_POINTS = 40
SHOWS = 400
"""Pixels of a mask, over all pictures, from which something is surely there."""
UPRIGHT_WITHIN = np.radians(8.0)
"""Tilt of a top face beyond which a thing does not stand upright; noise alone gives 2-3 degrees."""


def patches_of(views: Sequence[View], index: int, catalogue: Catalogue) -> tuple[list[Float[np.ndarray, "n 3"]], bool]:
    """The points of every connected patch of one label, the largest first.

    Args:
        index: into the catalogue's `look_alikes`.

    Returns:
        The patches, and whether the label shows in the pictures where these hold no depth at all.
    """
    points, _ = gather(views, [v.valid & (v.labels == index) & _on_the_table(v, catalogue) for v in views])
    shows = sum(int(((v.labels == index) & ~v.hidden).sum()) for v in views) >= SHOWS
    return connected(points), shows and not len(points)


def without_stragglers(xy: np.ndarray) -> np.ndarray:
    away = np.linalg.norm(xy - np.median(xy, axis=0), axis=1)
    return xy[away <= np.percentile(away, 97)]


def tilt_of(top: np.ndarray) -> float:
    """Angle of the plane through points against the horizontal, rad."""
    centred = top - top.mean(axis=0)
    a, b = np.linalg.lstsq(centred[:, :2], centred[:, 2], rcond=None)[0]
    return float(np.arctan(np.hypot(a, b)))


def _on_the_table(view: View, catalogue: Catalogue) -> np.ndarray:
    z = view.points[..., 2] - catalogue.table_z
    return (z > 0.008) & (z < 0.26)


def connected(points: Float[np.ndarray, "n k"], step: float = 0.006) -> list[Float[np.ndarray, "m k"]]:
    """The rows of every connected patch seen from above, the largest first, without stray ones.

    Args:
        points: x, y, and whatever else.
        step: m that may be between two points of a patch.
    """
    if len(points) < LEAST_POINTS:
        return []
    origin = points[:, :2].min(axis=0) - step
    cell = ((points[:, :2] - origin) / step).astype(int)
    shape = cell.max(axis=0) + 2
    count = np.zeros(shape, dtype=np.int32)
    np.add.at(count, (cell[:, 0], cell[:, 1]), 1)
    _, labels = cv2.connectedComponents((count >= 2).astype(np.uint8), connectivity=8)
    of_point = labels[cell[:, 0], cell[:, 1]]
    sizes = np.bincount(of_point)
    sizes[0] = 0
    order = [int(i) for i in np.argsort(-sizes) if sizes[i] >= LEAST_POINTS]
    return [points[of_point == i] for i in order]
