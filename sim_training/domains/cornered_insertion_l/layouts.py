"""Where things begin: box and blocks as in Cornered Insertion-S, a lid on or beside the box, a drawer on the left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from resync_robot.core import fittings, spatial
from resync_robot.core.state import State
from resync_robot.core.symbols import Atoms
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK, DRAWER, LID
from resync_robot.sim_training.domains.cornered_insertion_s import layouts
from resync_robot.sim_training.domains.cornered_insertion_s.corner import LIFTED
from resync_robot.sim_training.domains.cornered_insertion_s.layouts import THE_BOX, R, lay_out, robot_at_home
from resync_robot.sim_training.physics.parts import TABLE_TOP
from resync_robot.sim_training.physics.randomise import USUAL, Ranges, draw_fittings, draw_physics

THE_LID, THE_DRAWER = LID("lid"), DRAWER("drawer")

BESIDE = ((0.19, 0.29), (-0.63, -0.33))
"""x and y in the world, m, of a free block on the table: to the right of the robot, where a lid leaves it room."""
APART = 0.12
"""Least distance between the centres of two of these, m: a finger fits between."""
PUT_DOWN = ((0.54, 0.58), (-0.48, -0.44))
"""The same of a lid that is off the box."""
FACE = ((0.485, 0.515), (0.41, 0.44))
"""The same of the middle of a cabinet's face; the drawer opens towards the robot."""
AHEAD = (0.03, 0.06)
"""m from a closed drawer's handle to the nearest point of a block that stands in its way."""


@dataclass(frozen=True, kw_only=True)
class FurnishedLayout(layouts.Layout):
    """Where everything of a task begins.

    Attributes:
        lid_on: the lid covers the box; else it lies on the table.
        drawer_open: as wide as it goes; else closed.
        in_the_way: blocks that stand where the drawer opens to.
    """

    lid_on: bool = True
    drawer_open: bool = False
    in_the_way: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return (*super().names, *self.in_the_way)


def sample_task(
    rng: np.random.Generator, seed: int, goal: Atoms, layout: FurnishedLayout, ranges: Ranges = USUAL
) -> Task:
    """A task with everything where `layout` wants it."""
    features, sizes = lay_out(rng, layout, ranges, beside_the_robot, APART)
    features[R] = robot_at_home()
    features[THE_LID] = sample_lid(rng, features[THE_BOX] if layout.lid_on else None)
    features[THE_DRAWER] = sample_drawer(rng, fittings.DRAWER.travel if layout.drawer_open else 0.0)
    for name in layout.in_the_way:
        features[BLOCK(name)] = before_drawer(rng, features[THE_DRAWER], sizes[name])
    state = State(features)
    physics = draw_physics(rng, sorted(sizes), ranges) | draw_fittings(rng, ranges)
    return Task(state.objects, state, goal, physics, seed)


def beside_the_robot(rng: np.random.Generator, box: np.ndarray) -> tuple[float, float, float]:
    """(x, y, yaw) in the frame of the box of a free block on the table."""
    place = np.array([*(rng.uniform(*ends) for ends in BESIDE), 0.0, 1.0])
    x, y = (spatial.inverse(spatial.pose_from_features(box[:7])) @ place)[:2]
    return float(x), float(y), rng.uniform(-np.pi, np.pi)


def sample_lid(rng: np.random.Generator, box: np.ndarray | None) -> np.ndarray:
    """(10,) features of a lid that covers the box, or of one that lies on the table."""
    size = fittings.LID.size
    if box is None:
        x, y = (rng.uniform(*ends) for ends in PUT_DOWN)
        yaw, ground = rng.uniform(-0.1, 0.1), TABLE_TOP
    else:
        x, y = box[:2] + rng.uniform(-0.004, 0.004, 2)
        yaw, ground = float(spatial.yaw_of(box[3:7])) + rng.uniform(-0.03, 0.03), box[2] + box[9]
    return np.array([x, y, ground + size[2] / 2 + LIFTED, *spatial.quat_from_yaw(yaw), *size])


def sample_drawer(rng: np.random.Generator, opening: float) -> np.ndarray:
    """(11,) features of a drawer to the left of the box, `opening` m open."""
    size = fittings.DRAWER.front
    face, yaw = np.array([rng.uniform(*ends) for ends in FACE]), np.pi + rng.uniform(-0.1, 0.1)
    x, y = face + (size[0] / 2 + opening) * np.array([np.cos(yaw), np.sin(yaw)])
    z = TABLE_TOP + fittings.DRAWER.lift + size[2] / 2
    return np.array([x, y, z, *spatial.quat_from_yaw(yaw), opening, *size])


def before_drawer(rng: np.random.Generator, drawer: np.ndarray, size: np.ndarray) -> np.ndarray:
    """(10,) features of a block on the table, before a closed drawer."""
    ahead = drawer[8] / 2 + fittings.DRAWER.reach + rng.uniform(*AHEAD) + size[0] / np.sqrt(2)
    place = np.array([ahead, rng.uniform(-0.06, 0.06), 0.0, 1.0])
    x, y = (spatial.pose_from_features(drawer[:7]) @ place)[:2]
    z = TABLE_TOP + size[2] / 2 + LIFTED
    return np.array([x, y, z, *spatial.quat_from_yaw(rng.uniform(-np.pi, np.pi)), *size])
