"""What the recovery policy sees is the same in all four corners, and what it does turns with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st
from torch import Tensor

from resync_robot.core import spatial
from resync_robot.core.errors import LibraryError
from resync_robot.core.library import Record
from resync_robot.core.state import State
from resync_robot.learning.recovery_policy import (
    BLOCK,
    BOX,
    COMMANDED,
    LEASH,
    LOWEST_TIP,
    OBSERVATION_SIZE,
    PROJECTED_SIZE,
    STEP,
    TIP,
    ActorCritic,
    block_yaw,
    commanded_tip,
    mirror,
    observe,
    project,
    tip_above_stud,
    up_axis,
    wall_gaps,
)
from resync_robot.sim_training.domains.cornered_insertion_s.corner import CORNER
from tests import scenes

coordinate = st.floats(0.005, 0.11)
angle = st.floats(-np.pi, np.pi)
action = st.tuples(*[st.floats(-3, 3)] * 3)
signs = st.sampled_from([(1, 1), (1, -1), (-1, 1), (-1, -1)])


@st.composite
def situations(draw: st.DrawFn) -> dict[str, object]:
    """Where things are in the frame of a box: block (x, y, yaw, lean), tip and commanded tip."""
    tip = np.array([draw(st.floats(-0.12, 0.12)), draw(st.floats(-0.12, 0.12)), draw(st.floats(0.03, 0.2))])
    lead = np.array([draw(st.floats(-0.015, 0.015)) for _ in range(3)])
    return {
        "block": (draw(coordinate), draw(coordinate)),
        "yaw": draw(angle),
        "lean": draw(st.floats(-0.3, 0.3)),
        "inner": (draw(st.floats(0.28, 0.32)), draw(st.floats(0.28, 0.32))),
        "tip": tip,
        "commanded": tip + lead,
    }


def projected(s: dict[str, object], flip: tuple[int, int] = (1, 1), box_yaw: float = 0.0) -> Tensor:
    """(1, 27) the situation mirrored at the box's axes (its block leaning about its own x), in a box at `box_yaw`."""
    box = scenes.box_features(box_yaw, s["inner"])
    world_T_box = spatial.pose_from_features(box[:7])
    flip_T = np.diag([*flip, 1])
    rotation = flip_T @ spatial.rotation_about("z", s["yaw"]) @ spatial.rotation_about("x", s["lean"])
    if np.linalg.det(rotation) < 0:
        rotation = rotation @ np.diag([1, -1, 1])  # a block is its own mirror image
    place = flip_T @ np.array([*s["block"], scenes.HEIGHT / 2])
    block = spatial.features_from_pose(world_T_box @ spatial.transform(rotation, place))
    tips = [spatial.apply(world_T_box, (flip_T @ s[k])[None])[0] for k in ("tip", "commanded")]
    row = np.concatenate([*tips, block, [scenes.WIDTH, scenes.WIDTH, scenes.HEIGHT], box])
    return torch.as_tensor(row, dtype=torch.float64)[None]


@given(situations(), signs, angle)
def test_the_policy_sees_a_corner_as_the_relation_of_its_domain_does(
    s: dict[str, object], flip: tuple[int, int], box_yaw: float
) -> None:
    """Its columns are those that the shipped networks were trained on, in torch; the geometry is the same."""
    x = projected(s, flip, box_yaw)
    gaps, (smaller, larger, *heading) = wall_gaps(x)[0].numpy(), CORNER.see(x[:, BLOCK].numpy(), x[:, BOX].numpy())[0]
    np.testing.assert_allclose(np.sort(gaps), [smaller, larger], atol=1e-6)
    assume(abs(gaps[0] - gaps[1]) > 1e-6)
    # The relation also sorts the axes, which turns a heading round.
    turn = 1 if gaps[0] < gaps[1] else -1
    np.testing.assert_allclose(observe(x)[0, 10:12].numpy() * [1, turn], heading, atol=1e-6)


@given(situations(), signs, angle)
def test_all_four_corners_look_the_same_wherever_the_box_stands(s: dict, flip: tuple[int, int], box_yaw: float) -> None:
    torch.testing.assert_close(observe(projected(s, flip, box_yaw)), observe(projected(s)), atol=2e-5, rtol=1e-5)


@given(situations(), signs, angle, action)
def test_commands_turn_with_the_box_and_the_corner(
    s: dict, flip: tuple[int, int], box_yaw: float, a: tuple[float, ...]
) -> None:
    def sent(x: Tensor) -> np.ndarray:
        """The command in the frame of the box."""
        world_T_box = spatial.pose_from_features(x[0, BOX][:7].numpy())
        return spatial.apply(spatial.inverse(world_T_box), commanded_tip(x, torch.tensor([a]).double()).numpy())[0]

    here, there = sent(projected(s)), sent(projected(s, flip, box_yaw))
    # The leash is a box along the world's axes, so a turned command may be cut elsewhere; within it, nothing differs.
    if np.abs(s["commanded"] - s["tip"])[:2].max() + STEP * np.sqrt(2) < LEASH + STEP and box_yaw != 0:
        np.testing.assert_allclose(there, here * [*flip, 1], atol=1e-6)
    np.testing.assert_allclose(sent(projected(s, flip)), here * [*flip, 1], atol=1e-6)


@given(situations(), angle, action)
def test_no_action_leaves_the_leash_or_the_workspace(s: dict, box_yaw: float, a: tuple[float, ...]) -> None:
    # Every tip here is over the interior, where the leash is the only bound that the workspace does not move.
    s["tip"][:2] = np.clip(s["tip"][:2], -0.11, 0.11)
    x = projected(s, box_yaw=box_yaw)
    sent = commanded_tip(x, torch.tensor([a]).double())
    local = spatial.apply(spatial.inverse(spatial.pose_from_features(x[0, BOX][:7].numpy())), sent.numpy())[0]
    assert np.all(np.abs(local[:2]) <= np.array(s["inner"]) / 2 - 0.02 + 1e-9)
    assert LOWEST_TIP - 1e-9 <= local[2] <= 0.30
    assert (sent - x[:, TIP])[:, :2].abs().max() <= np.sqrt(2) * (LEASH + STEP) + 1e-9


def test_an_action_moves_the_last_command_by_its_step_towards_the_nearest_corner() -> None:
    s = {"block": (0.1, -0.1), "yaw": 0.0, "lean": 0.0, "inner": (0.3, 0.3)}
    s |= {"tip": np.array([0.0, 0.0, 0.1]), "commanded": np.array([0.0, 0.0, 0.1])}
    x = projected(s)
    moved = (commanded_tip(x, torch.tensor([[1.0, 1.0, -0.5]])) - x[:, COMMANDED])[0].numpy()
    np.testing.assert_allclose(moved, [STEP, -STEP, -STEP / 2], atol=1e-7)


@given(situations(), signs)
def test_mirror_brings_the_block_to_the_first_corner(s: dict, flip: tuple[int, int]) -> None:
    assert mirror(projected(s, flip))[0].tolist() == list(flip)


def test_geometry_of_a_block_that_touches_a_wall() -> None:
    s = {"block": (0.15 - 0.03, 0.05), "yaw": np.pi / 2, "lean": 0.0, "inner": (0.3, 0.3)}
    s |= {"tip": np.array([0.0, 0.0, scenes.HEIGHT + 0.012 + 0.03]), "commanded": np.zeros(3)}
    x = projected(s, box_yaw=0.4)
    np.testing.assert_allclose(wall_gaps(x)[0], [0.0, 0.07], atol=1e-9)
    assert float(block_yaw(x)) == pytest.approx(np.pi / 2)
    assert float(tip_above_stud(x)) == pytest.approx(0.03)
    np.testing.assert_allclose(up_axis(x)[0], [0, 0, 1], atol=1e-9)


def test_project_lays_out_a_full_state_in_the_named_columns() -> None:
    state = scenes.scene({"b0": (0.1, 0.1, 0.3), "b1": (0.0, 0.0)}).initial
    commanded = np.array([0.4, 0.1, 0.2])
    x = project(state, scenes.R, scenes.B0, scenes.THE_BOX, commanded)
    assert x.shape == (1, PROJECTED_SIZE)
    np.testing.assert_allclose(x[0, TIP], state[scenes.R][:3], atol=1e-6)
    np.testing.assert_allclose(x[0, COMMANDED], commanded, atol=1e-6)
    np.testing.assert_allclose(x[0, BLOCK], state[scenes.B0], atol=1e-6)
    np.testing.assert_allclose(x[0, BOX], state[scenes.THE_BOX], atol=1e-6)
    moved = State({o: state[o] + (o == scenes.B1) for o in state})
    assert torch.equal(project(moved, scenes.R, scenes.B0, scenes.THE_BOX, commanded), x)


def record() -> Record:
    torch.manual_seed(1)
    net = ActorCritic(width=8, depth=2)
    net.mean.normal_()
    net.scale.uniform_(0.5, 2.0)
    return Record({"width": 8, "depth": 2}, net.to_tensors())


def test_a_saved_policy_acts_as_before() -> None:
    torch.manual_seed(1)
    net = ActorCritic(width=8, depth=2)
    net.mean.normal_()
    net.scale.uniform_(0.5, 2.0)
    seen = torch.randn(5, OBSERVATION_SIZE)
    back = ActorCritic.from_record(Record({"width": 8, "depth": 2}, net.to_tensors()))
    torch.testing.assert_close(back.act(seen), net.act(seen), rtol=0, atol=0)
    assert not any(k.startswith("critic") for k in net.to_tensors())


@pytest.mark.parametrize("name", ["mean", "scale", "actor.0.weight", "actor.4.bias"])
def test_a_record_without_normaliser_or_weights_is_refused(name: str) -> None:
    whole = record()
    without = replace(whole, tensors={k: v for k, v in whole.tensors.items() if k != name})
    with pytest.raises(LibraryError, match=name):
        ActorCritic.from_record(without)
    with pytest.raises(LibraryError, match=name):
        ActorCritic.from_record(replace(whole, tensors={**whole.tensors, name: np.zeros((3, 3), np.float32)}))


@pytest.mark.parametrize("meta", [{}, {"width": "wide", "depth": 2}])
def test_a_record_without_its_sizes_is_refused(meta: dict) -> None:
    with pytest.raises(LibraryError):
        ActorCritic.from_record(replace(record(), meta=meta))
