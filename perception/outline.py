"""The outline of a horizontal face, by votes: every view says which cells of the face's plane it sees filled.

A colour edge is known to a pixel, a depth edge is not. So depth only gives the height of the plane and tells what
hides what; where the face ends is read from the labels, looked up at each cell's projection into each picture.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from resync_robot.core import spatial
from resync_robot.perception.views import BACKGROUND, View

OCCLUDER = 0.016
"""What is nearer than the plane by more than this hides it, m; a stud (12 mm) on the face does not."""
BELOW = 0.006
"""What lies deeper than this is not the face but its side or the ground, m."""
_BLUR = 0.003
"""An edge that seems to be moved by this much is trusted half as much, m."""
_SOFTNESS = 0.0015
"""Width of the edge of the fitted shape, m."""
SEEN = 0.05
"""Sum of the views' weights from which a cell counts as seen."""


@dataclass(frozen=True)
class Votes:
    """Attributes: `xy` (n, 2) cells; `filled`, `weight` (n,), mean vote in [0, 1] and sum of the views' weights;
    `views`: how many see the face."""

    xy: Float[np.ndarray, "n 2"]
    filled: Float[np.ndarray, "n"]
    weight: Float[np.ndarray, "n"]
    views: int


def grid(centre: Float[np.ndarray, "2"], half: float, step: float) -> Float[np.ndarray, "n 2"]:
    """Cells of a square around a point."""
    ticks = np.arange(-half, half + step / 2, step)
    x, y = np.meshgrid(ticks, ticks)
    return np.stack([x.ravel(), y.ravel()], -1) + centre


def vote(
    views: Sequence[View],
    cells: Float[np.ndarray, "n 2"],
    plane_z: float,
    of_face: Callable[[View], np.ndarray],
    outward: Float[np.ndarray, "n 2"],
    by_depth: bool = False,
) -> Votes:
    """What the views say about each cell of the plane at height `plane_z`.

    Args:
        of_face: (H, W) bool, the pixels that could be the face by their label.
        outward: unit vector from the face across its edge nearest to each cell. A view that looks at an edge from
            outside sees the wall below it too, and what of that lies within the tolerance of depth moves the edge
            outwards: the cell is looked up that much further out, and counts for less.
        by_depth: the label does not tell the face from what is around it, so pixels without depth say nothing, nor do
            those of a coloured thing on the face, however thin.
    """
    total, filled = np.zeros(len(cells)), np.zeros(len(cells))
    counted = 0
    square = (round(len(cells) ** 0.5), -1)
    for view in views:
        shift = _apparent_shift(cells, outward, view.world_T_cam[:3, 3], plane_z)
        places = cells + shift[:, None] * outward
        pixel, depth = view.project(np.column_stack([places, np.full(len(cells), plane_z)]))
        height, width = view.depth.shape
        u, v = pixel[:, 0].astype(np.float32), pixel[:, 1].astype(np.float32)
        inside = (depth > 0.05) & (u >= 1) & (u < width - 2) & (v >= 1) & (v < height - 2)
        if not inside.any():
            continue
        face = of_face(view) & ~(view.valid & (view.points[..., 2] < plane_z - BELOW))
        column, row = np.clip(np.rint(u), 0, width - 1).astype(int), np.clip(np.rint(v), 0, height - 1).astype(int)
        measured = view.depth[row, column]
        hidden = view.hidden[row, column] | ((measured > 0) & (measured < depth - OCCLUDER))
        if by_depth:
            on_top = (view.labels[row, column] != BACKGROUND) & (measured < depth - BELOW / 2)
            hidden |= (measured == 0) | on_top
        here = cv2.remap(face.astype(np.float32), u.reshape(square), v.reshape(square), cv2.INTER_LINEAR).ravel()
        weight = np.where(inside & ~hidden, 1.0 / (1.0 + (shift / _BLUR) ** 2), 0.0)
        total += weight
        filled += weight * here
        counted += bool((weight * here).sum() > 0.05 * len(cells) * weight.max(initial=0.0))
    return Votes(cells, filled / np.maximum(total, 1e-9), total, counted)


def _apparent_shift(cells: np.ndarray, outward: np.ndarray, camera: np.ndarray, plane_z: float) -> np.ndarray:
    """(n,) m by which an edge at each cell seems to lie further out: so far reaches, on the face's plane, what lies
    less than BELOW under it on a vertical wall that the camera sees."""
    slope = np.maximum(0.0, np.einsum("ij,ij->i", outward, camera[:2] - cells)) / max(camera[2] - plane_z, 0.05)
    return BELOW * slope


def outward_of_face(cells: Float[np.ndarray, "n 2"], centre: Float[np.ndarray, "2"]) -> Float[np.ndarray, "n 2"]:
    """Directions across the edge of a convex face."""
    away = cells - centre
    return away / (np.linalg.norm(away, axis=1, keepdims=True) + 1e-9)


def outward_of_ring(
    cells: Float[np.ndarray, "n 2"], centre: np.ndarray, yaw: float, inner: np.ndarray, thickness: float
) -> Float[np.ndarray, "n 2"]:
    """Directions across the nearer edge of a rectangular ring: to its inside, or to the outside."""
    away, beyond = _across(cells, centre, yaw, inner + thickness)
    return away * np.sign(beyond)[:, None]


def outward_of_rectangle(
    cells: Float[np.ndarray, "n 2"], centre: np.ndarray, yaw: float, extents: np.ndarray
) -> Float[np.ndarray, "n 2"]:
    """Directions across the nearer edge of a rectangle, which may be much longer than wide."""
    return _across(cells, centre, yaw, extents)[0]


def _across(
    cells: np.ndarray, centre: np.ndarray, yaw: float, extents: np.ndarray
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
    """Away from the centre along the axis whose edge of a rectangle is nearer, and how far beyond that edge, m."""
    c, s = np.cos(yaw), np.sin(yaw)
    axes = np.array([[c, s], [-s, c]])
    local = (cells - centre) @ axes.T
    beyond = np.abs(local) - extents / 2
    axis = np.argmax(beyond, axis=1)
    rows = np.arange(len(cells))
    return np.sign(local[rows, axis])[:, None] * axes[axis], beyond[rows, axis]


@dataclass(frozen=True)
class Rectangle:
    """Attributes: centre `x`, `y`, `yaw` in [-pi/4, pi/4), full extents `width` (along yaw), `length`; m, rad.

    `sigma` (4,): what the fit itself knows of x, y, yaw and the extents. `misfit`: root mean square of the votes
    that the shape does not explain.
    """

    x: float
    y: float
    yaw: float
    width: float
    length: float
    sigma: Float[np.ndarray, "4"]
    misfit: float


def rough_rectangle(points: Float[np.ndarray, "n 2"]) -> tuple[np.ndarray, float, np.ndarray]:
    """Centre (2,), yaw in [-pi/4, pi/4), extents (2,) of the least rectangle around points."""
    (x, y), (width, length), degrees = cv2.minAreaRect(points.astype(np.float32))
    yaw = np.radians(degrees)
    turns = int(np.round(yaw / (np.pi / 2)))
    extents = np.array([width, length] if turns % 2 == 0 else [length, width])
    return np.array([x, y]), float(spatial.wrap(yaw, np.pi / 2)), extents


def seen_edges(votes: Votes, rectangle: tuple[np.ndarray, float, np.ndarray], within: float) -> Float[np.ndarray, "4"]:
    """Of what lies up to `within` m outside each edge of a rectangle, the share in [0, 1] that some view sees: first of
    the edge ahead along its yaw, then of those a quarter turn further each. Where it is small, nothing says that the
    face ends there."""
    centre, yaw, extents = rectangle
    outward, beyond = _across(votes.xy, centre, yaw, extents)
    near = (beyond >= 0) & (beyond < within)
    shares = []
    for turn in np.arange(4) * np.pi / 2 + yaw:
        beside = near & (outward @ [np.cos(turn), np.sin(turn)] > 0.9)
        shares.append(float(np.mean(votes.weight[beside] > SEEN)) if beside.any() else 1.0)
    return np.array(shares)


def fit_rectangle(
    votes: Votes,
    start: tuple[np.ndarray, float, np.ndarray],
    square: bool = False,
    ring: float = 0.0,
) -> Rectangle:
    """The rectangle that explains the votes best, by least squares over cells that some view sees.

    Args:
        start: centre, yaw, extents.
        square: keep both extents equal.
        ring: > 0 for a frame of that thickness around the rectangle (a box's rim around its inside); 0 for the face.
    """
    seen = votes.weight > SEEN
    xy, filled = votes.xy[seen], votes.filled[seen]
    centre, yaw, extents = start

    def shape(p: np.ndarray) -> np.ndarray:
        return coverage(xy, p[:2], p[2], (p[3], p[-1]), ring)

    begin = np.array([*centre, yaw, *([extents.mean()] if square else extents)])
    scale = np.array([1.0, 1.0, 1.0 / max(extents.mean(), 0.02), *([1.0] * (len(begin) - 3))]) * 0.01
    fit = least_squares(lambda p: shape(p) - filled, begin, x_scale=scale, loss="soft_l1", f_scale=0.3, max_nfev=25)
    p = fit.x
    misfit = float(np.sqrt(np.mean((shape(p) - filled) ** 2)))
    information = fit.jac.T @ fit.jac + np.eye(len(p)) * 1e-3
    # Neighbouring cells see the same pixels, so a tenth of them is independent.
    sigma = np.sqrt(np.diag(np.linalg.inv(information)) * 10) * max(misfit, 0.05)
    quarter_turns = round(float(p[2] - spatial.wrap(p[2], np.pi / 2)) / (np.pi / 2))
    width, length = (p[3], p[-1]) if quarter_turns % 2 == 0 else (p[-1], p[3])
    return Rectangle(
        float(p[0]),
        float(p[1]),
        float(spatial.wrap(p[2], np.pi / 2)),
        float(width),
        float(length),
        np.array([*sigma[:3], sigma[3:].max()]),
        misfit,
    )


def coverage(
    xy: Float[np.ndarray, "n 2"], centre: np.ndarray, yaw: float, extents: tuple[float, float], ring: float = 0.0
) -> Float[np.ndarray, "n"]:
    """1 at points on a rectangle (or, for `ring` > 0, on the frame of that thickness around it), 0 off it, with soft
    edges so that it can be differentiated."""
    c, s = np.cos(yaw), np.sin(yaw)
    d = xy - centre
    u, v = np.abs(d[:, 0] * c + d[:, 1] * s), np.abs(d[:, 1] * c - d[:, 0] * s)
    half_u, half_v = extents[0] / 2, extents[1] / 2
    face = _edge(half_u - u) * _edge(half_v - v)
    return face if not ring else _edge(half_u + ring - u) * _edge(half_v + ring - v) - face


def _edge(inside: np.ndarray) -> np.ndarray:
    return 0.5 * (1.0 + np.tanh(inside / _SOFTNESS))
