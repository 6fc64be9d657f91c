"""What is known of one object from scan to scan: measured, hidden under another, or out of sight."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.perception.blocks import BlockEstimate
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.pose import HEIGHT_SIGMA, tie_height, upright_covariance, yaw_variance_of

LIFTED = 0.020
"""A block whose underside is this far above the ground stands on something, m."""
SEAT_SIGMA = 0.001
"""Of the lower face of a seated block over the upper face of the one below it, m."""
OUT_OF_SIGHT_SIGMA, OUT_OF_SIGHT_YAW = 0.02, 0.3
"""Of the old place (m) and yaw (rad) of a block that should be there and was not seen: nobody says where it went."""
TIPPED_SIGMA, TIPPED_TILT = 0.01, 0.7
"""What a block that does not stand upright adds to place and sizes, m, which are measured as if it did, and to its
tilt, rad."""


@dataclass(frozen=True)
class Known:
    """One object's estimate. `scans`: how many have measured its size, `height_known` whether its height was seen."""

    features: Float[np.ndarray, "10"]
    covariance: Float[np.ndarray, "10 10"]
    scans: int = 1
    height_known: bool = True

    @property
    def is_guess(self) -> bool:
        """Nothing of it was ever seen: what covers it says where it is."""
        return self.scans == 0


def underside(features: Float[np.ndarray, "10"]) -> float:
    """Height in m of a block's lower face."""
    return float(features[2] - features[9] / 2)


def averaged_sizes(before: Known | None, sizes: np.ndarray) -> tuple[np.ndarray, int]:
    """Mean over all scans so far and this one, and how many those are."""
    if before is None:
        return sizes.copy(), 1
    return before.features[7:] + (sizes - before.features[7:]) / (before.scans + 1), before.scans + 1


def measured(before: Known | None, estimate: BlockEstimate) -> Known:
    """A block that was seen: its pose is the new one, its sizes are those of all scans."""
    sizes, scans = averaged_sizes(before, estimate.features[7:])
    height_known = not estimate.stacked
    covariance = estimate.covariance.copy()
    if before is not None and before.height_known != height_known:
        # Only a block that stands on the ground shows its own height.
        sizes[2] = estimate.features[9] if height_known else before.features[9]
        if not height_known:
            tie_height(covariance, float(np.sqrt(before.covariance[9, 9])), HEIGHT_SIGMA)
        height_known = True
    quat = estimate.features[3:7]
    if before is not None:
        quat = _nearest_quarter_turn(quat, before.features[3:7])
    features = np.array([*estimate.features[:2], estimate.top_z - sizes[2] / 2, *quat, *sizes])
    covariance[:7, :7] = upright_covariance(np.diag(covariance)[:3], yaw_variance_of(covariance), quat)
    if not estimate.upright:
        half_tilt = TIPPED_TILT / 2
        covariance += np.diag(np.array([*[TIPPED_SIGMA] * 3, 0, half_tilt, half_tilt, 0, *[TIPPED_SIGMA] * 3]) ** 2)
    return Known(features, covariance, scans, height_known)


def moved_to(known: Known, pose: Float[np.ndarray, "4 4"]) -> Known:
    """The same thing where something else has brought it."""
    row, covariance = spatial.features_from_pose(pose), known.covariance.copy()
    covariance[:7, :7] = upright_covariance(np.diag(covariance)[:3], yaw_variance_of(covariance), row[3:7])
    return replace(known, features=np.concatenate([row, known.features[7:]]), covariance=covariance)


def somewhere_in(box: Float[np.ndarray, "11"], catalogue: Catalogue) -> Known:
    """A block that nobody has seen yet, and that a covered box with these features must hold: anywhere on its floor, of
    any heading and size."""
    (thin, wide), (low, high) = catalogue.block_width, catalogue.block_height
    width, height = (thin + wide) / 2, (low + high) / 2
    features = np.array([*box[:2], box[2] + height / 2, *box[3:7], width, width, height])
    covariance = np.zeros((10, 10))
    # A uniform distribution has a twelfth of its width's square.
    turn = spatial.pose_from_features(box[:7])[:2, :2]
    covariance[:7, :7] = upright_covariance(np.zeros(3), (np.pi / 2) ** 2 / 12, features[3:7])
    covariance[:2, :2] = turn @ np.diag((box[7:9] - width) ** 2 / 12) @ turn.T
    covariance[7:9, 7:9] = (wide - thin) ** 2 / 12
    tie_height(covariance, (high - low) / np.sqrt(12), HEIGHT_SIGMA, from_top=False)
    return Known(features, covariance, scans=0, height_known=False)


def out_of_sight(known: Known, moves: bool = False) -> Known:
    """A thing that should have been seen, and was not or more than once: its old place, roughly; and its opening, the
    feature after the pose, where it `moves` like a drawer."""
    covariance = known.covariance.copy()
    if moves:
        covariance[7] = covariance[:, 7] = 0.0
        covariance[7, 7] = max(known.covariance[7, 7], OUT_OF_SIGHT_SIGMA**2)
    place = np.maximum(np.diag(covariance)[:3], [OUT_OF_SIGHT_SIGMA**2, OUT_OF_SIGHT_SIGMA**2, 0.0])
    yaw_variance = max(yaw_variance_of(covariance), OUT_OF_SIGHT_YAW**2)
    covariance[:7, :7] = upright_covariance(place, yaw_variance, known.features[3:7])
    return replace(known, covariance=covariance)


def not_a_point_of(known: Known) -> Known:
    """A hidden block: the last estimate is all there is, and the hand has been at work since."""
    covariance = known.covariance.copy()
    covariance[:2, :2] += np.eye(2) * 0.004**2
    return replace(known, covariance=covariance)


def put_under(before: Known | None, cover: Known, ground: float) -> Known:
    """A block of which no more than a glimpse shows under `cover`, that stands over `ground` (m).

    A stud in a socket leaves 1.5 mm of play a side, so the block above tells where this one stands.
    """
    above = cover.features
    quat, size, scans = above[3:7], above[7:10], 0
    # The blocks of a tower share its height; to one whose height is its own, the next is a stranger.
    size_sigma = 0.005 if cover.height_known else float(np.sqrt(cover.covariance[9, 9]))
    if before is not None:
        quat, size = _nearest_quarter_turn(quat, before.features[3:7]), before.features[7:10]
        size_sigma, scans = 0.0015, before.scans
    # Where exactly the seam is, nobody may know; that the two meet there is what the relation of both hangs on.
    bottom, face_sigma, hangs = underside(above) - size[2], SEAT_SIGMA, True
    if before is not None and abs(underside(before.features) - ground) < LIFTED / 2:
        # It stood on the ground, and nothing lifts what something is put upon. Where the cover is too high for
        # that, it lies on the stud and is not seated: the belief must not make it fit.
        bottom, face_sigma, hangs = ground, HEIGHT_SIGMA, False
    features = np.array([*above[:2], bottom + size[2] / 2, *quat, *size])
    covariance = np.zeros((10, 10))
    variance = np.array([*(np.diag(cover.covariance)[:2] + 0.001**2), 0.0])
    covariance[:7, :7] = upright_covariance(variance, yaw_variance_of(cover.covariance) + 0.03**2, quat)
    covariance[7:, 7:] = np.eye(3) * size_sigma**2
    tie_height(covariance, size_sigma, face_sigma, from_top=hangs)
    known = before is not None and before.height_known
    return Known(features, covariance, max(scans, 1), known)


def _nearest_quarter_turn(quat: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """The same square's orientation, turned by quarters to be nearest to `reference`; both upright."""
    away = float(spatial.wrap(spatial.yaw_of(quat) - spatial.yaw_of(reference), np.pi / 2))
    return spatial.quat_from_yaw(spatial.wrap(spatial.yaw_of(reference) + away))
