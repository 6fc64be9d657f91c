"""The physics of Blocked Stacking: what learning relies on, and what a person would expect."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from resync_robot.core.state import State
from resync_robot.core.task import Task
from resync_robot.sim_training.domains.blocked_stacking import simulator
from resync_robot.sim_training.domains.blocked_stacking.body import ARM, GAP, LIMITS, Configuration
from resync_robot.sim_training.domains.blocked_stacking.domain import BLOCKED_STACKING
from resync_robot.sim_training.domains.blocked_stacking.layouts import BASE, TOP, Layout
from resync_robot.sim_training.domains.blocked_stacking.layouts import ROBOT_NAME as R
from resync_robot.sim_training.domains.blocked_stacking.simulator import Bench
from resync_robot.sim_training.domains.blocked_stacking.vocabulary import BENCH, CRATE, DOWN, SLAB, WALL

AGO = 0.2
"""s of an action."""
OBSTRUCTION = {"0": SLAB("slab"), "2": CRATE("crate"), "8": WALL("wall")}


def task_of(name: str, seed: int = 0) -> Task:
    return BLOCKED_STACKING.scenario(name).sample(np.random.default_rng(seed), seed)


def over(state: State, above: float, aside: float = 0.0, arm: float = ARM[0], gap: float = GAP[1]) -> State:
    """With a hand that points down to the block to be grasped, its tips so far above the block's top."""
    x, y, side = state.get(TOP, "x", "y", "height")
    at = Configuration(x + aside, y + side / 2 + above + arm + 0.2, DOWN, arm, gap)
    return State({**{o: state[o] for o in state}, R: at.features()})


def world_over(name: str = "", above: float = 0.1, **how: float) -> Bench:
    task = task_of(name) if name else Layout().draw(np.random.default_rng(0), 0)
    world = Bench(task)
    assert world.reset(over(task.initial, above, **how))
    return world


def act(world: Bench, count: int = 1, **change: float) -> State:
    for _ in range(count):
        world.act(np.array([change.get(name, 0.0) for name in LIMITS]), AGO)
    return world.perceive()


def same(a: State, b: State) -> bool:
    return all((a[o] == b[o]).all() for o in a)


@pytest.mark.parametrize("name", ["0", "2", "8"])
def test_the_same_actions_from_the_same_snapshot_lead_to_exactly_the_same_state(name: str) -> None:
    world, rng = world_over(name, above=0.26), np.random.default_rng(1)
    while not world.contacts():
        act(world, dy=-0.05)
    most = np.array(list(LIMITS.values()))
    for _ in range(10):
        actions = rng.uniform(-most, most, (6, 5)) - [0.0, 0.02, 0.0, 0.0, 0.0]
        kept, ends = world.save(), []
        for _ in range(2):
            world.restore(kept)
            for action in actions:
                world.act(action, AGO)
            ends.append((world.perceive(), world.contacts(), world.observe().time))
        assert same(ends[0][0], ends[1][0]) and ends[0][1:] == ends[1][1:]
        world.restore(kept)
        act(world, 2, darm=0.1, dx=float(rng.uniform(-0.05, 0.05)))


def test_a_snapshot_has_what_is_fixed_too() -> None:
    world, slab = world_over("0"), SLAB("slab")
    kept, before = world.save(), world.perceive()
    assert world.reset(before.with_features(slab, x=before[slab][0] + 0.3))
    world.restore(kept)
    assert same(world.perceive(), before) and world.perceive()[slab][0] == before[slab][0]
    act(world, 6, dy=-0.05)
    assert set(world.contacts()) == {slab}


def test_what_cannot_touch_anything_needs_no_physics(monkeypatch: pytest.MonkeyPatch) -> None:
    """And with physics it would move in the same way."""
    made: list[Any] = []
    whole, action = range(4), simulator.Action
    monkeypatch.setattr(simulator, "Action", lambda *args: made.append(args) or action(*args))
    world, other = world_over("8", above=0.3), world_over("8", above=0.3)
    made.clear()
    change = {"dx": 0.03, "dy": 0.02, "dtheta": 0.1, "darm": 0.01, "dgap": -0.02}
    moved = act(world, 3, **change)
    assert not made
    monkeypatch.setattr(other, "_may_touch", lambda step: tuple(whole))
    checked = act(other, 3, **change)
    assert len(made) == 3
    assert all(np.abs(moved[o] - checked[o]).max() < 1e-3 for o in moved)


@pytest.mark.parametrize("name", ["0", "2", "8"])
def test_what_is_in_the_way_holds_the_hand_up_and_is_named(name: str) -> None:
    world = world_over(name, above=0.28)
    obstruction = OBSTRUCTION[name]
    before = world.perceive()
    for _ in range(9):
        state = act(world, dy=-0.05)
        if world.contacts():
            break
    assert set(world.contacts()) == {obstruction} and world.observe().run_into
    state = act(world, 5, dy=-0.05)
    assert state[R][1] - before[R][1] > -0.28
    # Nothing is squeezed.
    np.testing.assert_allclose(state[obstruction], before[obstruction], atol=0.01)
    act(world, 2, dy=0.05)
    assert not world.contacts() and not world.observe().run_into


def test_a_crate_is_pushed_and_a_wall_is_not() -> None:
    world = world_over("6", above=0.12, aside=0.09)
    before = world.perceive()
    after = act(world, 5, dx=-0.05)
    assert after[CRATE("crate")][0] - before[CRATE("crate")][0] < -0.12
    assert abs(after[CRATE("crate")][2]) < 0.02
    world = world_over("14", above=0.02, aside=0.15)
    before = world.perceive()
    after = act(world, 6, dx=-0.05)
    assert same(State({WALL("wall"): before[WALL("wall")]}), State({WALL("wall"): after[WALL("wall")]}))
    assert after[R][0] - before[R][0] > -0.25


def test_a_block_that_is_pressed_is_dragged_and_not_squeezed() -> None:
    # One finger over the block, the other beside it.
    world = world_over(above=0.05, aside=-0.13)
    before = world.perceive()
    act(world, 4, dy=-0.05)
    pressed = world.perceive()
    assert abs(pressed[TOP][1] - before[TOP][1]) < 0.003 and abs(pressed[TOP][0] - before[TOP][0]) < 0.02
    dragged = act(world, 4, dy=-0.05, dx=-0.05)
    assert dragged[TOP][0] - pressed[TOP][0] < -0.08 and abs(dragged[TOP][2]) < 0.02
    assert not world.contacts(), "a block is no obstruction"


def test_a_block_is_grasped_carried_and_let_go() -> None:
    world = world_over(above=-0.1)
    closing = act(world, 6, dgap=-0.02)
    assert closing[TOP][-1] == 1.0
    lifted = act(world, 6, dy=0.05)
    assert math.isclose(lifted[TOP][1] - closing[TOP][1], 0.3, abs_tol=1e-6)
    tilted = act(world, 2, dtheta=0.15)
    assert abs(tilted[TOP][2] - lifted[TOP][2]) > 0.25
    # What is held can be a world to begin with, and its gripper cannot close further.
    other = Bench(Layout().draw(np.random.default_rng(0), 0))
    assert other.reset(lifted) and other.perceive()[TOP][-1] == 1.0
    assert act(other, 2, dgap=-0.02)[R][4] == lifted[R][4]
    fallen = act(world, 1, dgap=0.02)
    assert fallen[TOP][-1] == 0.0
    fallen = act(world, 12)
    assert abs(fallen[TOP][1] - closing[TOP][1]) < 0.003 and abs(fallen[TOP][2]) < 0.02


def test_the_least_opening_lets_go() -> None:
    """A hand that took hold of a block with one finger at once has hardly anything left to open."""
    world = world_over(above=-0.1)
    assert act(world, 6, dgap=-0.02)[TOP][-1] == 1.0
    assert act(world, 1, dgap=0.0005)[TOP][-1] == 0.0


def test_a_hand_that_does_not_reach_down_to_a_block_grasps_nothing() -> None:
    world = world_over(above=-0.02)
    assert act(world, 8, dgap=-0.02)[TOP][-1] == 0.0


def test_what_is_held_runs_into_things() -> None:
    world = world_over("1", above=-0.1)
    state = act(world, 6, dgap=-0.02)
    act(world, 12, dy=0.05)
    way = state[BASE][0] - state[TOP][0]
    act(world, round(abs(way) / 0.05), dx=math.copysign(0.05, way))
    act(world, 10, dy=-0.05)
    assert set(world.contacts()) == {SLAB("slab")}


def test_scenes_that_cannot_be_are_refused() -> None:
    world = world_over("8")
    good = world.perceive()
    crate, wall = CRATE("crate"), WALL("wall")
    wrong = {
        "in mid-air": good.with_features(TOP, y=good[TOP][1] + 0.05),
        "in mid-air, far from the robot": good.with_features(BASE, y=good[BASE][1] + 0.05),
        "in the bench": good.with_features(TOP, y=good[TOP][1] - 0.05),
        "in each other": good.with_features(BASE, x=good[crate][0] + 0.1),
        "in the robot": good.with_features(R, y=good[R][1] - 0.2),
        "beyond the end": good.with_features(BASE, x=0.02),
        "tilting": good.with_features(crate, theta=0.3, y=good[crate][1] + 0.05),
        "held from afar": good.with_features(BASE, held=1.0),
        "held twice": good.with_features(BASE, held=1.0).with_features(TOP, held=1.0),
        "the robot in the bench": good.with_features(R, y=BENCH + 0.05, x=2.5),
    }
    assert world.reset(good)
    assert [name for name, state in wrong.items() if world.reset(state)] == []
    assert world.reset(good.with_features(wall, x=good[TOP][0] + 0.8)), "a fixed thing stands anywhere"


def test_a_tower_stands() -> None:
    world = world_over()
    state = world.perceive()
    side = state[BASE][4]
    tower = state.with_features(TOP, x=state[BASE][0] + 0.02, y=BENCH + 1.5 * side)
    assert world.reset(tower)
    assert abs(act(world, 5)[TOP][1] - tower[TOP][1]) < 0.003


def test_a_block_looks_the_same_on_each_of_its_sides() -> None:
    world = world_over()
    state = world.perceive()
    assert world.reset(state.with_features(TOP, theta=math.pi / 2))
    assert abs(world.perceive()[TOP][2]) < 1e-3
