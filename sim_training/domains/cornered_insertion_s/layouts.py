"""Where things begin: boxes, block sizes, and blocks in corners, against walls, in between and free."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from resync_robot.core import spatial
from resync_robot.core.errors import TrainingError
from resync_robot.core.rig import load_rig
from resync_robot.core.solids import BOX_FLOOR
from resync_robot.core.state import State
from resync_robot.core.symbols import Atoms, Object
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.sim_training.domains.cornered_insertion_s.corner import at_walls, block_features
from resync_robot.sim_training.physics.randomise import USUAL, Ranges, draw_physics

R, THE_BOX = ROBOT("r"), BOX("box")

CORNER_GAP = (0.0005, 0.003)
"""Gap to each of the two walls of a cornered block, m."""
MIDDLING_GAP = (0.005, 0.035)
"""The same of a block between cornered and free: some skills work on it, others do not."""
FREE_GAP = 0.045
"""Least gap to every wall of a block that begins free, m."""
APART = 0.16
"""Least distance between the centres of a cornered block and a free one in the box, m: room to be dragged into."""

WIDTHS = (0.046, 0.070)
"""Of a set of blocks, m."""
DRAWN, TRIES = 3000, 50
"""Scenes that are drawn until one has room for all of its blocks, and places that each block is tried at."""


def sample_box(rng: np.random.Generator) -> np.ndarray:
    """(11,) features of the box: where it stands on the table, and how large it is."""
    x, y, yaw = rng.uniform(0.45, 0.51), rng.uniform(-0.03, 0.03), rng.uniform(-0.2, 0.2)
    inner = rng.uniform(0.28, 0.32, 2)
    return np.array([x, y, BOX_FLOOR, *spatial.quat_from_yaw(yaw), *inner, rng.uniform(0.10, 0.115), 0.03])


def sample_block_sizes(
    rng: np.random.Generator,
    names: Sequence[str],
    ranges: Ranges = USUAL,
    widths: tuple[float, float] = WIDTHS,
) -> dict[str, np.ndarray]:
    """(3,) extents of each body: one footprint for the set, as building blocks have, and a height each."""
    width = ranges.draw(rng, *widths)
    sizes = {}
    for name in names:
        # Moulded building blocks agree to a hundredth of a millimetre. Rubber pads would bear more; rigid ones do not.
        side = width + rng.uniform(-0.00001, 0.00001)
        sizes[name] = np.array([side, side, ranges.draw(rng, 0.040, 0.050)])
    return sizes


def corner_pose(
    rng: np.random.Generator, box: np.ndarray, width: float, corner: int, gap: tuple[float, float] = CORNER_GAP
) -> tuple[float, float, float]:
    """(x, y, yaw) in the box's frame, in corner 0-3 with a gap to each of its walls."""
    sx, sy = ((1, 1), (1, -1), (-1, 1), (-1, -1))[corner]
    yaw = rng.uniform(-0.03, 0.03) + rng.integers(4) * np.pi / 2
    x, y = at_walls(box, width, yaw, np.array([sx, sy]), rng.uniform(*gap, 2))
    return float(x), float(y), yaw


def wall_pose(rng: np.random.Generator, box: np.ndarray, width: float, wall: int) -> tuple[float, float, float]:
    """(x, y, yaw) in the box's frame, against the middle of wall 0-3 only."""
    yaw = rng.uniform(-0.03, 0.03) + rng.integers(4) * np.pi / 2
    axis, sign = wall // 2, 1 - 2 * (wall % 2)
    place = at_walls(box, width, yaw, float(sign), rng.uniform(*CORNER_GAP))
    place[1 - axis] = rng.uniform(-0.06, 0.06)
    return float(place[0]), float(place[1]), yaw


def free_in_box(rng: np.random.Generator, box: np.ndarray, width: float) -> tuple[float, float, float]:
    room = box[7:9] / 2 - width * 0.71 - FREE_GAP
    x, y = rng.uniform(-room, room)
    return float(x), float(y), rng.uniform(-np.pi, np.pi)


def free_on_table(rng: np.random.Generator, box: np.ndarray) -> tuple[float, float, float]:
    """(x, y, yaw) in the box's frame, to the left or right of it."""
    beside = box[8] / 2 + box[10] + rng.uniform(0.085, 0.13)
    return rng.uniform(-0.10, 0.08), float(rng.choice([-1, 1])) * beside, rng.uniform(-np.pi, np.pi)


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Where the blocks of a task begin.

    Attributes:
        cornered: in a corner of the box.
        walled: against one wall only.
        gapped: in a corner with `MIDDLING_GAP` to each of the walls.
        free: with room on all sides, in the box or on the table.
        in_box: probability that a free block stands in the box.
        widths: between which that of the blocks is drawn, m.
    """

    cornered: tuple[str, ...] = ()
    walled: tuple[str, ...] = ()
    gapped: tuple[str, ...] = ()
    free: tuple[str, ...] = ()
    in_box: float = 0.5
    widths: tuple[float, float] = WIDTHS

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.cornered, *self.walled, *self.gapped, *self.free)


def sample_task(rng: np.random.Generator, seed: int, goal: Atoms, layout: Layout, ranges: Ranges = USUAL) -> Task:
    """A task with every block where `layout` wants it."""
    features, _ = lay_out(rng, layout, ranges)
    names = sorted(o.name for o in features if o.type == BLOCK)
    features[R] = robot_at_home()
    state = State(features)
    return Task(state.objects, state, goal, draw_physics(rng, names, ranges), seed)


def robot_at_home() -> np.ndarray:
    """(8,) features of a robot that has done nothing yet."""
    return np.array([0.45, 0.0, 0.30, 0.0, 1.0, 0.0, 0.0, load_rig().gripper.max_opening])


def lay_out(
    rng: np.random.Generator,
    layout: Layout,
    ranges: Ranges = USUAL,
    on_table: Callable[[np.random.Generator, np.ndarray], tuple[float, float, float]] = free_on_table,
    apart_there: float = APART,
) -> tuple[dict[Object, np.ndarray], dict[str, np.ndarray]]:
    """Features of a box and of every block in it or on the table, and the sizes of all blocks by name.

    Args:
        on_table: where a free block stands that is not in the box, as `free_on_table` does.
        apart_there: least distance between the centres of two of these, m.

    Raises:
        TrainingError: there is no room for so many blocks.
    """
    # Where many blocks stand, to draw all of them at once would take for ever. To draw one after the other gives other
    # scenes, so it is left for those.
    for tries in (1, TRIES):
        for _ in range(DRAWN):
            box, corners = sample_box(rng), rng.permutation(4)
            sizes = sample_block_sizes(rng, layout.names, ranges, layout.widths)
            local, outside = _walled(rng, layout, box, corners, sizes), set[str]()
            for name in layout.free:
                for _ in range(tries):
                    outside.discard(name)
                    if rng.random() < layout.in_box:
                        local[name] = free_in_box(rng, box, sizes[name][0])
                    else:
                        local[name] = on_table(rng, box)
                        outside.add(name)
                    if tries > 1 and _apart(local, outside, apart_there):
                        break
            if _apart(local, outside, apart_there):
                features = {BLOCK(n): block_features(box, local[n], sizes[n], n in outside) for n in sorted(local)}
                return {**features, THE_BOX: box}, sizes
    raise TrainingError(
        f"there is no room for {len(layout.names)} blocks in the box and on the table", "ask for fewer blocks"
    )


def _walled(
    rng: np.random.Generator, layout: Layout, box: np.ndarray, corners: np.ndarray, sizes: dict[str, np.ndarray]
) -> dict[str, tuple[float, float, float]]:
    """(x, y, yaw) in the box's frame of every block that begins at a wall or in a corner, the next of `corners`."""
    left, local = iter(corners), dict[str, tuple[float, float, float]]()
    for name in layout.cornered:
        local[name] = corner_pose(rng, box, sizes[name][0], int(next(left)))
    for name in layout.gapped:
        local[name] = corner_pose(rng, box, sizes[name][0], int(next(left)), MIDDLING_GAP)
    for name in layout.walled:
        local[name] = wall_pose(rng, box, sizes[name][0], int(rng.integers(4)))
    return local


def _apart(local: dict[str, tuple[float, float, float]], outside: set[str], apart_there: float) -> bool:
    """Whether no two blocks are nearer to each other than they may be."""
    return all(
        np.hypot(local[a][0] - local[b][0], local[a][1] - local[b][1]) > (apart_there if {a, b} <= outside else APART)
        for a, b in combinations(local, 2)
    )
