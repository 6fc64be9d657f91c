"""PPO at a tiny size: reproducible, resumable, and able to learn."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from resync_robot.core.errors import TrainingError
from resync_robot.learning.recovery_policy import ActorCritic
from resync_robot.sim_training.ppo import Environment, PpoSettings, _found, has_plateaued, train_policy

TINY = PpoSettings(scenes=4, steps=4, total_steps=48, minibatch=8, epochs=2)


class Track(Environment):
    """Points in the plane that are to be led to its origin: the least MDP that a policy can learn."""

    def __init__(self, count: int, seed: int, horizon: int = 6) -> None:
        self.count, self.horizon = count, horizon
        self.random = torch.Generator().manual_seed(seed)
        self.place, self.steps = torch.zeros(count, 2), torch.zeros(count, dtype=torch.long)
        self.reset(torch.arange(count))

    def observe(self) -> torch.Tensor:
        return self.place.clone()

    def step(self, action: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        before = self.place.norm(dim=-1)
        self.place = self.place + 0.3 * action.clamp(-1, 1)
        self.steps += 1
        after = self.place.norm(dim=-1)
        success = after < 0.2
        return before - after + success - 0.05, success, success, (self.steps >= self.horizon) & ~success

    def reset(self, which: torch.Tensor) -> None:
        angle = 2 * np.pi * torch.rand(len(which), generator=self.random)
        self.place[which] = torch.stack([angle.cos(), angle.sin()], -1)
        self.steps[which] = 0

    def learn(self) -> None:
        """Its reward is given."""


def run(checkpoint: Path, seed: int = 0, **changes: Any) -> tuple[ActorCritic, dict[str, list[float]], list[int]]:
    told: list[int] = []
    s = replace(TINY, **changes)
    torch.manual_seed(seed)
    net = ActorCritic(16, 1, 2, 2)

    @contextmanager
    def opened(done: int) -> Iterator[Track]:
        yield Track(s.scenes, seed + done)

    curve = train_policy(net, opened, s, seed, checkpoint, lambda done, budget, rate: told.append(done))
    return net, curve, told


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


def test_a_policy_that_finds_nothing_begins_anew_and_one_that_does_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[int] = []
    anew = ActorCritic.begin_anew
    monkeypatch.setattr(ActorCritic, "begin_anew", lambda net, seed: (begun.append(seed), anew(net, seed))[1])
    lasting = {"total_steps": 96, "restart": 32, "learning_rate": 0.0}
    net, curve, _ = run(tmp_path / "a.safetensors", seed=5, stop_at=10.0, **lasting)
    assert begun == [5 + 32, 5 + 64] and curve["steps"] == [16, 32, 48, 64, 80, 96]
    fresh = ActorCritic(16, 1, 2, 2)
    anew(fresh, 5 + 64)
    assert torch.equal(net.actor[0].weight, fresh.actor[0].weight)
    begun.clear()
    run(tmp_path / "b.safetensors", seed=5, stop_at=0.0, **{**lasting, "least_steps": 1000})
    run(tmp_path / "c.safetensors", seed=5, stop_at=10.0, **{**lasting, "restart": 0})
    assert begun == []


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


def test_training_ends_early_once_it_is_good_enough(tmp_path: Path) -> None:
    # Every rate is at least zero, so only the number of finished episodes and the least steps hold it back.
    _, curve, _ = run(
        tmp_path / "a.safetensors", scenes=8, steps=60, stop_at=0.0, least_steps=960, total_steps=9600, minibatch=480
    )
    assert 960 <= curve["steps"][-1] < 9600


def test_it_learns(tmp_path: Path) -> None:
    _, curve, _ = run(
        tmp_path / "a.safetensors",
        scenes=32,
        steps=32,
        total_steps=40_960,
        minibatch=256,
        epochs=4,
        anneal_steps=20_000,
        learning_rate=1e-3,
        gamma=0.95,
        lam=0.9,
        stop_at=2.0,
    )
    assert curve["success"][0] < 0.5 < 0.95 < curve["success"][-1]


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
