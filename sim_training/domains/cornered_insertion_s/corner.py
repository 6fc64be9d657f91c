"""How a block lies in the box: the gaps to the two nearest walls and the heading, the same in every corner.

A box looks the same in a mirror, and so does the way to free a block from it; a square box also after a quarter turn.
The default relation knows of headings that are equal, but not of mirrors, nor that a box is hollow. Here a corner
learned is every corner, and boxes and blocks of any size stand for each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from resync_robot.core import spatial
from resync_robot.core.relations import DIRECTION, LENGTH, Relation, Relations, Row, Rows
from resync_robot.core.vocabulary import BLOCK, BOX
from resync_robot.sim_training.physics.parts import TABLE_TOP

OUTSIDE = -0.05
"""What stands for the gaps to the walls, m, in the features of a block that is not in the box."""
LIFTED = 0.0005
"""m that a block is put down above what it stands on."""


def half_width(side: np.ndarray | float, heading: np.ndarray | float) -> np.ndarray:
    """Half of what a square of that side takes up along each wall, m."""
    return side / 2 * (np.abs(np.cos(heading)) + np.abs(np.sin(heading)))


def in_box(box: Rows, pose: Rows) -> tuple[np.ndarray, np.ndarray]:
    """Position (n, 3) and heading (n,) of `pose` (x y z qw qx qy qz ...) in the frame of the box."""
    world_R_box = spatial.matrix_from_quat(box[:, 3:7])
    position = np.einsum("nij,ni->nj", world_R_box, pose[:, :3] - box[:, :3])
    box_R_pose = np.swapaxes(world_R_box, -1, -2) @ spatial.matrix_from_quat(pose[:, 3:7])
    return position, np.arctan2(box_R_pose[:, 1, 0], box_R_pose[:, 0, 0])


def at_walls(box: Row, side: float, heading: float, towards: np.ndarray | float, gaps: np.ndarray | float) -> Row:
    """(2,) where in the box's frame a block of that side and heading has these gaps to the walls.

    Args:
        towards: (2,) signs of the walls.
        gaps: (2,) free distance to the wall of each axis, m.
    """
    return towards * (box[7:9] / 2 - half_width(side, heading) - gaps)


def block_features(box: Row, local: Sequence[float], size: np.ndarray, on_table: bool = False) -> Row:
    """(10,) features of a block that stands at `local` = (x, y, yaw) in the box's frame, in it or on the table."""
    world = spatial.pose_from_features(box[:7]) @ spatial.transform(
        spatial.rotation_about("z", local[2]), np.array([local[0], local[1], 0.0])
    )
    row = spatial.features_from_pose(world)
    row[2] = size[2] / 2 + (TABLE_TOP if on_table else box[2]) + LIFTED
    return np.concatenate([row, size])


def in_corner(smaller: float, larger: float, heading: float) -> Row:
    """(4,) what is seen of a block with these gaps, m, and this heading, rad."""
    return np.array([smaller, larger, np.cos(4 * heading), np.sin(4 * heading)])


def _see(block: Rows, box: Rows) -> Rows:
    gaps, position, heading = _gaps(block, box)
    # Mirrored into the corner (+, +) a heading turns the other way, and so it does where the axes change places.
    turns = np.sign(position[:, 0]) * np.sign(position[:, 1]) * np.where(gaps[:, 0] <= gaps[:, 1], 1.0, -1.0)
    turns[turns == 0.0] = 1.0
    return np.stack([gaps.min(1), gaps.max(1), np.cos(4 * heading), np.sin(4 * heading) * turns], -1)


def _place(block: Row, box: Row, relative: Row, rng: np.random.Generator) -> Row:
    smaller, larger = np.sort(relative[:2])
    swap, corner = bool(rng.integers(2)), rng.choice([-1.0, 1.0], 2)
    heading = np.arctan2(relative[3], relative[2]) / 4 * corner[0] * corner[1] * (-1 if swap else 1)
    heading += rng.integers(4) * np.pi / 2
    gaps = np.array([larger, smaller] if swap else [smaller, larger])
    x, y = at_walls(box, block[7], heading, corner, gaps)
    return block_features(box, (x, y, heading), block[7:10])


def _features(block: Rows, box: Rows) -> Rows:
    gaps, position, heading = _gaps(block, box)
    half = box[:, 7:9] / 2
    # What hinders is the room between surfaces, whatever the size of block and box; the nearer wall first.
    order = np.argsort(gaps, axis=1, kind="stable")
    # Walls do not hinder outside of the box, and how far along them the block is tells nothing.
    gaps[(half - np.abs(position[:, :2])).min(1) < 0] = OUTSIDE
    # A mirror turns both the heading and the bearing round, so the product of the two sines does not see it.
    bearing = np.arctan2(position[:, 1], position[:, 0])
    return np.concatenate(
        [
            np.take_along_axis(gaps, order, 1),
            np.take_along_axis(half, order, 1),
            position[:, 2:3],
            np.cos(4 * heading)[:, None],
            (np.sin(4 * heading) * np.sin(4 * bearing))[:, None],
            spatial.matrix_from_quat(block[:, 3:7])[:, 2, 2:],
            block[:, 7:10],
            box[:, 9:11],
        ],
        -1,
    )


def _gaps(block: Rows, box: Rows) -> tuple[Rows, np.ndarray, np.ndarray]:
    """(n, 2) free distance in m from the block to the nearer wall along each axis, and the block's place in the box."""
    position, heading = in_box(box, block)
    return box[:, 7:9] / 2 - np.abs(position[:, :2]) - half_width(block[:, 7:8], heading[:, None]), position, heading


CORNER = Relation(
    names=("smaller_gap", "larger_gap", "cos_4_heading", "sin_4_heading"),
    resolution=(LENGTH, LENGTH, DIRECTION, DIRECTION),
    see=_see,
    place=_place,
    features=_features,
)
RELATIONS: Relations = {(BLOCK, BOX): CORNER}
"""All that Cornered Insertion-S declares."""
