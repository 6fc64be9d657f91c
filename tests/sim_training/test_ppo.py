"""PPO at a tiny size: reproducible, resumable, and able to learn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from resync_robot.core.errors import TrainingError
from resync_robot.core.rig import load_rig
from resync_robot.core.task import Task
from resync_robot.learning.recovery_policy import OBSERVATION_SIZE, PROJECTED_SIZE, ActorCritic
from resync_robot.sim_training.block_recovery import RecoveryEnv, train_recovery
from resync_robot.sim_training.ppo import PpoSettings, _found, has_plateaued
from resync_robot.sim_training.recovery import RecoverySettings
from resync_robot.sim_training.vector_env import RecoveryScenes
from tests import scenes
from tests.scenes import B0, CORNER

RIG = load_rig()
TINY = PpoSettings(scenes=4, steps=4, total_steps=48, minibatch=8, epochs=2)


def tasks() -> list[Task]:
    return [scenes.scene({"b0": (sx * CORNER, sy * CORNER)}) for sx in (1, -1) for sy in (1, -1)]


def run(checkpoint: Path, seed: int = 0, **changes: Any) -> tuple[ActorCritic, dict[str, list[float]], list[int]]:
    told: list[int] = []
    net, figures = train_recovery(
        tasks(),
        B0,
        RIG,
        seed,
        0,
        replace(TINY, **changes),
        RecoverySettings(horizon=6),
        checkpoint,
        lambda done, budget, rate: told.append(done),
    )
    return net, figures["curve"], told


def same(a: ActorCritic, b: ActorCritic) -> bool:
    return all(torch.equal(x, y) for x, y in zip(a.state_dict().values(), b.state_dict().values(), strict=True))


def test_the_same_seed_gives_the_same_policy_and_another_does_not(tmp_path: Path) -> None:
    first, curve, _ = run(tmp_path / "a.safetensors")
    again, curve_again, _ = run(tmp_path / "b.safetensors")
    other, _, _ = run(tmp_path / "c.safetensors", seed=1)
    assert same(first, again) and not same(first, other)
    for key in ("steps", "success", "return"):
        assert curve[key] == curve_again[key]


def test_progress_and_curve_tell_every_update(tmp_path: Path) -> None:
    _, curve, told = run(tmp_path / "a.safetensors")
    assert told == curve["steps"] == [16, 32, 48]
    assert all(len(values) == 3 for values in curve.values())
    assert curve["seconds"] == sorted(curve["seconds"])
    assert all(0 <= rate <= 1 for rate in curve["success"])


def test_a_checkpoint_is_gone_on_from(tmp_path: Path) -> None:
    path = tmp_path / "ppo.safetensors"
    half, curve, _ = run(path, total_steps=32)
    kept = {k: v.clone() for k, v in half.state_dict().items()}
    whole, longer, told = run(path, total_steps=64)
    assert told == [48, 64]
    assert longer["steps"] == [16, 32, 48, 64] and longer["return"][:2] == curve["return"]
    # It began from what was saved: the normaliser is still that of the first batch, the weights moved on.
    assert torch.equal(whole.mean, kept["mean"]) and torch.equal(whole.scale, kept["scale"])
    assert not torch.equal(whole.actor[0].weight, kept["actor.0.weight"])


def test_a_finished_checkpoint_is_loaded_and_not_trained(tmp_path: Path) -> None:
    path = tmp_path / "ppo.safetensors"
    done, _, _ = run(path)
    loaded, curve, told = run(path)
    assert told == [] and len(curve["steps"]) == 3
    assert same(done, loaded)


def test_the_checkpoint_keeps_the_optimiser(tmp_path: Path) -> None:
    from safetensors.torch import load_file

    path = tmp_path / "ppo.safetensors"
    run(path)
    saved = load_file(path)
    assert {"net.mean", "net.actor.0.weight", "net.critic.0.weight", "curve.steps", "adam.0.exp_avg"} <= set(saved)
    updates = 3 * TINY.epochs * TINY.scenes * TINY.steps // TINY.minibatch
    assert float(saved["adam.0.step"]) == updates
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("name", "shape", "word"),
    [
        ("net.actor.0.weight", (3, 3), "size mismatch"),
        ("adam.0.exp_avg", (3, 3), "parameter 0 is of another shape"),
        ("curve.success", (1,), "parts of different lengths"),
    ],
)
def test_a_checkpoint_of_another_training_is_named(
    tmp_path: Path, name: str, shape: tuple[int, ...], word: str
) -> None:
    from safetensors.torch import load_file, save_file

    path = tmp_path / "ppo.safetensors"
    run(path)
    save_file({**load_file(path), name: torch.zeros(shape)}, path)
    with pytest.raises(TrainingError, match=r"ppo\.safetensors cannot be used") as caught:
        run(path)
    assert word in caught.value.what


@pytest.mark.slow
def test_training_ends_early_once_it_is_good_enough(tmp_path: Path) -> None:
    # Every rate is at least zero, so only the number of finished episodes and the least steps hold it back.
    _, curve, _ = run(
        tmp_path / "a.safetensors", scenes=8, steps=60, stop_at=0.0, least_steps=960, total_steps=9600, minibatch=480
    )
    assert 960 <= curve["steps"][-1] < 9600


def test_the_environment_ends_episodes_at_the_horizon_and_resets_them() -> None:
    settings = RecoverySettings(horizon=3)
    with RecoveryScenes(tasks(), B0, RIG, 4, 0) as scenes_:
        env = RecoveryEnv(scenes_, RIG, settings, 0.98, 0, rebuild=0.5)
        assert env.x.shape == (4, PROJECTED_SIZE)
        begun = env.x.clone()
        ended = torch.zeros(4, dtype=torch.bool)
        for step in range(1, 4):
            gained, success, terminated, truncated = env.step(torch.zeros(4, 3))
            assert gained.shape == success.shape == (4,)
            assert not (success & ~terminated).any() and not (terminated & truncated).any()
            assert bool((truncated & (step < 3)).any()) is False
            ended |= terminated | truncated
        assert ended.all()
        env.reset(np.array([1, 2]))
        assert env.steps.tolist() == [3, 0, 0, 3]
        assert not torch.equal(env.x[1], begun[1])


def test_a_policy_sees_finite_numbers_from_the_start() -> None:
    from resync_robot.learning.recovery_policy import observe

    with RecoveryScenes(tasks(), B0, RIG, 4, 0) as scenes_:
        env = RecoveryEnv(scenes_, RIG, RecoverySettings(), 0.98, 0, rebuild=0.0)
        for _ in range(5):
            env.step(torch.randn(4, 3, generator=env.random))
            seen = observe(env.x)
            assert seen.shape == (4, OBSERVATION_SIZE) and bool(seen.isfinite().all())
        # Where the arm was sent is where it is, but for its lag and what it touches.
        assert (env.x[:, :3] - env.commanded).norm(dim=-1).max() < 0.06


def test_arms_are_late_by_what_each_episode_draws() -> None:
    with RecoveryScenes(tasks(), B0, RIG, 4, 0) as scenes_:
        env = RecoveryEnv(scenes_, RIG, RecoverySettings(lag=0.8), 0.98, 0, rebuild=0.0)
        assert env.lag.min() >= 0 and env.lag.max() <= 0.8 and env.lag.unique().numel() == 4
        env.lag[:] = torch.tensor([0.0, 0.0, 0.8, 0.8])
        start = env.x[:, :3].clone()
        env.step(torch.tensor([[0.0, 0.0, 1.0]] * 4))
        risen = (env.x[:, :3] - start)[:, 2]
        assert risen[2:].max() < 0.6 * risen[:2].min(), "a late arm has done less of the same command"


@pytest.mark.slow
def test_it_learns(tmp_path: Path) -> None:
    """A few minutes of one process are enough to see the return rise."""
    _, curve, _ = run(
        tmp_path / "a.safetensors",
        scenes=32,
        steps=32,
        total_steps=20_480,
        minibatch=256,
        epochs=4,
        anneal_steps=20_000,
    )
    assert np.mean(curve["return"][-3:]) > np.mean(curve["return"][:3]) + 0.1


@pytest.mark.parametrize(
    ("rates", "expected"),
    [
        ([0.2, 0.5, 0.8, 0.8, 0.805, 0.79], True),
        ([0.2, 0.5, 0.8, 0.8, 0.82, 0.79], False),
        # What was before the least steps is of few episodes.
        ([1.0, 0.5, 0.6, 0.7, 0.8, 0.9], False),
    ],
)
def test_a_rate_that_rises_no_more_has_plateaued(rates: list[float], expected: bool) -> None:
    curve = {"steps": [1000.0 * (i + 1) for i in range(len(rates))], "success": rates}
    settings = PpoSettings(least_steps=2000, plateau=3000)
    assert has_plateaued(curve, settings) is expected
    low = {**curve, "success": [rate / 3 for rate in rates]}
    assert not has_plateaued(low, settings), "it has not begun to succeed"
    assert not has_plateaued(curve, PpoSettings(least_steps=2000))


def test_it_goes_on_searching_until_it_has_found_something() -> None:
    curve = {"steps": [1000.0, 2000.0, 3000.0], "success": [0.2, 0.55, 0.4]}
    assert _found(curve, PpoSettings(anneal_from=0.5), 3000) == 2000
    assert _found(curve, PpoSettings(anneal_from=0.6), 3000) == 3000, "not yet"
    assert _found(curve, PpoSettings(), 3000) == 0
