"""Scenes with a lid and a drawer, laid out by hand, with fixed physics; as `scenes` otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from resync_robot.core import spatial
from resync_robot.core.fittings import DRAWER as BUILT
from resync_robot.core.fittings import LID as PLATE
from resync_robot.core.state import State
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK, DRAWER, LID
from tests import scenes

THE_LID, THE_DRAWER = LID("lid"), DRAWER("drawer")
STICTION = 3.0
"""N."""
FACE = (0.50, 0.425)
"""x and y of the middle of the cabinet's face, m; the drawer is pulled towards the robot."""
PHYSICS = {
    "lid": {"mass": 0.4, "friction": 0.4, "colour": (0.5, 0.1, 0.7)},
    "drawer": {
        "mass": 0.5,
        "friction": 0.3,
        "stiction": STICTION,
        "colour": (0.1, 0.6, 0.6),
        "cabinet_colour": (0.4, 0.6, 0.1),
        "handle_colour": (0.3, 0.3, 0.3),
    },
    "pad_stiffness": 1e4,
}


def lid_features(on: bool = True, yaw: float = 0.0, place: Sequence[float] = (0.55, -0.46)) -> np.ndarray:
    """(10,) of a lid on the box, or on the table at (x, y)."""
    box = scenes.box_features()
    x, y, ground = (*box[:2], box[2] + box[9]) if on else (*place, 0.0)
    return np.array([x, y, ground + PLATE.size[2] / 2 + 0.0005, *spatial.quat_from_yaw(yaw), *PLATE.size])


def drawer_features(opening: float = 0.0, yaw: float = np.pi) -> np.ndarray:
    """(11,) of a drawer so many m open."""
    ahead = BUILT.front[0] / 2 + opening
    x, y = np.array(FACE) + ahead * np.array([np.cos(yaw), np.sin(yaw)])
    z = BUILT.lift + BUILT.front[2] / 2
    return np.array([x, y, z, *spatial.quat_from_yaw(yaw), opening, *BUILT.front])


def furnished(
    blocks: Mapping[str, Sequence[float]], lid: np.ndarray | None = None, drawer: np.ndarray | None = None
) -> Task:
    """Blocks as in `scenes.scene`; the lid lies on the table and the drawer is closed unless they are given."""
    task = scenes.scene(blocks)
    features = {o: task.initial[o] for o in task.initial}
    features[THE_LID] = lid_features(on=False) if lid is None else lid
    features[THE_DRAWER] = drawer_features() if drawer is None else drawer
    state = State(features)
    return replace(task, objects=state.objects, initial=state, physics={**task.physics, **PHYSICS})


def in_tray(task: Task, *names: str) -> Task:
    """The same with these blocks as a tower in the middle of what is open of the drawer, the lowest first."""
    drawer = task.initial[THE_DRAWER]
    middle = spatial.pose_from_features(drawer[:7]) @ np.array([-(drawer[8] + drawer[7]) / 2, 0.0, 0.0, 1.0])
    state, ground = task.initial, BUILT.floor
    for name in names:
        x, y = middle[:2]
        z = ground + scenes.HEIGHT / 2 + 0.0003
        qw, qx, qy, qz = drawer[3:7]
        state = state.with_features(BLOCK(name), x=x, y=y, z=z, qw=qw, qx=qx, qy=qy, qz=qz)
        ground += scenes.HEIGHT
    return replace(task, initial=state)
