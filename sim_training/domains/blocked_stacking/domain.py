"""Blocked Stacking: a robot puts one block upon another, in a vertical plane, and something is in the way.

The paper's domain (appendix D), re-made. Three things can be in the way of a block, each the lesson of one stage: a
small fixed slab over its edge, a large crate beside it, a thin wall that leans over it. From under slab and wall a
block can be dragged, and a crate can be pushed aside; the given skills do neither.

Where the paper's own code has quirks, this does what a person would expect: the bench holds the robot up, what is
pressed presses back with a bounded force, a hand is ready to grasp only where it points down, and a block that was let
go can be grasped again.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from resync_robot.core.embodiment import Embodiment, Stage
from resync_robot.core.symbols import Type
from resync_robot.core.task import Domain, Scenario, Task
from resync_robot.sim_training.domains.blocked_stacking.body import LIMITS
from resync_robot.sim_training.domains.blocked_stacking.layouts import GOAL, UNSEEN, Layout, free
from resync_robot.sim_training.domains.blocked_stacking.skills import RATE_HZ, skills
from resync_robot.sim_training.domains.blocked_stacking.vocabulary import (
    CLASSIFIERS,
    CRATE,
    ON,
    OPERATORS,
    PREDICATES,
    SLAB,
    TYPES,
    WALL,
)

if TYPE_CHECKING:
    from resync_robot.sim_training.domains.blocked_stacking.simulator import Bench


def _simulate(task: Task) -> Bench:
    # Whoever only asks what the domain is need not wait for pymunk and OpenCV.
    from resync_robot.sim_training.domains.blocked_stacking.simulator import Bench

    return Bench(task)


TRAINING = {"0": 1, "2": 2, "8": 3}
"""Scenario -> the stage that learns from it."""
OBSTRUCTED: dict[str, dict[Type, str]] = {
    "0": {SLAB: "grasp"},
    "1": {SLAB: "place"},
    "2": {SLAB: "grasp", CRATE: "grasp"},
    "3": {SLAB: "place", CRATE: "place"},
    "4": {SLAB: "place", CRATE: "grasp"},
    "5": {SLAB: "grasp", CRATE: "place"},
    "6": {CRATE: "grasp"},
    "7": {CRATE: "place"},
    "8": {SLAB: "place", CRATE: "place", WALL: "grasp"},
    "9": {SLAB: "grasp", CRATE: "grasp", WALL: "place"},
    "10": {SLAB: "place", WALL: "grasp"},
    "11": {SLAB: "grasp", WALL: "place"},
    "12": {CRATE: "place", WALL: "grasp"},
    "13": {CRATE: "grasp", WALL: "place"},
    "14": {WALL: "grasp"},
    "15": {WALL: "place"},
}
"""What is in the way of the block to be grasped, and of the one to be placed upon. The paper's text has 8 and 9 the
other way round, but only so is it the wall, in 8, on which the skill fails that the paper names."""


def _scenario(name: str, obstructed: dict[Type, str]) -> Scenario:
    layout = Layout(obstructed)
    words = {"grasp": "the block to be grasped", "place": "the block to be placed upon"}
    beside = {
        where: " and ".join(f"a {kind.name}" for kind, host in obstructed.items() if host == where) for where in words
    }
    what = ", ".join(f"{things} at {words[where]}" for where, things in beside.items() if things)
    return Scenario(
        name,
        f"{'training' if name in TRAINING else 'test'}: {what}",
        lambda _domain: GOAL,
        layout.draw,
        sample_unseen=partial(layout.draw, sizes=UNSEEN),
        training=name in TRAINING,
        after_stage=max((SLAB, CRATE, WALL).index(kind) + 1 for kind in obstructed),
    )


BLOCKED_STACKING = Domain(
    name="blocked-stacking",
    types=TYPES,
    predicates=PREDICATES,
    classifiers=CLASSIFIERS,
    operators=OPERATORS,
    instruction="Free the block from what is in the way of the fingers.",
    scenarios={name: _scenario(name, obstructed) for name, obstructed in OBSTRUCTED.items()},
    stages=(
        Stage(recovery="Punch", scenario="0", horizon=10),
        Stage(recovery="Wiggle", scenario="2", horizon=10),
        Stage(recovery="Fiddle", scenario="8", horizon=10),
    ),
    embodiment=Embodiment(
        actions={name: (-most, most) for name, most in LIMITS.items()},
        rate_hz=RATE_HZ,
        simulate=_simulate,
        skills=skills,
    ),
    free=free,
    stacking=(ON,),
)
