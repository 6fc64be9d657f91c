"""Pictures of Blocked Stacking."""

from __future__ import annotations

import numpy as np

from resync_robot.sim_training.domains.blocked_stacking.domain import BLOCKED_STACKING
from resync_robot.sim_training.domains.blocked_stacking.picture import COLOURS, HIT, SCALE
from resync_robot.sim_training.domains.blocked_stacking.simulator import Bench
from resync_robot.sim_training.domains.blocked_stacking.vocabulary import SLAB, WALL, WORLD
from tests.benchmarks.blocked_stacking import failures


def test_every_thing_is_where_the_state_has_it() -> None:
    task = BLOCKED_STACKING.scenario("8").sample(np.random.default_rng(0), 0)
    image = Bench(task).picture()
    for obj in task.initial:
        if obj.type in COLOURS:
            x, y, _, width, height = task.initial[obj][:5]
            # Beside its name.
            column, row = round((x + 0.3 * min(width, height)) * SCALE), round((WORLD[1] - y - 0.3 * height) * SCALE)
            if obj.type in (SLAB, WALL):
                column, row = round(x * SCALE), round((WORLD[1] - y) * SCALE)
            assert tuple(image[row, column]) == COLOURS[obj.type], obj


def test_what_is_run_into_has_a_red_edge() -> None:
    found = next(failures("0", range(9)))
    world = Bench(found.task)
    world.reset(found.state)
    assert not (world.picture() == HIT).all(-1).any()
    world.act(np.array([0.0, -0.05, 0.0, 0.0, 0.0]), 0.2)
    assert (world.picture() == HIT).all(-1).any()
