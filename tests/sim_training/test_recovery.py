"""The recovery MDP: what counts as recovered, rewards that telescope, starts within their limits."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from resync_robot.core import spatial
from resync_robot.learning.recovery_policy import BLOCK, BOX, COMMANDED, STUD, TIP, tip_above_stud, wall_gaps
from resync_robot.sim_training.recovery import (
    RecoverySettings,
    draw_starts,
    draw_still,
    is_free,
    is_recovered,
    is_tipped,
    lagging,
    potential,
    reward,
)
from tests import scenes
from tests.scenes import CORNER

S = RecoverySettings()
TOP = scenes.FLOOR + scenes.HEIGHT + STUD


def state(x: float, y: float, lean: float = 0.0, lifted: float = 0.0, above: float = 0.1) -> Tensor:
    """(1, 27) a block at (x, y) in the box, leaning, lifted off the floor, the tip `above` its stud."""
    box = scenes.box_features(0.1)
    block = scenes.block_features(x, y, box=box)
    pose = spatial.pose_from_features(block[:7])
    pose[:3, :3] = pose[:3, :3] @ spatial.rotation_about("x", lean)
    block[:7] = spatial.features_from_pose(pose)
    block[2] = scenes.FLOOR + scenes.HEIGHT / 2 + lifted
    tip = block[:3] + [0, 0, scenes.HEIGHT / 2 + STUD + above]
    return torch.as_tensor(np.concatenate([tip, tip, block, box]), dtype=torch.float64)[None]


@pytest.mark.parametrize(
    ("place", "free"),
    [
        ({"x": 0.0, "y": 0.0}, True),
        ({"x": CORNER, "y": CORNER}, False),
        ({"x": CORNER, "y": 0.0}, False),
        ({"x": 0.0, "y": 0.0, "lean": 0.3}, False),
        ({"x": 0.0, "y": 0.0, "lifted": 0.02}, False),
    ],
)
def test_free_is_upright_on_the_floor_with_room_to_both_walls(place: dict[str, float], free: bool) -> None:
    assert bool(is_free(state(**place), S)) is free


def test_recovered_is_free_at_rest_with_the_hand_away() -> None:
    here, near = state(0.0, 0.0), state(0.0, 0.0, above=0.01)
    moving = state(0.005, 0.0)
    assert bool(is_recovered(here, here, S))
    assert not bool(is_recovered(near, near, S))
    assert not bool(is_recovered(here, moving, S))
    assert not bool(is_recovered(state(CORNER, CORNER), state(CORNER, CORNER), S))


def test_tipped_is_leaning_too_far() -> None:
    assert not bool(is_tipped(state(0, 0, lean=0.2), S))
    assert bool(is_tipped(state(0, 0, lean=0.6), S))


def test_success_pays_and_tipping_costs_and_ends() -> None:
    here = state(0.0, 0.0)
    gained, success, failed = reward(here, here, 1.0, S)
    assert bool(success) and not bool(failed)
    assert float(gained) == pytest.approx(S.success_reward - S.step_cost)
    fallen = state(0.0, 0.0, lean=0.8)
    gained, success, failed = reward(fallen, fallen, 1.0, S)
    assert not bool(success) and bool(failed)
    assert float(gained) == pytest.approx(-S.tipping_cost - S.step_cost)


walk = st.lists(
    st.tuples(
        st.floats(-0.11, 0.11), st.floats(-0.11, 0.11), st.floats(-0.6, 0.6), st.floats(0, 0.03), st.floats(0, 0.1)
    ),
    min_size=2,
    max_size=12,
)


@settings(max_examples=20)
@given(walk, st.floats(0.9, 1.0))
def test_shaping_telescopes_so_that_no_detour_pays(path: list[tuple[float, ...]], gamma: float) -> None:
    """Discounted, all that shaping ever gives is gamma^T potential(end) - potential(begin)."""
    states = [state(*step) for step in path]
    total = 0.0
    for t, (before, after) in enumerate(itertools.pairwise(states)):
        gained, success, _ = reward(after, before, gamma, S)
        shaped = gained - S.success_reward * success + S.step_cost + S.tipping_cost * is_tipped(after, S)
        total += gamma**t * float(shaped)
    steps = len(states) - 1
    expected = gamma**steps * float(potential(states[-1], S)) - float(potential(states[0], S))
    assert total == pytest.approx(expected, abs=1e-6)


def test_the_potential_rises_on_the_way_to_recovery() -> None:
    way = [
        state(CORNER, CORNER, above=0.08),
        state(CORNER, CORNER, above=0.001),
        state(0.10, 0.10, above=0.001),
        state(0.075, 0.075, above=0.001),
        state(0.07, 0.07, above=0.001),
        state(0.07, 0.07, above=0.06),
    ]
    values = [float(potential(x, S)) for x in way]
    assert values == sorted(values) and values[-1] > values[0] + 1


def failures(count: int) -> Tensor:
    corners = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    return torch.cat([state(*(CORNER * np.array(corners[i % 4]))) for i in range(count)]).float()


def test_starts_are_near_contact_near_the_goal_and_at_the_failure() -> None:
    x = failures(2000)
    block, tip = draw_starts(x, torch.Generator().manual_seed(0))
    begun = x.clone()
    begun[:, BLOCK.start : BLOCK.start + 2] = block
    begun[:, TIP] = begun[:, COMMANDED] = tip
    gaps = wall_gaps(begun)
    assert gaps.min() > 0 and gaps.max() < 0.05, "in the box, towards its middle"
    above = tip_above_stud(begun)
    assert above.min() > 0.0005 and above.max() < 0.085
    assert (tip[:, :2] - block).abs().max() <= 0.02 + 1e-6
    at_failure = (block - x[:, BLOCK][:, :2]).norm(dim=-1) < 1e-6
    near_goal = gaps.min(-1).values > 0.028
    assert 0.55 < at_failure.float().mean() < 0.65
    assert 0.10 < near_goal.float().mean() < 0.30
    # Still in the corner that it failed in.
    centre = x[:, BOX][:, :2]
    assert ((block - centre) * (x[:, BLOCK][:, :2] - centre) > 0).all(-1).float().mean() > 0.99


def test_still_states_lie_between_the_corner_and_the_middle_with_the_hand_over_the_block() -> None:
    x = failures(2000)
    still = draw_still(x, torch.Generator().manual_seed(0))
    gaps = wall_gaps(still).min(-1).values
    assert gaps.min() >= 0 and 0.2 < (gaps > S.gap).float().mean() < 0.8, "some are free, some are not"
    assert tip_above_stud(still).min() >= 0 and 0.08 < tip_above_stud(still).max() <= 0.1 + 1e-6
    assert torch.equal(still[:, TIP], still[:, COMMANDED])
    assert (still[:, TIP][:, :2] - still[:, BLOCK][:, :2]).abs().max() <= 0.03 + 1e-6
    assert torch.equal(still[:, BOX], x[:, BOX])
    expected = (gaps > S.gap) & (tip_above_stud(still) > S.lift)
    assert torch.equal(is_recovered(still, still, S), expected)


def test_starts_depend_on_the_generator_alone() -> None:
    x = failures(16)
    first, again, other = (draw_starts(x, torch.Generator().manual_seed(s)) for s in (3, 3, 4))
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert not torch.equal(first[1], other[1])


@given(st.floats(0, 1), st.lists(st.floats(-1, 1), min_size=6, max_size=6))
def test_a_late_arm_is_that_share_of_the_last_ramp_behind(lag: float, ends: list[float]) -> None:
    before, command = torch.tensor(ends).reshape(2, 1, 3)
    sent = lagging(command, before, torch.tensor([lag]))
    assert float((command - sent).norm()) == pytest.approx(lag * float((command - before).norm()), abs=1e-5)
    assert float((sent - before).norm()) == pytest.approx((1 - lag) * float((command - before).norm()), abs=1e-5)
