"""Every scenario of Cornered Insertion-L begins as it says, with room for what is to be done and all within reach."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.errors import TrainingError
from resync_robot.core.fittings import DRAWER as BUILT
from resync_robot.core.fittings import LID as PLATE
from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK
from resync_robot.policies.cartesian import Hand
from resync_robot.policies.fittings import in_a_way
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.domains.cornered_insertion_l.layouts import (
    AHEAD,
    THE_DRAWER,
    THE_LID,
    FurnishedLayout,
    sample_task,
)
from resync_robot.sim_training.domains.cornered_insertion_s.layouts import CORNER_GAP
from resync_robot.sim_training.physics.randomise import UNSEEN
from tests import scenes
from tests.scenes import B0, B2, THE_BOX

FURNISHED = find_domain("cornered-insertion-l")
RIG = load_rig()
seeds = st.integers(0, 2**31)
names = st.sampled_from(sorted(FURNISHED.scenarios))
IN_CORNERS = {**{name: {"b0"} for name in FURNISHED.scenarios}, "l2": {"b0", "b1"}}


def sample(name: str, seed: int) -> Task:
    return FURNISHED.scenario(name).sample(np.random.default_rng(seed), seed)


def reached(place: np.ndarray, yaw: float) -> bool:
    pose = spatial.transform(Hand.rotation(yaw), place)
    flange = spatial.inverse(RIG.arm.world_T_base) @ pose @ spatial.inverse(RIG.gripper.flange_T_tip)
    branch = RIG.arm.kinematics.branch_of(RIG.arm.home)
    with np.errstate(invalid="ignore"):
        return bool(np.isfinite(RIG.arm.kinematics.inverse_branch(flange, branch)).all())


def half_circle(state: State, block: object) -> float:
    return float(state.get(block, "size_x")[0] / np.sqrt(2))  # type: ignore[arg-type]


@settings(max_examples=60)
@given(names, seeds)
def test_blocks_are_cornered_where_the_scenario_says_and_apart(name: str, seed: int) -> None:
    state = sample(name, seed).initial
    gaps = {b.name: scenes.in_box(state, b) for b in state.of_type(BLOCK)}
    assert {n for n, g in gaps.items() if g[0] >= 0 and g[1] <= CORNER_GAP[1] + 1e-6} == IN_CORNERS[name]
    blocks = state.of_type(BLOCK)
    for i, a in enumerate(blocks):
        for b in blocks[i + 1 :]:
            apart = np.linalg.norm(state.get(a, "x", "y") - state.get(b, "x", "y"))
            assert apart > half_circle(state, a) + half_circle(state, b)


@settings(max_examples=60)
@given(names, seeds)
def test_lid_and_drawer_begin_where_the_scenario_says_and_touch_nothing(name: str, seed: int) -> None:
    state = sample(name, seed).initial
    box, lid = state[THE_BOX], state[THE_LID]
    assert state.get(THE_DRAWER, "opening")[0] == (BUILT.travel if name == "l3" else 0.0)
    edge = np.array([(x, y, 0.0) for x in (-1, 1) for y in (-1, 1)]) * np.array(PLATE.size) / 2
    corners = spatial.apply(spatial.pose_from_features(lid[:7]), edge)
    local = np.abs((corners[:, :2] - box[:2]) @ spatial.pose_from_features(box[:7])[:2, :2])
    if name == "l4":
        assert np.all(local.max(1) > box[7:9].max() / 2 + box[10]), "clear of the box"
        assert lid[2] == pytest.approx(PLATE.size[2] / 2 + 0.0005)
    else:
        assert np.all(local > box[7:9] / 2 + 0.001), "it rests on all four walls"
        assert lid[2] - PLATE.size[2] / 2 == pytest.approx(box[2] + box[9] + 0.0005)
    outer = box[7:9] / 2 + box[10]
    walls = spatial.apply(spatial.pose_from_features(box[:7]), edge * 0 + np.sign(edge) * [*outer, 0.0])
    assert not in_a_way(state, walls[:, :2], 0.005).any() and not in_a_way(state, corners[:, :2], 0.005).any()


@settings(max_examples=20)
@given(names, seeds)
def test_all_that_is_handled_is_within_reach_from_above(name: str, seed: int) -> None:
    state = sample(name, seed).initial
    over = np.array([0.0, 0.0, 0.30])
    places = [state[b][:3] for b in state.of_type(BLOCK)] + [state[THE_LID][:3]]
    front = spatial.pose_from_features(state[THE_DRAWER][:7])
    opening = float(state.get(THE_DRAWER, "opening")[0])
    half, bar = BUILT.front[0] / 2, BUILT.reach - BUILT.bar[0] / 2
    for ahead in (half + bar - opening, half + bar - opening + BUILT.travel, -half - opening + BUILT.travel / 2):
        places.append((front @ np.array([ahead, 0.0, 0.0, 1.0]))[:3])
    for place in places:
        for yaw in (0.0, np.pi / 2):
            assert reached(np.array([*place[:2], 0.02]), yaw) and reached(np.array([*place[:2], 0.0]) + over, yaw)


@settings(max_examples=40)
@given(names, seeds)
def test_nothing_but_what_is_said_stands_in_the_way_of_the_drawer(name: str, seed: int) -> None:
    state = sample(name, seed).initial
    way = {b.name for b in state.of_type(BLOCK) if in_a_way(state, state[b][None, :2], half_circle(state, b))[0]}
    assert way == ({"b2"} if name == "l6" else set())


def test_what_stands_in_the_way_is_wide_or_narrow_and_leaves_room_for_fingers_at_the_handle() -> None:
    widths = set()
    for seed in range(30):
        state = sample("l6", seed).initial
        widths.add(round(float(state.get(B2, "size_x")[0]), 3))
        front_T_block = spatial.inverse(spatial.pose_from_features(state[THE_DRAWER][:7])) @ np.append(state[B2][:3], 1)
        room = front_T_block[0] - BUILT.front[0] / 2 - BUILT.reach - half_circle(state, B2)
        assert AHEAD[0] - 1e-6 <= room <= AHEAD[1] + 1e-6
    assert min(widths) < 0.053 and max(widths) > 0.063 and not {w for w in widths if 0.053 < w < 0.063}


@given(names, seeds)
def test_a_task_depends_on_its_seed_alone(name: str, seed: int) -> None:
    first, again = sample(name, seed), sample(name, seed)
    assert (first.initial, first.physics, first.goal) == (again.initial, again.physics, again.goal)


def test_unseen_worlds_have_physics_of_lids_and_drawers_that_usual_ones_never_have() -> None:
    stictions = {"usual": set(), "unseen": set()}  # type: dict[str, set[float]]
    for seed in range(40):
        for worlds, found in stictions.items():
            rng, layout = np.random.default_rng(seed), FurnishedLayout(free=("b0", "b1"))
            task = sample_task(rng, seed, frozenset(), layout, *((UNSEEN,) if worlds == "unseen" else ()))
            found.add(task.physics["drawer"]["stiction"])
    usual, unseen = stictions["usual"], stictions["unseen"]
    assert min(usual) >= 1.5 and max(usual) <= 4.0
    assert all(s < 1.5 or s > 4.0 for s in unseen)


def test_of_the_same_seed_a_cornered_block_begins_in_the_same_corner_whatever_lid_and_drawer_are_like() -> None:
    for seed in range(5):
        one, other = (
            sample_task(np.random.default_rng(seed), seed, frozenset(), FurnishedLayout(cornered=("b0",), **given))
            for given in ({}, {"lid_on": False, "drawer_open": True})
        )
        np.testing.assert_array_equal(one.initial[B0], other.initial[B0])


def test_five_blocks_find_room_and_a_crowd_is_told_that_there_is_none() -> None:
    for seed in range(2):
        task = FURNISHED.free(np.random.default_rng(seed), seed, {BLOCK: 5})
        places = np.array([task.initial.get(b, "x", "y") for b in task.initial.of_type(BLOCK)])
        assert len(places) == 5 and min(np.hypot(*(a - b)) for a, b in combinations(places, 2)) > 0.11
    with pytest.raises(TrainingError, match="no room for 9 blocks"):
        FURNISHED.free(np.random.default_rng(0), 0, {BLOCK: 9})
