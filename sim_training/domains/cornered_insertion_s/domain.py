"""Cornered Insertion-S: insert studded blocks onto each other; some begin trapped in a corner of an open box.

A cornered block can neither be picked (a finger lands on the wall) nor inserted upon (the hand that holds the other
block does). Nothing here says so: the given model is oblivious, and the physics fails it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from resync_robot.core import spatial
from resync_robot.core.embodiment import Stage
from resync_robot.core.relations import moved, seen
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Atoms, Object, Operator, Predicate, Type, Variable
from resync_robot.core.task import Domain, Scenario, Task
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.sim_training.domains.cornered_insertion_s.corner import RELATIONS, in_corner
from resync_robot.sim_training.domains.cornered_insertion_s.layouts import THE_BOX, Layout, sample_task
from resync_robot.sim_training.physics.parts import CLEARANCE
from resync_robot.sim_training.physics.randomise import PRACTICE, UNSEEN, USUAL, Ranges

if TYPE_CHECKING:
    from resync_robot.sim_training.domains.cornered_insertion_s.maniskill_env import ManiSkillScenes

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
PLACE = Operator(
    "Place", (_r, _b), frozenset({HOLDING(_r, _b)}), frozenset({HAND_EMPTY(_r)}), frozenset({HOLDING(_r, _b)})
)


def holding(state: State, objects: tuple[Object, ...]) -> float:
    """Is the block between pads that are closed on it?"""
    robot, block = objects
    if state.get(robot, "opening")[0] >= state.get(block, "size_x", "size_y").max() + 0.008:
        return 0.0
    offset = state.get(block, "x", "y", "z") - state.get(robot, "x", "y", "z")
    x, y, z = np.abs(offset @ spatial.matrix_from_quat(state[robot][3:7]))
    return float(x < 0.03 and y < 0.02 and z < 0.04)


def hand_empty(state: State, objects: tuple[Object, ...]) -> float:
    return 1.0 - max((holding(state, (objects[0], b)) for b in state.of_type(BLOCK)), default=0.0)


def on(state: State, objects: tuple[Object, ...]) -> float:
    """Is the upper block seated on the lower one's stud (not merely lying on it)?"""
    upper, lower = objects
    gap = state.get(upper, "x", "y", "z") - state.get(lower, "x", "y", "z")
    seated = (state.get(upper, "size_z")[0] + state.get(lower, "size_z")[0]) / 2
    return float(abs(gap[2] - seated) < 0.006 and np.hypot(gap[0], gap[1]) < 0.010)


# -- tasks ------------------------------------------------------------------------------------------------------------


def dream_task(rng: np.random.Generator, seed: int, blocks: int) -> Task:
    """On(b0, b1) with every block free on the table, so that any of them can be moved into the box."""
    names = tuple(f"b{i}" for i in range(blocks))
    return sample_task(rng, seed, frozenset({ON(BLOCK("b0"), BLOCK("b1"))}), Layout(free=names, in_box=0.0), PRACTICE)


def free_task(rng: np.random.Generator, seed: int, counts: Mapping[Type, int]) -> Task:
    """Every block with room on all sides, in the box or on the table."""
    names = tuple(f"b{i}" for i in range(max(counts.get(BLOCK, 2), 2)))
    return sample_task(rng, seed, frozenset({ON(BLOCK("b0"), BLOCK("b1"))}), Layout(free=names), PRACTICE)


COVERED = 0.2
"""Share of practice with a third block on the one that matters."""


def practice_task(rng: np.random.Generator, seed: int) -> Task:
    """On(b0, b1) with one of them covered, or anywhere between deep in a corner and the middle of the box."""
    return in_the_way(rng, lambda blocks: dream_task(rng, seed, blocks))


def in_the_way(rng: np.random.Generator, draw: Callable[[int], Task]) -> Task:
    """A task of so many blocks, which `draw` puts on the table, with b0 or b1 covered or moved into the box.

    More often the base: Insert fails on it, and mining, which stops at the first failed Pick, never shows that.
    """
    matters = BLOCK("b1" if rng.random() < 0.7 else "b0")
    if rng.random() < COVERED:
        return cover(draw(3), BLOCK("b2"), matters, rng)
    return in_a_corner(rng, draw(2), matters)


def in_a_corner(rng: np.random.Generator, task: Task, block: Object) -> Task:
    """The task with a block anywhere between deep in a corner of the box and its middle."""
    if rng.random() < 0.35:
        gaps = rng.uniform(0.0005, 0.006), rng.uniform(0.0005, 0.006)
    else:
        # Two thirds near both walls, where skills begin to fail; the rest along one wall.
        gaps = rng.uniform(0.001, 0.045), rng.uniform(0.001, 0.045 if rng.random() < 0.67 else 0.09)
    # Close to a wall a block cannot stand askew.
    angle = rng.uniform(-0.05, 0.05) if min(gaps) < 0.015 else rng.uniform(-np.pi / 4, np.pi / 4)
    relative = in_corner(min(gaps), max(gaps), float(angle))
    return replace(task, initial=moved(task.initial, block, THE_BOX, relative, rng, RELATIONS))


def cover(task: Task, upper: Object, lower: Object, rng: np.random.Generator) -> Task:
    """The task with `upper` seated on `lower`, off centre by what stud and socket leave it, as a hand leaves it."""
    heights = [task.initial.get(o, "size_z")[0] for o in (upper, lower)]
    world = spatial.pose_from_features(task.initial[lower][:7])
    slack = 0.8 * CLEARANCE
    offset = spatial.transform(
        spatial.rotation_about("z", rng.integers(4) * np.pi / 2),
        np.array([*rng.uniform(-slack, slack, 2), sum(heights) / 2 + 0.0003]),
    )
    values = dict(zip(BLOCK.features, spatial.features_from_pose(world @ offset), strict=False))
    return Task(task.objects, task.initial.with_features(upper, **values), task.goal, task.physics, task.seed)


TIGHT = 0.032
"""Gap to two walls, m, below which a person frees a block before touching it otherwise."""


def expert(state: State, goal: Atoms) -> tuple[tuple[str, tuple[Object, ...]], ...]:
    """The skill sequence a person gives: free what is tight and is needed, then build from below.

    What is in the hand is put down first, unless it can be inserted at once.
    """
    robot, box = state.of_type(ROBOT)[0], state.of_type(BOX)[0]
    beneath = {BLOCK(a.args[0].name): BLOCK(a.args[1].name) for a in goal if a.predicate == ON}

    def level(block: Object) -> int:
        found = 0
        while block in beneath and found < len(beneath):
            block, found = beneath[block], found + 1
        return found

    ordered = sorted(beneath.items(), key=lambda pair: (level(pair[0]), pair[0].name))
    # The base first: a block that was inserted on it stands in the way of nothing.
    needed = dict.fromkeys(o for upper, base in ordered for o in (base, upper))
    recovered = [b for b in needed if _is_tight(seen(state, b, box, RELATIONS))]
    steps: list[tuple[str, tuple[Object, ...]]] = [("Recover", (robot, b, box)) for b in recovered]
    for upper, base in ordered:
        steps += [("Pick", (robot, upper)), ("Insert", (robot, upper, base))]
    held = next((b for b in state.of_type(BLOCK) if holding(state, (robot, b))), None)
    if held is None:
        return tuple(steps)
    return tuple(steps[1:] if steps[:1] == [("Pick", (robot, held))] else [("Place", (robot, held)), *steps])


def _is_tight(relative: np.ndarray) -> bool:
    smaller, larger = relative[:2]
    return bool(smaller > -0.01 and larger < TIGHT)


def _scenario(
    name: str,
    description: str,
    goal: Sequence[tuple[str, str]],
    *layouts: Layout,
    training: bool = False,
    in_hand: str | None = None,
) -> Scenario:
    """Of several layouts each episode draws one; `in_hand` is the block that the robot holds when it begins."""
    atoms = frozenset(ON(BLOCK(a), BLOCK(b)) for a, b in goal)

    def sample(ranges: Ranges) -> Callable[[np.random.Generator, int], Task]:
        return lambda rng, seed: sample_task(rng, seed, atoms, layouts[int(rng.integers(len(layouts)))], ranges)

    return Scenario(
        name,
        description,
        lambda _domain: atoms,
        sample(USUAL),
        sample(PRACTICE),
        sample(UNSEEN),
        training,
        begins_after=() if in_hand is None else (("Pick", ("r", in_hand)),),
    )


SCENARIOS = (
    _scenario(
        "s0",
        "training: pick the cornered block, insert it onto a free one",
        [("b0", "b1")],
        Layout(cornered=("b0",), free=("b1",)),
        training=True,
    ),
    _scenario(
        "s1",
        "test: insert a free block onto the cornered one",
        [("b1", "b0")],
        Layout(cornered=("b0",), free=("b1",)),
    ),
    _scenario(
        "s2",
        "test: both blocks cornered, a free bystander",
        [("b0", "b1")],
        Layout(cornered=("b0", "b1"), free=("b2",)),
    ),
    _scenario(
        "s3",
        "test: a tower of three on the cornered block",
        [("b1", "b0"), ("b2", "b1")],
        Layout(cornered=("b0",), free=("b1", "b2")),
    ),
    _scenario(
        "s4",
        "test: four blocks, none cornered: no recovery is needed",
        [("b1", "b0")],
        Layout(free=("b0", "b1", "b2", "b3")),
    ),
    _scenario(
        "s5",
        "test: one block against a single wall, below or above; a cornered bystander",
        [("b1", "b0")],
        Layout(walled=("b0",), free=("b1",), cornered=("b2",)),
        Layout(walled=("b1",), free=("b0",), cornered=("b2",)),
    ),
    _scenario(
        "s6",
        "test: one block, below or above, 5 to 35 mm from both walls of a corner",
        [("b1", "b0")],
        Layout(gapped=("b0",), free=("b1",)),
        Layout(gapped=("b1",), free=("b0",)),
    ),
    _scenario(
        "s7",
        "test: insert the block in the hand onto the cornered one",
        [("b1", "b0")],
        Layout(cornered=("b0",), free=("b1",)),
        in_hand="b1",
    ),
)


def _on_device(
    tasks: Sequence[Task], block: Object, rig: Rig, count: int, device: str
) -> AbstractContextManager[ManiSkillScenes]:
    """Scenes of failures by the thousand."""
    from resync_robot.sim_training.domains.cornered_insertion_s.maniskill_env import ManiSkillScenes  # takes seconds

    return ManiSkillScenes(tasks, block, rig, count, device)


CORNERED_INSERTION_S = Domain(
    name="cornered-insertion-s",
    types=(ROBOT, BLOCK, BOX),
    predicates=(HAND_EMPTY, HOLDING, ON),
    classifiers={"HandEmpty": hand_empty, "Holding": holding, "On": on},
    operators=(PICK, INSERT, PLACE),
    stages=(Stage(recovery="Recover", scenario="s0", horizon=80, on_device=_on_device),),
    instruction="Drag the block out of the corner of the box.",
    free=free_task,
    dream=dream_task,
    practice=practice_task,
    expert=expert,
    stacking=(ON,),
    relations=RELATIONS,
    fixed=(BOX,),
    scenarios={s.name: s for s in SCENARIOS},
    # Figures were reported of these worlds; a new scenario needs no number.
    world_numbers={f"s{i}": i for i in range(8)},
)
