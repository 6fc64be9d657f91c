"""From labelled views to the pose and size of the box, with a covariance; and what box and blocks have in common.

The features are those of `core.vocabulary`: a block by the centre of its body, the box by the middle of its floor.
A square block looks the same after a quarter turn: its yaw is in [-pi/4, pi/4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.errors import PerceptionError
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.outline import Rectangle, fit_rectangle, grid, outward_of_ring, rough_rectangle, vote
from resync_robot.perception.views import BACKGROUND, View, gather

HEIGHT_SIGMA = 0.0005
"""Of a horizontal face, m."""


@dataclass(frozen=True)
class ViewSigma:
    """What a single view's pose error leaves in an outline after the table has corrected its tilt and height.

    Fitted to errors in simulated scenes; `resync-robot evaluate --perception-only` shows how often ellipses hold the
    truth.

    Attributes:
        place: in x and y, m.
        yaw: rad.
    """

    place: float
    yaw: float


OFF_THE_TABLE = 0.020
"""m above the table of the underside of a lid that lies on something."""
LID_OFF, LID_ASKEW = 0.008, 0.04
"""Of the middle of a box (m) and its yaw (rad) against those of the lid that covers all of its inside."""
BOX_SIGMA = ViewSigma(place=0.00095, yaw=0.0042)


@dataclass(frozen=True)
class BoxEstimate:
    """Attributes: `features` (11,) of core.vocabulary.BOX, `covariance` (11, 11); `seen`: its rim was, and it is not
    only reckoned from the lid that covers it."""

    features: Float[np.ndarray, "11"]
    covariance: Float[np.ndarray, "11 11"]
    seen: bool = True


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
    rim_z = peak_height(points[:, 2])
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
    covariance[:7, :7] = fitted_covariance(r, HEIGHT_SIGMA**2, votes.views, BOX_SIGMA)
    covariance[7, 7] = covariance[8, 8] = r.sigma[3] ** 2 + 0.0012**2
    covariance[9, 9] = HEIGHT_SIGMA**2
    return BoxEstimate(features, covariance)


def outer_corners(box: Float[np.ndarray, "11"]) -> Float[np.ndarray, "4 2"]:
    """The corners of the outer edge of a box with these features, seen from above, in order, m."""
    half = box[7:9] / 2 + box[10]
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    c, s = np.cos(yaw := float(spatial.yaw_of(box[3:7]))), np.sin(yaw)
    return np.asarray(box[:2] + corners @ np.array([[c, s], [-s, c]]))


def box_under(lid: Float[np.ndarray, "10"], catalogue: Catalogue) -> BoxEstimate | None:
    """The box that a lid with these features lies on, where that is as high as a rim: as large as boxes are, about
    where the lid is."""
    low, high = catalogue.rim_height
    rim_z = float(lid[2] - lid[9] / 2)
    if not low <= rim_z - catalogue.table_z <= high:
        return None
    inner, floor_z = float(np.mean(catalogue.box_inner)), catalogue.table_z + catalogue.floor_thickness
    features = np.array([*lid[:2], floor_z, *lid[3:7], inner, inner, rim_z - floor_z, catalogue.wall_thickness])
    covariance = np.zeros((11, 11))
    covariance[:7, :7] = upright_covariance(np.array([LID_OFF**2, LID_OFF**2, 0.0]), LID_ASKEW**2, lid[3:7])
    covariance[7, 7] = covariance[8, 8] = np.ptp(catalogue.box_inner) ** 2 / 12
    covariance[9, 9] = HEIGHT_SIGMA**2
    return BoxEstimate(features, covariance, seen=False)


def covers(lid: Float[np.ndarray, "10"], box: Float[np.ndarray, "11"], catalogue: Catalogue) -> bool:
    """Does a lid with these features lie on a box with those?"""
    return bool(lid[2] - lid[9] / 2 > catalogue.table_z + OFF_THE_TABLE) and inside_box(lid[:2], box)


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


def tie_height(
    covariance: Float[np.ndarray, "10 10"], size_sigma: float, face_sigma: float, from_top: bool = True
) -> None:
    """Set what is known of a block's z and size_z where z is reckoned from one of its faces by half the height: an
    error of the height then moves the centre, and that face stays where it is.

    Args:
        covariance: of core.vocabulary.BLOCK, changed in place.
        size_sigma, face_sigma: of the height, and of the face's own place, m.
        from_top: from the upper face, else from the lower one.
    """
    covariance[9, 9] = size_sigma**2
    covariance[2, 2] = face_sigma**2 + size_sigma**2 / 4
    covariance[2, 9] = covariance[9, 2] = (-1 if from_top else 1) * size_sigma**2 / 2


def fitted_covariance(
    r: Rectangle, z_variance: float, views: int, sigma: ViewSigma, yaw: float | None = None
) -> Float[np.ndarray, "7 7"]:
    """Covariance of x y z qw qx qy qz of an outline that so many views show: what the fit itself does not know, and
    what the views' own poses leave. `yaw` in rad where it is not the fit's own, but that turned by quarters."""
    n = max(views, 1)
    position = np.array([sigma.place**2 / n + r.sigma[0] ** 2, sigma.place**2 / n + r.sigma[1] ** 2, z_variance])
    quat = spatial.quat_from_yaw(r.yaw if yaw is None else yaw)
    return upright_covariance(position, sigma.yaw**2 / n + r.sigma[2] ** 2, quat)


def _rim_mask(view: View, low: float, high: float) -> np.ndarray:
    z = view.points[..., 2]
    return view.valid & (view.labels == BACKGROUND) & (z > low) & (z < high)


def peak_height(z: np.ndarray) -> float:
    """Height of the horizontal face that most points lie on, m."""
    low = float(z.min()) - 0.005
    counts = np.bincount(((z - low) / 0.001).astype(int)).astype(np.float64)
    kernel = np.exp(-0.5 * (np.arange(-5, 6) / 1.6) ** 2)
    peak = low + 0.001 * (int(np.argmax(np.convolve(counts, kernel, mode="same"))) + 0.5)
    for _ in range(3):
        peak = float(np.mean(z[np.abs(z - peak) < 0.0035]))
    return peak
