"""Scenes laid out by hand, with fixed physics: what a test says stands where it says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from resync_robot.core import spatial
from resync_robot.core.relations import seen
from resync_robot.core.state import State
from resync_robot.core.symbols import Atoms, Object
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.sim_training.domains.cornered_insertion_s.corner import RELATIONS

FLOOR = 0.005
"""Height of the box floor's upper face over the table, m."""
INNER, WALL, RIM = 0.30, 0.03, 0.11
BOX_X = 0.48
"""The box stands here on the table, in front of the arm."""
WIDTH, HEIGHT = 0.060, 0.045
R, THE_BOX = ROBOT("r"), BOX("box")
ON_THE_TABLE = {"b0": (-0.24, -0.32, 0.5, 0.0), "b1": (0.075, 0.06)}
"""b0, as `scene` takes it; b1 stands in the box."""
B0, B1, B2 = BLOCK("b0"), BLOCK("b1"), BLOCK("b2")
CORNER = INNER / 2 - WIDTH / 2 - 0.001
"""Coordinate of a block that is squeezed into the corner (+, +) of the box."""


def box_features(yaw: float = 0.0, inner: Sequence[float] = (INNER, INNER)) -> np.ndarray:
    """(11,) features of the box."""
    return np.array([BOX_X, 0.0, FLOOR, *spatial.quat_from_yaw(yaw), *inner, RIM, WALL])


def block_features(
    x: float, y: float, yaw: float = 0.0, bottom: float = FLOOR, box: np.ndarray | None = None, width: float = WIDTH
) -> np.ndarray:
    """(10,) features of a block at (x, y, yaw) in the frame of the box, its underside at `bottom` in the world."""
    box = box_features() if box is None else box
    pose = spatial.pose_from_features(box[:7]) @ spatial.transform(spatial.rotation_about("z", yaw), [x, y, 0.0])
    features = spatial.features_from_pose(pose)
    features[2] = bottom + HEIGHT / 2 + 0.0005
    return np.array([*features, width, width, HEIGHT])


def scene(
    blocks: Mapping[str, Sequence[float]], goal: Atoms = frozenset(), box_yaw: float = 0.0, **physics: object
) -> Task:
    """A task: the box, the robot, and blocks by name at (x, y[, yaw[, bottom]]) in the frame of the box."""
    box = box_features(box_yaw)
    features = {BLOCK(name): block_features(*place, box=box) for name, place in blocks.items()}
    features |= {THE_BOX: box, R: np.array([0.45, 0.0, 0.30, 0.0, 1.0, 0.0, 0.0, 0.14])}
    state = State(features)
    drawn = {
        "friction_pad": 1.15,
        "friction_block": 0.4,
        "friction_box": 0.3,
        "gain": 1.0,
        "masses": dict.fromkeys(blocks, 0.1),
        "colours": dict.fromkeys(blocks, (0.8, 0.1, 0.1)),
    }
    return Task(state.objects, state, goal, {**drawn, **physics}, seed=0)


def in_box(state: State, block: Object) -> np.ndarray:
    """(4,) how a block lies in the box: the smaller and the larger gap to a wall, m, and its heading."""
    return seen(state, block, THE_BOX, RELATIONS)
