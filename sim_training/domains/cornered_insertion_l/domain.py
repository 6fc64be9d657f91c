"""Cornered Insertion-L: take the lid off a box, build a tower of studded blocks, and put it away in a drawer.

Some blocks begin trapped in a corner of the box. As in Cornered Insertion-S they can neither be picked nor inserted
upon, and the given model does not know.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

import numpy as np

from resync_robot.core.embodiment import Stage
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Atoms, Object, Type
from resync_robot.core.task import Domain, Scenario, Task
from resync_robot.core.vocabulary import BLOCK, BOX, DRAWER, LID, ROBOT
from resync_robot.sim_training.domains.cornered_insertion_l.layouts import THE_DRAWER, FurnishedLayout, sample_task
from resync_robot.sim_training.domains.cornered_insertion_l.vocabulary import (
    CLASSIFIERS,
    DRAWER_CLOSED,
    IN,
    ON,
    OPERATORS,
    PREDICATES,
    drawer_closed,
    drawer_open,
    in_drawer,
    lid_on,
)
from resync_robot.sim_training.domains.cornered_insertion_s import domain as small
from resync_robot.sim_training.domains.cornered_insertion_s.corner import RELATIONS
from resync_robot.sim_training.physics.randomise import PRACTICE, UNSEEN, USUAL, Ranges

WIDE, NARROW = (0.064, 0.070), (0.046, 0.052)
"""Widths of the blocks, m, where one stands in a drawer's way: a narrow one is easily toppled."""


def tower(*names: str) -> Atoms:
    """The goal: blocks on each other in a closed drawer, the uppermost first."""
    seated = {ON(BLOCK(a), BLOCK(b)) for a, b in pairwise(names)}
    return frozenset({*seated, IN(BLOCK(names[-1]), THE_DRAWER), DRAWER_CLOSED(THE_DRAWER)})


LID_ON_SHARE, OPEN_SHARE = 0.5, 0.25
"""Of the tasks that dreams begin with: what a skill needs of lid and drawer shows only where both are so and so."""


def free_task(rng: np.random.Generator, seed: int, counts: Mapping[Type, int]) -> Task:
    """Every block with room on all sides, in the box or on the table; the lid on or off, the drawer closed or open."""
    names = tuple(f"b{i}" for i in range(max(counts.get(BLOCK, 2), 2)))
    lid, opened = rng.random() < LID_ON_SHARE, rng.random() < OPEN_SHARE
    layout = FurnishedLayout(free=names, lid_on=lid, drawer_open=opened)
    return sample_task(rng, seed, tower("b0", "b1"), layout, PRACTICE)


BUILT = 0.2
"""Share of practice with the tower built: where its base is in the way Insert fails, and PickTower is never tried."""


def practice_task(rng: np.random.Generator, seed: int) -> Task:
    """The tower of b0 on b1, one of them in the way as in Cornered Insertion-S, or the built tower; the lid off and the
    drawer open, which stand in nobody's way and would take half of an attempt."""

    def draw(blocks: int) -> Task:
        free = tuple(f"b{i}" for i in range(blocks))
        layout = FurnishedLayout(free=free, in_box=0.0, lid_on=False, drawer_open=True)
        return sample_task(rng, seed, tower("b0", "b1"), layout, PRACTICE)

    if rng.random() < BUILT:
        base = small.in_a_corner(rng, draw(2), BLOCK("b1"))
        return small.cover(base, BLOCK("b0"), BLOCK("b1"), rng)
    return small.in_the_way(rng, draw)


def expert(state: State, goal: Atoms) -> tuple[tuple[str, tuple[Object, ...]], ...]:
    """The skill sequence that a person gives: uncover the box, build as in Cornered Insertion-S, then put it away."""
    robot = state.of_type(ROBOT)[0]
    steps: list[tuple[str, tuple[Object, ...]]] = []
    steps += [("RemoveLid", (robot, lid)) for lid in state.of_type(LID) if lid_on(state, (lid,))]
    missing = frozenset(a for a in goal if a.predicate == ON and not small.on(state, _objects(a)))
    steps += small.expert(state, missing)
    above = {_objects(a)[1]: _objects(a)[0] for a in goal if a.predicate == ON}
    for base, drawer in sorted(_objects(a) for a in goal if a.predicate == IN):
        if in_drawer(state, (base, drawer)):
            continue
        if not drawer_open(state, (drawer,)):
            steps.append(("OpenDrawer", (robot, drawer)))
        of = (robot, above[base], base)
        steps += [("PickTower", of), ("PlaceTower", (*of, drawer))]
    for (drawer,) in (_objects(a) for a in goal if a.predicate == DRAWER_CLOSED):
        if steps or not drawer_closed(state, (drawer,)):
            steps.append(("CloseDrawer", (robot, drawer)))
    return tuple(steps)


def _objects(atom: Atom) -> tuple[Object, ...]:
    return tuple(term for term in atom.args if isinstance(term, Object))


def _scenario(
    name: str, description: str, goal: Sequence[str], *layouts: FurnishedLayout, training: bool = False
) -> Scenario:
    """Of several layouts each episode draws one; `goal` is the tower that ends in the drawer, from above."""
    atoms = tower(*goal)

    def sample(ranges: Ranges) -> Callable[[np.random.Generator, int], Task]:
        return lambda rng, seed: sample_task(rng, seed, atoms, layouts[int(rng.integers(len(layouts)))], ranges)

    return Scenario(name, description, lambda _domain: atoms, sample(USUAL), sample(PRACTICE), sample(UNSEEN), training)


SCENARIOS = (
    _scenario(
        "l0",
        "training: the lid on, the drawer closed; a tower of the cornered block on a free one into the drawer",
        ("b0", "b1"),
        FurnishedLayout(cornered=("b0",), free=("b1",)),
        training=True,
    ),
    _scenario(
        "l1",
        "test: the tower the other way round, the cornered block below",
        ("b1", "b0"),
        FurnishedLayout(cornered=("b0",), free=("b1",)),
    ),
    _scenario(
        "l2",
        "test: both blocks cornered",
        ("b0", "b1"),
        FurnishedLayout(cornered=("b0", "b1")),
    ),
    _scenario(
        "l3",
        "test: the drawer is open already",
        ("b0", "b1"),
        FurnishedLayout(cornered=("b0",), free=("b1",), drawer_open=True),
    ),
    _scenario(
        "l4",
        "test: the lid is off already",
        ("b0", "b1"),
        FurnishedLayout(cornered=("b0",), free=("b1",), lid_on=False),
    ),
    _scenario(
        "l5",
        "test: a tower of three on the cornered block",
        ("b2", "b1", "b0"),
        FurnishedLayout(cornered=("b0",), free=("b1", "b2")),
    ),
    _scenario(
        "l6",
        "test: a wide or a narrow block stands in the way of the drawer",
        ("b0", "b1"),
        FurnishedLayout(cornered=("b0",), free=("b1",), in_the_way=("b2",), widths=WIDE),
        FurnishedLayout(cornered=("b0",), free=("b1",), in_the_way=("b2",), widths=NARROW),
    ),
)

CORNERED_INSERTION_L = Domain(
    name="cornered-insertion-l",
    types=(ROBOT, BLOCK, BOX, LID, DRAWER),
    predicates=PREDICATES,
    classifiers=CLASSIFIERS,
    operators=OPERATORS,
    stages=(Stage(recovery="Recover", scenario="l0", horizon=80),),
    instruction=small.CORNERED_INSERTION_S.instruction,
    free=free_task,
    practice=practice_task,
    expert=expert,
    stacking=(ON,),
    relations=RELATIONS,
    fixed=(BOX, DRAWER),
    scenarios={s.name: s for s in SCENARIOS},
)
