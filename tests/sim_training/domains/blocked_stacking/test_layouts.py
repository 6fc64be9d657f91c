"""Where things stand in Blocked Stacking."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from resync_robot.core.symbols import Type
from resync_robot.core.task import Task
from resync_robot.sim_training.domains.blocked_stacking.domain import BLOCKED_STACKING, OBSTRUCTED
from resync_robot.sim_training.domains.blocked_stacking.layouts import HOSTS, UNSEEN, USUAL, free
from resync_robot.sim_training.domains.blocked_stacking.vocabulary import (
    BLOCK,
    CRATE,
    OBSTRUCTIONS,
    SLAB,
    WALL,
)


def draw(name: str, seed: int, unseen: bool = False) -> Task:
    scenario = BLOCKED_STACKING.scenario(name)
    return (scenario.sample_unseen if unseen else scenario.sample)(np.random.default_rng(seed), seed)


@pytest.mark.parametrize("name", sorted(OBSTRUCTED, key=int))
def test_each_obstruction_stands_at_its_host(name: str) -> None:
    for seed in range(10):
        state = draw(name, seed).initial
        things = [o for o in state if o.type in OBSTRUCTIONS]
        assert {o.type for o in things} == set(OBSTRUCTED[name]) and len(things) == len(OBSTRUCTED[name])
        for thing in things:
            aside = state[thing][0] - state[HOSTS[OBSTRUCTED[name][thing.type]]][0]
            assert 0.14 < aside < 0.19 if thing.type == SLAB else -0.32 < aside < -0.22
        b0, b1 = state.of_type(BLOCK)
        assert abs(state[b0][0] - state[b1][0]) > 1.79


def test_the_sixteen_scenarios_are_the_papers() -> None:
    count = Counter((s.after_stage, s.training) for s in BLOCKED_STACKING.scenarios.values())
    assert count == {(1, True): 1, (1, False): 1, (2, True): 1, (2, False): 5, (3, True): 1, (3, False): 7}
    assert [s.scenario for s in BLOCKED_STACKING.stages] == ["0", "2", "8"]


def test_unseen_worlds_are_beyond_the_usual_ones() -> None:
    def inside(value: float, ends: tuple[float, float]) -> bool:
        return ends[0] <= value <= ends[1]

    for seed in range(20):
        for unseen, (sizes, others) in enumerate(((USUAL, UNSEEN), (UNSEEN, USUAL))):
            task = draw("8", seed, bool(unseen))
            state = task.initial
            assert inside(task.physics["friction"], sizes.friction)
            assert not inside(task.physics["friction"], others.friction)
            drawn = {
                BLOCK: (sizes.block, others.block, 3),
                SLAB: (sizes.slab[0], others.slab[0], 3),
                CRATE: (sizes.crate[1], others.crate[1], 4),
                WALL: (sizes.wall[0], others.wall[0], 3),
            }
            for kind, (ends, other_ends, column) in drawn.items():
                value = float(state[state.of_type(kind)[0]][column])
                assert inside(value, ends) and not inside(value, other_ends)


@pytest.mark.parametrize(
    "counts", [{}, {SLAB: 2, CRATE: 1}, {BLOCK: 3, CRATE: 1, WALL: 1}, {SLAB: 1, CRATE: 1, WALL: 2}]
)
def test_free_gives_what_is_asked_for_and_it_stands(counts: dict[Type, int]) -> None:
    assert BLOCKED_STACKING.embodiment is not None
    for seed in range(5):
        task = free(np.random.default_rng(seed), seed, counts)
        for kind in (BLOCK, *OBSTRUCTIONS):
            assert len(task.initial.of_type(kind)) == max(counts.get(kind, 0), 2 if kind == BLOCK else 0)
        assert BLOCKED_STACKING.embodiment.simulate(task).reset(task.initial)
