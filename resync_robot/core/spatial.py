"""Rigid transforms as (..., 4, 4) matrices, quaternions as wxyz. `a_T_b` is the pose of frame b in frame a."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

Array = np.ndarray


def transform(rotation: Float[Array, "*b 3 3"] | None = None, position: Float[Array, "*b 3"] | None = None) -> Array:
    """(..., 4, 4) from a rotation matrix and a position; either may be left out."""
    batch: tuple[int, ...] = ()
    if rotation is not None:
        batch = np.shape(rotation)[:-2]
    elif position is not None:
        batch = np.shape(position)[:-1]
    result = np.zeros((*batch, 4, 4))
    result[..., :3, :3] = np.eye(3) if rotation is None else rotation
    result[..., :3, 3] = 0.0 if position is None else position
    result[..., 3, 3] = 1.0
    return result


def inverse(pose: Float[Array, "*b 4 4"]) -> Array:
    """a_T_b -> b_T_a."""
    rotation_t = np.swapaxes(pose[..., :3, :3], -1, -2)
    return transform(rotation_t, -np.einsum("...ij,...j->...i", rotation_t, pose[..., :3, 3]))


def apply(pose: Float[Array, "*b 4 4"], points: Float[Array, "*b n 3"]) -> Array:
    """Points of frame b expressed in frame a, for a_T_b."""
    return points @ np.swapaxes(pose[..., :3, :3], -1, -2) + pose[..., None, :3, 3]


def rotation_about(axis: str, angle: float | Array) -> Array:
    """(..., 3, 3) right-handed rotation about 'x', 'y' or 'z' by `angle` rad."""
    angle = np.asarray(angle, dtype=np.float64)
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    result = np.zeros((*angle.shape, 3, 3))
    c, s = np.cos(angle), np.sin(angle)
    result[..., i, i] = 1.0
    result[..., j, j], result[..., j, k] = c, -s
    result[..., k, j], result[..., k, k] = s, c
    return result


def matrix_from_quat(quat: Float[Array, "*b 4"]) -> Array:
    """(..., 3, 3) from wxyz; the quaternion is normalised first."""
    quat = np.asarray(quat, dtype=np.float64)
    w, x, y, z = np.moveaxis(quat / np.linalg.norm(quat, axis=-1, keepdims=True), -1, 0)
    entries = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return np.stack(entries, -1).reshape(*quat.shape[:-1], 3, 3)


def quat_from_matrix(rotation: Float[Array, "*b 3 3"]) -> Array:
    """(..., 4) wxyz with w >= 0."""
    m = np.asarray(rotation, dtype=np.float64)
    d = np.stack([m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]], -1)
    # The four squared components; the largest one is safe to divide by.
    squares = np.stack(
        [
            1 + d.sum(-1),
            1 + d[..., 0] - d[..., 1] - d[..., 2],
            1 - d[..., 0] + d[..., 1] - d[..., 2],
            1 - d[..., 0] - d[..., 1] + d[..., 2],
        ],
        -1,
    )
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    s = squares
    candidates = np.stack(
        [
            np.stack([s[..., 0], wx, wy, wz], -1),
            np.stack([wx, s[..., 1], xy, xz], -1),
            np.stack([wy, xy, s[..., 2], yz], -1),
            np.stack([wz, xz, yz, s[..., 3]], -1),
        ],
        -2,
    )
    best = np.argmax(squares, -1)
    quat = np.take_along_axis(candidates, best[..., None, None], -2)[..., 0, :]
    quat = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
    return np.where(quat[..., :1] < 0, -quat, quat)


def _quat_of_one(m: Float[Array, "3 3"]) -> tuple[float, float, float, float]:
    """`quat_from_matrix` of one matrix in plain floats, for control loops."""
    (a, b, c), (d, e, f), (g, h, i) = m.tolist()
    squares = (1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i)
    best = max(range(4), key=squares.__getitem__)
    rows = (
        (squares[0], h - f, c - g, d - b),
        (h - f, squares[1], b + d, c + g),
        (c - g, b + d, squares[2], f + h),
        (d - b, c + g, f + h, squares[3]),
    )
    w, x, y, z = rows[best]
    norm = math.sqrt(w * w + x * x + y * y + z * z) * (-1.0 if w < 0 else 1.0)
    return w / norm, x / norm, y / norm, z / norm


def quat_from_yaw(yaw: float | Array) -> Array:
    """(..., 4) wxyz of a rotation by `yaw` about z."""
    half = np.asarray(yaw, dtype=np.float64) / 2
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], -1)


def yaw_of(quat: Float[Array, "*b 4"]) -> Array:
    """Heading of the rotated x axis in the xy plane, rad in (-pi, pi]."""
    w, x, y, z = np.moveaxis(np.asarray(quat), -1, 0)
    return np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))


def pose_from_features(features: Float[Array, "*b 7"]) -> Array:
    """(..., 4, 4) from x y z qw qx qy qz."""
    features = np.asarray(features)
    return transform(matrix_from_quat(features[..., 3:7]), features[..., :3])


def features_from_pose(pose: Float[Array, "*b 4 4"]) -> Array:
    """(..., 7): x y z qw qx qy qz."""
    if pose.ndim == 2:
        return np.array([*pose[:3, 3], *_quat_of_one(pose[:3, :3])])
    return np.concatenate([pose[..., :3, 3], quat_from_matrix(pose[..., :3, :3])], -1)


def rotation_vector(rotation: Float[Array, "3 3"]) -> Array:
    """(3,) axis times angle (rad) of one rotation matrix."""
    quat = quat_from_matrix(rotation)
    w, xyz = quat[0], quat[1:]
    norm = np.linalg.norm(xyz)
    return np.zeros(3) if norm < 1e-12 else xyz / norm * 2 * np.arctan2(norm, w)


def rotation_from_vector(vector: Float[Array, "3"]) -> Array:
    """(3, 3) from axis times angle."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    axis = np.asarray(vector) / angle
    return matrix_from_quat(np.concatenate([[np.cos(angle / 2)], axis * np.sin(angle / 2)]))


def wrap(angle: float | Array, period: float = 2 * np.pi) -> Array:
    """The equivalent angle in [-period/2, period/2)."""
    return (np.asarray(angle) + period / 2) % period - period / 2
