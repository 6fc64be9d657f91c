"""What a picture loses because its camera moves while the shutter is open.

A still scene passes each pixel with the optical flow of the camera's own motion (the interaction matrix of image-based
visual servoing); a picture is the mean of what a pixel saw meanwhile.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from resync_robot.core import spatial
from resync_robot.core.rig import Rig

LEAST_BLUR_PX = 0.25
"""A camera whose pixels move by less than this counts as resting: its pictures stay as they are."""
MOST_SHOTS = 15
HAND_HALF = (0.075, 0.115)
"""Half extents along x and y of the flange of what rides with a camera that sits on it, m; as far out as the tips."""
_STEP = 1e-4


@dataclass(frozen=True)
class Motion:
    """How a camera moves.

    Attributes:
        twist: (6,) linear (m/s) and angular (rad/s) velocity of the camera, along its own axes.
        hand: (3,) half extents and length (m) of what rides with the camera, in the frame that it is mounted on.
    """

    twist: Float[np.ndarray, "6"]
    hand: tuple[float, float, float] = (0.0, 0.0, 0.0)


def camera_motion(rig: Rig, camera: str, q: Float[np.ndarray, "6"], qd: Float[np.ndarray, "6"]) -> Motion | None:
    """Of a camera of the rig at (6,) joint positions in rad and velocities in rad/s; None where it stands."""
    mounted = rig.camera(camera)
    if mounted.mount == "world":
        return None
    now, then = rig.camera_pose(mounted, q), rig.camera_pose(mounted, q + _STEP * qd)
    moved = spatial.inverse(now) @ then
    twist = np.concatenate([moved[:3, 3], spatial.rotation_vector(moved[:3, :3])]) / _STEP
    return Motion(twist, (*HAND_HALF, rig.gripper.tip_offset))


def flow_of(
    motion: Motion,
    depth: Float[np.ndarray, "h w"],
    intrinsics: Float[np.ndarray, "3 3"],
    mount_T_cam: Float[np.ndarray, "4 4"],
) -> Float[np.ndarray, "h w 2"]:
    """Pixels a second, right and down, by which the scene passes. Depth in m; where it is 0 the scene is far away."""
    height, width = depth.shape
    fx, fy = intrinsics[0, 0], intrinsics[1, 1]
    x = ((np.arange(width) - intrinsics[0, 2]) / fx)[None, :]
    y = ((np.arange(height) - intrinsics[1, 2]) / fy)[:, None]
    near = np.where(depth > 0, 1.0 / np.maximum(depth, 1e-6), 0.0)
    vx, vy, vz, wx, wy, wz = motion.twist
    right = fx * (near * (x * vz - vx) + x * y * wx - (1 + x**2) * wy + y * wz)
    down = fy * (near * (y * vz - vy) + (1 + y**2) * wx - x * y * wy - x * wz)
    flow = np.stack([right, down], axis=-1).astype(np.float32)
    flow[_rides(motion.hand, depth, x, y, mount_T_cam)] = 0.0
    return flow


def smear_colour(colour: np.ndarray, path: Float[np.ndarray, "h w 2"]) -> np.ndarray:
    """A picture whose pixels each saw a `path` (px) go by while the shutter was open. uint8 (H, W, 3) both."""
    shots = [_shifted(colour, path, t, cv2.INTER_LINEAR) for t in _moments(path)]
    return (
        colour if len(shots) < 2 else np.clip(np.mean(shots, axis=0, dtype=np.float32) + 0.5, 0, 255).astype(np.uint8)
    )


def smear_depth(z: Float[np.ndarray, "h w"], path: Float[np.ndarray, "h w 2"]) -> Float[np.ndarray, "h w"]:
    """Depth (m) where the matcher saw a `path` (px) go by: the mean disparity, and none where some of it has none."""
    moments = _moments(path)
    if len(moments) < 2:
        return z
    near = np.where(z > 0, 1.0 / np.maximum(z, 1e-6), 0.0).astype(np.float32)
    # Between two pixels there is no surface: each moment sees that of one of them.
    shots = np.stack([_shifted(near, path, t, cv2.INTER_NEAREST) for t in moments])
    mean = shots.mean(axis=0)
    return np.where((shots > 0).all(axis=0), 1.0 / np.maximum(mean, 1e-6), 0.0).astype(z.dtype)


def _moments(path: np.ndarray) -> np.ndarray:
    """(n,) in [-1/2, 1/2] of the exposure, about a pixel apart; one where nothing moves."""
    longest = float(np.sqrt((path**2).sum(axis=-1).max(initial=0.0)))
    if not longest >= LEAST_BLUR_PX:
        return np.zeros(1)
    return np.linspace(-0.5, 0.5, min(int(np.ceil(longest)) + 2, MOST_SHOTS))


def _shifted(picture: np.ndarray, path: np.ndarray, moment: float, how: int) -> np.ndarray:
    height, width = path.shape[:2]
    column, row = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    m = np.float32(moment)
    return cv2.remap(picture, column - m * path[..., 0], row - m * path[..., 1], how, borderMode=cv2.BORDER_REPLICATE)


def _rides(
    hand: tuple[float, float, float], depth: np.ndarray, x: np.ndarray, y: np.ndarray, mount_T_cam: np.ndarray
) -> Bool[np.ndarray, "h w"]:
    """What is nearer than the finger tips, inside the hand's outline: it moves with the camera."""
    points = np.stack([x * depth, y * depth, depth], axis=-1) @ mount_T_cam[:3, :3].T + mount_T_cam[:3, 3]
    inside = (np.abs(points[..., 0]) < hand[0]) & (np.abs(points[..., 1]) < hand[1]) & (points[..., 2] < hand[2])
    return inside & (depth > 0)
