"""Failed worlds, batched: the same in numpy and in torch, and late arms."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core.rig import load_rig
from resync_robot.learning.recovery_policy import BLOCK, STUD, TIP
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.failed_worlds import FailedWorlds, lagging
from tests.scenes import B0

RIG = load_rig()


def test_many_worlds_are_the_same_in_torch_and_numpy() -> None:
    scenario = find_domain("cornered-insertion-s").scenario("s0")
    tasks = [scenario.sample(np.random.default_rng(seed), seed) for seed in range(5)]
    task, found = torch.arange(64) % 5, []
    for xp in (np, torch):
        worlds = FailedWorlds(tasks, B0, RIG, xp, torch.device("cpu"))
        block = worlds.failures[task][:, BLOCK]
        tip = block[:, :3].clone()
        tip[:, 2] += block[:, 9] / 2 + STUD + torch.linspace(0.0, 0.07, 64)
        q, poses = worlds.joints_at(tip, task), worlds.array(block[:, :7])
        assert torch.allclose(worlds.tip_at(q), tip, atol=1e-6)
        found.append((torch.as_tensor(q), worlds.states(q, poses, tip, task)))
        assert torch.allclose(found[-1][1][:, BLOCK], block) and torch.allclose(found[-1][1][:, TIP], tip, atol=1e-6)
    for ours, theirs in zip(*found, strict=True):
        assert ours.shape[0] == 64 and torch.allclose(ours, theirs, atol=1e-7)


@given(st.floats(0, 1), st.lists(st.floats(-1, 1), min_size=6, max_size=6))
def test_a_late_arm_is_that_share_of_the_last_ramp_behind(lag: float, ends: list[float]) -> None:
    before, command = torch.tensor(ends).reshape(2, 1, 3)
    sent = lagging(command, before, torch.tensor([lag]))
    assert float((command - sent).norm()) == pytest.approx(lag * float((command - before).norm()), abs=1e-5)
    assert float((sent - before).norm()) == pytest.approx((1 - lag) * float((command - before).norm()), abs=1e-5)
