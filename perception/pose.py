"""From labelled views to the poses and sizes of the box and the blocks, each with a covariance.

The features are those of `core.vocabulary`: a block by the centre of its body, the box by the middle of its floor.
A square block looks the same after a quarter turn: its yaw is in [-pi/4, pi/4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from perception.catalogue import Catalogue
from perception.outline import (
    Rectangle,
    fit_rectangle,
    grid,
    outward_of_face,
    outward_of_ring,
    rough_rectangle,
    vote,
)
from perception.views import BACKGROUND, View, gather
from resync_robot.core import spatial
from resync_robot.core.errors import PerceptionError

VIEW_SIGMA = 0.0014
"""What a view's own pose error leaves in x and y after the table has corrected its tilt and height, m."""
VIEW_YAW_SIGMA = 0.007
"""The same for the yaw of a block or the box, rad."""
HEIGHT_SIGMA = 0.0005
SIZE_SIGMA = 0.0006
TYPICAL_HEIGHT = 0.045
COVERED_WITHIN = 0.040
UPRIGHT_WITHIN = np.radians(8.0)
"""Tilt of the top face beyond which a block does not stand upright; noise alone gives 2-3 degrees."""


@dataclass(frozen=True)
class BlockEstimate:
    """One block whose top face was seen.

    Attributes:
        features, covariance: of core.vocabulary.BLOCK.
        top_z: height of the body's top face in the world, m.
        upright: its top face is level, high enough, and bears the stud.
        stacked: it stands on another one, so that its own height is a guess.
        views: how many saw the top face.
    """

    name: str
    features: Float[np.ndarray, "10"]
    covariance: Float[np.ndarray, "10 10"]
    top_z: float
    upright: bool
    stacked: bool
    views: int


@dataclass(frozen=True)
class BoxEstimate:
    """Attributes: `features` (11,) of core.vocabulary.BOX, `covariance` (11, 11)."""

    features: Float[np.ndarray, "11"]
    covariance: Float[np.ndarray, "11 11"]


@dataclass(frozen=True)
class Glimpse:
    """A block of which something is seen around `centre` (2,), but no top face that could be measured."""

    name: str
    centre: Float[np.ndarray, "2"]


def box_outline(views: Sequence[View], catalogue: Catalogue) -> np.ndarray | None:
    """(4, 2) rough corners of the box's outer edge in the world, from points at the height of its rim; or None."""
    low, high = catalogue.rim_height
    masks = [_rim_mask(v, catalogue.table_z + low, catalogue.table_z + high) for v in views]
    points, _ = gather(views, masks)
    if len(points) < 300:
        return None
    step = 0.004
    origin = points[:, :2].min(axis=0) - step
    cell = ((points[:, :2] - origin) / step).astype(int)
    shape = cell.max(axis=0) + 2
    if shape.max() > 1000:
        return None
    count = np.zeros(shape, dtype=np.float32)
    np.add.at(count, (cell[:, 0], cell[:, 1]), 1.0)
    filled = (cv2.blur(count, (3, 3)) > 0.35).astype(np.uint8)
    number, labels, stats, _ = cv2.connectedComponentsWithStats(filled, connectivity=8)
    if number < 2:
        return None
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    place = np.argwhere(labels == largest) * step + origin + step / 2
    (x, y), extents, degrees = cv2.minAreaRect(place.astype(np.float32))
    inner = np.array(extents) - 2 * catalogue.wall_thickness
    least, most = catalogue.box_inner
    if inner.min() < least - 0.03 or inner.max() > most + 0.03:
        return None
    return cv2.boxPoints(((x, y), extents, degrees)).astype(np.float64)


def estimate_box(views: Sequence[View], catalogue: Catalogue) -> BoxEstimate:
    """Pose and inner size of the box from its rim.

    Raises:
        PerceptionError: no rim of a fitting size is seen.
    """
    outline = box_outline(views, catalogue)
    nothing = "stand the box in front of the robot, inside the scan's views (x 0.42-0.54 m, y within 0.04 m)"
    if outline is None:
        raise PerceptionError(
            f"no box is seen: nothing with a rim {catalogue.rim_height[0]}-{catalogue.rim_height[1]} m above the table "
            f"and {catalogue.box_inner[0]}-{catalogue.box_inner[1]} m inside",
            nothing,
        )
    low, high = catalogue.rim_height
    points, _ = gather(views, [_rim_mask(v, catalogue.table_z + low, catalogue.table_z + high) for v in views])
    rim_z = _peak_height(points[:, 2])
    centre, yaw, extents = rough_rectangle(outline)
    cells = grid(centre, 0.29, 0.003)

    def of_rim(view: View) -> np.ndarray:
        return view.valid & (view.labels == BACKGROUND)

    thickness = catalogue.wall_thickness
    inner = extents - 2 * thickness
    votes = vote(views, cells, rim_z, of_rim, outward_of_ring(cells, centre, yaw, inner, thickness), by_depth=True)
    r = fit_rectangle(votes, (centre, yaw, inner), ring=thickness)
    least, most = catalogue.box_inner
    if not (least <= min(r.width, r.length) and max(r.width, r.length) <= most and r.misfit < 0.35):
        raise PerceptionError(
            f"what looks like the box measures {r.width:.3f} x {r.length:.3f} m inside; {least}-{most} m is allowed",
            nothing,
        )
    floor_z = catalogue.table_z + catalogue.floor_thickness
    features = np.array(
        [r.x, r.y, floor_z, *spatial.quat_from_yaw(r.yaw), r.width, r.length, rim_z - floor_z, catalogue.wall_thickness]
    )
    covariance = np.zeros((11, 11))
    n = max(votes.views, 1)
    covariance[:7, :7] = _fitted_covariance(r, VIEW_SIGMA**2 / n, HEIGHT_SIGMA**2, VIEW_YAW_SIGMA**2 / n)
    covariance[7, 7] = covariance[8, 8] = r.sigma[3] ** 2 + 0.0012**2
    covariance[9, 9] = HEIGHT_SIGMA**2
    return BoxEstimate(features, covariance)


def estimate_blocks(
    views: Sequence[View], catalogue: Catalogue, box: BoxEstimate | None
) -> tuple[dict[str, BlockEstimate], dict[str, Glimpse]]:
    """Every block whose top face is seen, and glimpses of those of which only sides are."""
    found: dict[str, BlockEstimate] = {}
    glimpses: dict[str, Glimpse] = {}
    for index, name in enumerate(catalogue.hues):
        masks = [v.valid & (v.labels == index) & _on_the_table(v, catalogue) for v in views]
        points, _ = gather(views, masks)
        cluster = _largest_cluster(points)
        if cluster is None:
            continue
        estimate = _block(views, index, name, cluster, catalogue, box)
        if estimate is not None:
            found[name] = estimate
        else:
            glimpses[name] = Glimpse(name, np.median(cluster[:, :2], axis=0))
    for name, block in list(found.items()):
        # Under another block only a rim of the top face shows, or a side that looks like one: no measurement.
        if any(_covers(other, block) for other in found.values()):
            glimpses[name] = Glimpse(name, found.pop(name).features[:2])
    return found, glimpses


def _covers(upper: BlockEstimate, lower: BlockEstimate) -> bool:
    apart = float(np.hypot(*(upper.features[:2] - lower.features[:2])))
    return upper.top_z > lower.top_z + TYPICAL_HEIGHT / 2 and apart < COVERED_WITHIN


def _block(
    views: Sequence[View], index: int, name: str, cluster: np.ndarray, catalogue: Catalogue, box: BoxEstimate | None
) -> BlockEstimate | None:
    top_z = _peak_height(cluster[:, 2])
    on_top = np.abs(cluster[:, 2] - top_z) < 0.005
    # Sides alone have no peak: their heights are spread over the whole block.
    if on_top.sum() < 60 or on_top.mean() < 0.3:
        return None
    top = cluster[on_top]
    centre, yaw, extents = rough_rectangle(_without_stragglers(top[:, :2]))
    least, most = catalogue.block_width
    if extents.max() < least * 0.6 or extents.max() > most * 1.4:
        return None

    def of_block(view: View) -> np.ndarray:
        return view.labels == index

    cells = grid(centre, 0.055, 0.001)
    votes = vote(views, cells, top_z, of_block, outward_of_face(cells, centre))
    r = fit_rectangle(votes, (centre, yaw, np.clip(extents, least, most)), square=True)
    if not least <= r.width <= most or r.misfit > 0.35:
        return None
    ground = catalogue.table_z
    if box is not None and inside_box(np.array([r.x, r.y]), box.features):
        ground += catalogue.floor_thickness
    tilt = _tilt(top)
    height = top_z - ground
    low, high = catalogue.block_height
    # Of a tower only the whole height is seen: its blocks share it.
    storeys = 1 if height <= high else round(height / TYPICAL_HEIGHT)
    size_z, size_z_sigma = height / storeys, SIZE_SIGMA if storeys == 1 else 0.003
    features = np.array(
        [r.x, r.y, top_z - size_z / 2, *spatial.quat_from_yaw(r.yaw), r.width, r.width, size_z], dtype=np.float64
    )
    n = max(votes.views, 1)
    covariance = np.zeros((10, 10))
    z_variance = HEIGHT_SIGMA**2 + (size_z_sigma / 2) ** 2
    covariance[:7, :7] = _fitted_covariance(r, VIEW_SIGMA**2 / n, z_variance, VIEW_YAW_SIGMA**2 / n)
    covariance[7:9, 7:9] = r.sigma[3] ** 2 + SIZE_SIGMA**2
    covariance[9, 9] = size_z_sigma**2
    upright = tilt < UPRIGHT_WITHIN and height >= low and _has_stud(cluster, r, top_z, catalogue)
    return BlockEstimate(name, features, covariance, top_z, upright, storeys > 1, votes.views)


def _has_stud(cluster: np.ndarray, r: Rectangle, top_z: float, catalogue: Catalogue) -> bool:
    """Does something of the stud's height stand on the middle of the top face? Not so on a block that lies."""
    middle = np.hypot(cluster[:, 0] - r.x, cluster[:, 1] - r.y) < catalogue.stud_width / 2
    high = cluster[middle, 2] > top_z + catalogue.stud_height / 2
    return len(high) > 20 and bool(high.mean() > 0.3)


def inside_box(xy: Float[np.ndarray, "2"], box: Float[np.ndarray, "11"]) -> bool:
    """Is a point of the table within the walls of a box with these features?"""
    yaw = float(spatial.yaw_of(box[3:7]))
    c, s = np.cos(yaw), np.sin(yaw)
    dx, dy = xy - box[:2]
    return bool(abs(dx * c + dy * s) < box[7] / 2 and abs(dy * c - dx * s) < box[8] / 2)


def upright_covariance(
    position: Float[np.ndarray, "3"], yaw_variance: float, quat: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "7 7"]:
    """Covariance of x y z qw qx qy qz of something upright, from the variances of its position and its yaw."""
    covariance = np.zeros((7, 7))
    covariance[:3, :3] = np.diag(position)
    half = float(spatial.yaw_of(quat)) / 2
    by_yaw = np.array([-np.sin(half), 0.0, 0.0, np.cos(half)]) / 2
    covariance[3:, 3:] = yaw_variance * np.outer(by_yaw, by_yaw)
    return covariance


def yaw_variance_of(covariance: np.ndarray) -> float:
    """rad^2, from the covariance of features that begin with a pose; the inverse of `upright_covariance`."""
    return 4.0 * float(np.trace(covariance[3:7, 3:7]))


def _fitted_covariance(r: Rectangle, xy_variance: float, z_variance: float, yaw_variance: float) -> np.ndarray:
    position = np.array([xy_variance + r.sigma[0] ** 2, xy_variance + r.sigma[1] ** 2, z_variance])
    return upright_covariance(position, yaw_variance + r.sigma[2] ** 2, spatial.quat_from_yaw(r.yaw))


def _rim_mask(view: View, low: float, high: float) -> np.ndarray:
    z = view.points[..., 2]
    return view.valid & (view.labels == BACKGROUND) & (z > low) & (z < high)


def _on_the_table(view: View, catalogue: Catalogue) -> np.ndarray:
    z = view.points[..., 2] - catalogue.table_z
    return (z > 0.008) & (z < 0.26)


def _peak_height(z: np.ndarray) -> float:
    """Height of the horizontal face that most points lie on, m."""
    low = float(z.min()) - 0.005
    counts = np.bincount(((z - low) / 0.001).astype(int)).astype(np.float64)
    kernel = np.exp(-0.5 * (np.arange(-5, 6) / 1.6) ** 2)
    peak = low + 0.001 * (int(np.argmax(np.convolve(counts, kernel, mode="same"))) + 0.5)
    for _ in range(3):
        peak = float(np.mean(z[np.abs(z - peak) < 0.0035]))
    return peak


def _largest_cluster(points: np.ndarray, step: float = 0.006) -> np.ndarray | None:
    """The points of the largest connected patch seen from above, without stray ones; None where there are few."""
    if len(points) < 40:
        return None
    origin = points[:, :2].min(axis=0) - step
    cell = ((points[:, :2] - origin) / step).astype(int)
    shape = cell.max(axis=0) + 2
    count = np.zeros(shape, dtype=np.int32)
    np.add.at(count, (cell[:, 0], cell[:, 1]), 1)
    _, labels = cv2.connectedComponents((count >= 2).astype(np.uint8), connectivity=8)
    of_point = labels[cell[:, 0], cell[:, 1]]
    sizes = np.bincount(of_point)
    sizes[0] = 0
    cluster = points[of_point == int(np.argmax(sizes))]
    return cluster if len(cluster) >= 40 else None


def _without_stragglers(xy: np.ndarray) -> np.ndarray:
    away = np.linalg.norm(xy - np.median(xy, axis=0), axis=1)
    return xy[away <= np.percentile(away, 97)]


def _tilt(top: np.ndarray) -> float:
    """Angle of the plane through points against the horizontal, rad."""
    centred = top - top.mean(axis=0)
    a, b = np.linalg.lstsq(centred[:, :2], centred[:, 2], rcond=None)[0]
    return float(np.arctan(np.hypot(a, b)))
