"""Cornered Insertion-S: insert studded blocks onto each other; some begin trapped in a corner of an open box.

A cornered block can neither be picked (a finger lands on the wall) nor inserted upon (the hand that holds the other
block does). Nothing here says so: the given model is oblivious, and the physics fails it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from resync_robot.core import spatial
from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Atoms, Object, Operator, Predicate, Variable
from resync_robot.core.task import Domain, Scenario, Task
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.learning.failures import place_relative
from sim_training.parts import BOX_FLOOR
from sim_training.randomise import draw_physics

R, THE_BOX = ROBOT("r"), BOX("box")
HAND_EMPTY = Predicate("HandEmpty", (ROBOT,))
HOLDING = Predicate("Holding", (ROBOT, BLOCK))
ON = Predicate("On", (BLOCK, BLOCK))

_r, _b, _b0, _b1 = (Variable(n, t) for n, t in (("?r", ROBOT), ("?b", BLOCK), ("?b0", BLOCK), ("?b1", BLOCK)))
PICK = Operator(
    "Pick", (_r, _b), frozenset({HAND_EMPTY(_r)}), frozenset({HOLDING(_r, _b)}), frozenset({HAND_EMPTY(_r)})
)
INSERT = Operator(
    "Insert",
    (_r, _b0, _b1),
    frozenset({HOLDING(_r, _b0)}),
    frozenset({ON(_b0, _b1), HAND_EMPTY(_r)}),
    frozenset({HOLDING(_r, _b0)}),
)


def holding(state: State, objects: tuple[Object, ...]) -> float:
    """Is the block between pads that are closed on it?"""
    robot, block = objects
    tip_T_block = spatial.inverse(spatial.pose_from_features(state[robot][:7])) @ spatial.pose_from_features(
        state[block][:7]
    )
    width = state.get(block, "size_x", "size_y").max()
    x, y, z = np.abs(tip_T_block[:3, 3])
    gripped = state.get(robot, "opening")[0] < width + 0.008
    return float(gripped and x < 0.03 and y < 0.02 and z < 0.04)


def hand_empty(state: State, objects: tuple[Object, ...]) -> float:
    return 1.0 - max((holding(state, (objects[0], b)) for b in state.of_type(BLOCK)), default=0.0)


def on(state: State, objects: tuple[Object, ...]) -> float:
    """Is the upper block seated on the lower one's stud (not merely lying on it)?"""
    upper, lower = objects
    gap = state.get(upper, "x", "y", "z") - state.get(lower, "x", "y", "z")
    seated = (state.get(upper, "size_z")[0] + state.get(lower, "size_z")[0]) / 2
    return float(abs(gap[2] - seated) < 0.006 and np.hypot(gap[0], gap[1]) < 0.010)


# -- sampling ---------------------------------------------------------------------------------------------------------

CORNER_GAP = (0.0005, 0.003)
"""Gap to each of the two walls of a cornered block, m."""
FREE_GAP = 0.045
"""Least gap to every wall of a block that begins free, m."""
APART = 0.16
"""Least distance between the centres of a cornered block and a free one in the box, m: room to be dragged into."""

Placer = Callable[[np.random.Generator, np.ndarray, float, int], tuple[float, float, float]]


def sample_box(rng: np.random.Generator) -> np.ndarray:
    """(11,) features of the box: where it stands on the table, and how large it is."""
    x, y, yaw = rng.uniform(0.45, 0.51), rng.uniform(-0.03, 0.03), rng.uniform(-0.2, 0.2)
    inner = rng.uniform(0.28, 0.32, 2)
    return np.array([x, y, BOX_FLOOR, *spatial.quat_from_yaw(yaw), *inner, rng.uniform(0.10, 0.115), 0.03])


def sample_block_sizes(rng: np.random.Generator, names: Sequence[str]) -> dict[str, np.ndarray]:
    """(3,) extents of each body: one footprint for the set, as building blocks have, and a height each."""
    width = rng.uniform(0.052, 0.066)
    sizes = {}
    for name in names:
        # Moulded blocks agree to a few hundredths; rubber pads give way by more, the rigid ones simulated here do not.
        side = width + rng.uniform(-0.00005, 0.00005)
        sizes[name] = np.array([side, side, rng.uniform(0.040, 0.050)])
    return sizes


def block_features(box: np.ndarray, local: Sequence[float], size: np.ndarray, on_table: bool = False) -> np.ndarray:
    """(10,) features of a block that stands at `local` = (x, y, yaw) in the box's frame, in it or on the table."""
    world = spatial.pose_from_features(box[:7]) @ spatial.transform(
        spatial.rotation_about("z", local[2]), np.array([local[0], local[1], 0.0])
    )
    features = spatial.features_from_pose(world)
    features[2] = size[2] / 2 + (0.0 if on_table else BOX_FLOOR) + 0.0005
    return np.concatenate([features, size])


def corner_pose(rng: np.random.Generator, box: np.ndarray, width: float, corner: int) -> tuple[float, float, float]:
    """(x, y, yaw) in the box's frame, squeezed into corner 0-3."""
    sx, sy = ((1, 1), (1, -1), (-1, 1), (-1, -1))[corner]
    yaw = rng.uniform(-0.03, 0.03) + rng.integers(4) * np.pi / 2
    half = width / 2 * (abs(np.cos(yaw)) + abs(np.sin(yaw)))
    x, y = (inner / 2 - half - rng.uniform(*CORNER_GAP) for inner in box[7:9])
    return sx * x, sy * y, yaw


def wall_pose(rng: np.random.Generator, box: np.ndarray, width: float, wall: int) -> tuple[float, float, float]:
    """(x, y, yaw) in the box's frame, against the middle of wall 0-3 only."""
    yaw = rng.uniform(-0.03, 0.03) + rng.integers(4) * np.pi / 2
    half = width / 2 * (abs(np.cos(yaw)) + abs(np.sin(yaw)))
    axis, sign = wall // 2, 1 - 2 * (wall % 2)
    place = np.zeros(2)
    place[axis] = sign * (box[7 + axis] / 2 - half - rng.uniform(*CORNER_GAP))
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


def sample_task(
    rng: np.random.Generator,
    seed: int,
    goal: Atoms,
    cornered: Sequence[str],
    walled: Sequence[str],
    free: Sequence[str],
    in_box: float = 0.5,
) -> Task:
    """A task with the named blocks in corners, against single walls, and free: in the box or on the table.

    Args:
        in_box: probability that a free block stands in the box.
    """
    rig = load_rig()
    while True:
        box = sample_box(rng)
        corners = rng.permutation(4)
        local: dict[str, tuple[float, float, float]] = {}
        sizes = sample_block_sizes(rng, (*cornered, *walled, *free))
        outside: set[str] = set()
        for name, corner in zip(cornered, corners, strict=False):
            local[name] = corner_pose(rng, box, sizes[name][0], int(corner))
        for name in walled:
            local[name] = wall_pose(rng, box, sizes[name][0], int(rng.integers(4)))
        for name in free:
            if rng.random() < in_box:
                local[name] = free_in_box(rng, box, sizes[name][0])
            else:
                local[name] = free_on_table(rng, box)
                outside.add(name)
        if _apart(local):
            break
    features = {BLOCK(n): block_features(box, local[n], sizes[n], n in outside) for n in sorted(local)}
    features[THE_BOX] = box
    features[R] = np.array([0.45, 0.0, 0.30, 0.0, 1.0, 0.0, 0.0, rig.gripper.max_opening])
    state = State(features)
    return Task(state.objects, state, goal, draw_physics(rng, sorted(local)), seed)


def relocate(task: Task, block: Object, relative: tuple[float, float, float], rng: np.random.Generator) -> Task:
    """The task with one block at a relative pose in the box: (small gap, large gap, heading)."""
    size = task.initial.get(block, "size_x", "size_y", "size_z")
    box = task.initial[THE_BOX]
    features = block_features(box, place_relative(box, size, relative, rng), size)
    values = dict(zip(BLOCK.features, features, strict=True))
    return Task(task.objects, task.initial.with_features(block, **values), task.goal, task.physics, task.seed)


def dream_task(rng: np.random.Generator, seed: int, blocks: int) -> Task:
    """On(b0, b1) with every block free on the table, so that any of them can be moved into the box."""
    names = [f"b{i}" for i in range(blocks)]
    return sample_task(rng, seed, frozenset({ON(BLOCK("b0"), BLOCK("b1"))}), [], [], names, in_box=0.0)


def practice_task(rng: np.random.Generator, seed: int) -> Task:
    """On(b0, b1) with one of them anywhere between deep in a corner and the middle, walls and middling gaps included.

    More often the base: Insert fails on it, and mining, which stops at the first failed Pick, never shows that.
    """
    task = dream_task(rng, seed, 2)
    if rng.random() < 0.3:
        gaps = rng.uniform(0.0005, 0.006), rng.uniform(0.0005, 0.006)
    else:
        # Two thirds near both walls, where skills begin to fail; the rest along one wall.
        gaps = rng.uniform(0.001, 0.045), rng.uniform(0.001, 0.045 if rng.random() < 0.67 else 0.09)
    # Close to a wall a block cannot stand askew.
    angle = rng.uniform(-0.05, 0.05) if min(gaps) < 0.015 else rng.uniform(-np.pi / 4, np.pi / 4)
    moved = "b1" if rng.random() < 0.7 else "b0"
    return relocate(task, BLOCK(moved), (min(gaps), max(gaps), float(angle)), rng)


def _apart(local: dict[str, tuple[float, float, float]]) -> bool:
    places = [np.array(p[:2]) for p in local.values()]
    return all(np.linalg.norm(a - b) > APART for i, a in enumerate(places) for b in places[i + 1 :])


def _scenario(
    name: str,
    description: str,
    goal: Sequence[tuple[str, str]],
    cornered: Sequence[str],
    walled: Sequence[str] = (),
    free: Sequence[str] = (),
    training: bool = False,
) -> Scenario:
    atoms = frozenset(ON(BLOCK(a), BLOCK(b)) for a, b in goal)
    return Scenario(
        name,
        description,
        lambda _domain: atoms,
        lambda rng, seed: sample_task(rng, seed, atoms, cornered, walled, free),
        training,
    )


CORNERED_INSERTION_S = Domain(
    name="cornered-insertion-s",
    types=(ROBOT, BLOCK, BOX),
    predicates=(HAND_EMPTY, HOLDING, ON),
    classifiers={"HandEmpty": hand_empty, "Holding": holding, "On": on},
    operators=(PICK, INSERT),
    recovery="Recover",
    relocate=relocate,
    dream=dream_task,
    practice=practice_task,
    scenarios={
        s.name: s
        for s in (
            _scenario(
                "s0",
                "training: pick the cornered block, insert it onto a free one",
                [("b0", "b1")],
                ["b0"],
                free=["b1"],
                training=True,
            ),
            _scenario("s1", "test: insert a free block onto the cornered one", [("b1", "b0")], ["b0"], free=["b1"]),
            _scenario(
                "s2", "test: both blocks cornered, one free bystander", [("b0", "b1")], ["b0", "b1"], free=["b2"]
            ),
            _scenario(
                "s3",
                "test: a tower of three on the cornered block",
                [("b1", "b0"), ("b2", "b1")],
                ["b0"],
                free=["b1", "b2"],
            ),
            _scenario(
                "s4",
                "test: a block against one wall onto the cornered one, another cornered bystander",
                [("b3", "b0")],
                ["b0", "b2"],
                walled=["b3"],
            ),
        )
    },
)
