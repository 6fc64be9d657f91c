"""What a classifier sees of one, two or three objects: features without the frame the scene happens to lie in.

All functions take feature arrays as states store them (world frame, m, quaternions wxyz, one row a sample) and are
vectorised over the samples. A box looks the same after a quarter turn or in a mirror, so what is seen in its frame
is folded onto one eighth of it: a corner learned is every corner.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from resync_robot.core.spatial import matrix_from_quat, yaw_of
from resync_robot.core.state import State
from resync_robot.core.symbols import Object, Type
from resync_robot.core.vocabulary import BLOCK, BOX, POSE, ROBOT

Rows = Float[np.ndarray, "n f"]

PERCEPTION_POSITION_M = 0.002
PERCEPTION_ANGLE = float(np.deg2rad(0.5))
"""Standard deviations of an estimated pose; training adds noise of this size."""


def gather(states: Sequence[State], groundings: Sequence[tuple[Object, ...]]) -> tuple[Rows, ...]:
    """Features of each argument: entry i holds, for each sample, those of the i-th object in its state."""
    arity = len(groundings[0]) if groundings else 0
    return tuple(np.stack([s[g[i]] for s, g in zip(states, groundings, strict=True)]) for i in range(arity))


def relative_features(types: Sequence[Type], rows: Sequence[Rows]) -> Rows:
    """(n, d) canonical features of objects of these types; d depends on the types alone.

    One object is seen as it stands on the table, two in relation to each other, three as their pairs.
    """
    types = tuple(types)
    if not types:
        return np.zeros((len(rows[0]) if rows else 0, 0))
    if len(types) == 1:
        return _alone(types[0], rows[0])
    if len(types) == 2:
        return PAIRS.get((types[0].name, types[1].name), _pair)(types[0], rows[0], types[1], rows[1])
    pairs = [(i, j) for i in range(len(types)) for j in range(i + 1, len(types))]
    return np.concatenate([relative_features((types[i], types[j]), (rows[i], rows[j])) for i, j in pairs], -1)


def perturb(
    kind: Type,
    rows: Rows,
    rng: np.random.Generator,
    position_m: float = PERCEPTION_POSITION_M,
    angle: float = PERCEPTION_ANGLE,
) -> Rows:
    """The rows with the pose error of perception: `position_m` on each axis, `angle` (rad) of heading.

    The robot knows its own pose from its joints, and a type without a pose has none to disturb: both stay.
    """
    if kind == ROBOT or kind.features[: len(POSE)] != POSE:
        return rows
    noisy = rows.copy()
    noisy[:, :3] += rng.normal(0.0, position_m, (len(rows), 3))
    half = rng.normal(0.0, angle, len(rows)) / 2
    # Left factor of the quaternion product: a turn about the world's z axis.
    c, s = np.cos(half), np.sin(half)
    w, x, y, z = rows[:, 3:7].T
    noisy[:, 3:7] = np.stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], -1)
    return noisy


OUTSIDE = -0.05
"""What stands for the gaps to the walls of a box, m, where something is not in it."""


def in_box(box: Rows, pose: Rows) -> tuple[np.ndarray, np.ndarray]:
    """Position (n, 3) and heading (n,) of `pose` (x y z qw qx qy qz ...) in the frame of the box."""
    world_R_box = matrix_from_quat(box[:, 3:7])
    position = np.einsum("nij,ni->nj", world_R_box, pose[:, :3] - box[:, :3])
    box_R_pose = np.swapaxes(world_R_box, -1, -2) @ matrix_from_quat(pose[:, 3:7])
    return position, np.arctan2(box_R_pose[:, 1, 0], box_R_pose[:, 0, 0])


def _block_box(_: Type, block: Rows, __: Type, box: Rows) -> Rows:
    position, heading = in_box(box, block)
    half = box[:, 7:9] / 2
    to_wall = half - np.abs(position[:, :2])
    # What hinders is the room between surfaces, whatever the size of block and box; the nearer wall first.
    gaps = to_wall - block[:, 7:8] / 2 * (np.abs(np.cos(heading)) + np.abs(np.sin(heading)))[:, None]
    order = np.argsort(gaps, axis=1, kind="stable")
    # Outside is outside: walls do not hinder there, and how far along them it is tells nothing.
    gaps[to_wall.min(1) < 0] = OUTSIDE
    # A mirror turns both the heading and the bearing round, so the product of the two sines does not see it.
    bearing = np.arctan2(position[:, 1], position[:, 0])
    return np.concatenate(
        [
            np.take_along_axis(gaps, order, 1),
            np.take_along_axis(half, order, 1),
            position[:, 2:3],
            np.cos(4 * heading)[:, None],
            (np.sin(4 * heading) * np.sin(4 * bearing))[:, None],
            _upright(block),
            block[:, 7:10],
            box[:, 9:11],
        ],
        -1,
    )


def _robot_box(_: Type, robot: Rows, __: Type, box: Rows) -> Rows:
    position, heading = in_box(box, robot)
    half = box[:, 7:9] / 2
    to_wall = np.sort(half - np.abs(position[:, :2]), axis=1)
    return np.concatenate([to_wall, position[:, 2:3], np.cos(4 * heading)[:, None], robot[:, 7:]], -1)


def _block_block(_: Type, a: Rows, __: Type, b: Rows) -> Rows:
    offset = a[:, :3] - b[:, :3]
    turn = yaw_of(a[:, 3:7]) - yaw_of(b[:, 3:7])
    planar = np.linalg.norm(offset[:, :2], axis=1, keepdims=True)
    return np.concatenate([planar, offset[:, 2:], np.cos(4 * turn)[:, None], a[:, 7:], b[:, 7:]], -1)


def _robot_block(_: Type, robot: Rows, __: Type, block: Rows) -> Rows:
    offset = robot[:, :3] - block[:, :3]
    planar = np.linalg.norm(offset[:, :2], axis=1, keepdims=True)
    turn = yaw_of(robot[:, 3:7]) - yaw_of(block[:, 3:7])
    return np.concatenate([planar, offset[:, 2:], np.cos(4 * turn)[:, None], robot[:, 7:], block[:, 7:]], -1)


PAIRS: dict[tuple[str, str], Callable[[Type, Rows, Type, Rows], Rows]] = {
    (BLOCK.name, BOX.name): _block_box,
    (ROBOT.name, BOX.name): _robot_box,
    (BLOCK.name, BLOCK.name): _block_block,
    (ROBOT.name, BLOCK.name): _robot_block,
}
"""Types whose relation has a symmetry to use; all others are seen through `_pair`."""


def _pair(a_type: Type, a: Rows, b_type: Type, b: Rows) -> Rows:
    """The pose of a in the frame of b, where both have one, and every other feature of both."""
    a_rest, b_rest = a, b
    seen = []
    if a_type.features[:7] == POSE and b_type.features[:7] == POSE:
        position, heading = in_box(b, a)
        seen = [position, np.cos(heading)[:, None], np.sin(heading)[:, None], _upright(a), _upright(b)]
        a_rest, b_rest = a[:, 7:], b[:, 7:]
    return np.concatenate([*seen, a_rest, b_rest], -1)


def _alone(kind: Type, rows: Rows) -> Rows:
    if kind.features[:7] != POSE:
        return rows
    heading = yaw_of(rows[:, 3:7])
    return np.concatenate(
        [rows[:, :3], np.cos(4 * heading)[:, None], np.sin(4 * heading)[:, None], _upright(rows), rows[:, 7:]], -1
    )


def _upright(rows: Rows) -> np.ndarray:
    """(n, 1) cosine between the object's z axis and the world's."""
    return matrix_from_quat(rows[:, 3:7])[:, 2, 2][:, None]
