"""Proximal policy optimisation, read from top to bottom: any environment of scenes that reset when they are told to.

Schulman et al. 2017. Differences from the textbook: the policy's standard deviation is annealed on a schedule (a
constant one leaves the deterministic policy much worse than its sampled self), and episodes that time out bootstrap.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from resync_robot.core.damage import reading
from resync_robot.core.files import whole
from resync_robot.learning.recovery_policy import ActorCritic


@dataclass(frozen=True, kw_only=True)
class PpoSettings:
    scenes: int = 64
    steps: int = 32
    """Control steps of each scene between two updates."""
    total_steps: int = 400_000
    """Budget in control steps over all scenes."""
    stop_at: float = 0.98
    """Sampled success rate over the last 400 episodes (or one of each scene) at which training ends early..."""
    least_steps: int = 150_000
    """...but not before this many steps, for the rare corners of the randomisation."""
    plateau: int = 0
    """Control steps, from then on, in which that rate has risen by less than a hundredth, after which training ends,
    too, if that rate is half of `stop_at` or more; 0: never. Through the noise of exploration some recoveries never
    reach `stop_at`, and some begin late to succeed at all."""
    restart: int = 0
    """Control steps in which that rate has never come to half of `stop_at`, after which the policy begins anew with
    other weights; 0: never. Where only few ways lead to success, some weights never find one."""
    epochs: int = 4
    minibatch: int = 512
    learning_rate: float = 3e-4
    gamma: float = 0.98
    lam: float = 0.95
    clip: float = 0.2
    value_weight: float = 0.5
    gradient_norm: float = 0.5
    std_begin: float = 0.6
    std_end: float = 0.25
    anneal_steps: int = 250_000
    anneal_from: float = 0.0
    """Success rate from which on the standard deviation is annealed: who has found nothing yet goes on searching."""
    rebuild: float = 0.15
    """Share of resets that build another world: new sizes, box and friction."""


@dataclass(frozen=True)
class Rollout:
    """What a policy did in n scenes over t steps; tensors of shape (t, n, ...).

    Attributes:
        observation, action: (t, n, d) and (t, n, k).
        after: (t, n, d) what was seen behind each action, before another episode began.
        gained: (t, n) rewards.
        success, terminated, truncated: (t, n).
        last: (n, d) what is seen in the end.
    """

    observation: Tensor
    action: Tensor
    after: Tensor
    gained: Tensor
    success: Tensor
    terminated: Tensor
    truncated: Tensor
    last: Tensor

    @staticmethod
    def joined(parts: Sequence[Rollout]) -> Rollout:
        """The rollouts of some scenes after those of others."""
        columns = {f.name: [getattr(part, f.name) for part in parts] for f in fields(Rollout)}
        return Rollout(**{name: torch.cat(column, 0 if name == "last" else 1) for name, column in columns.items()})


class Environment(ABC):
    """Many scenes of one MDP. What it returns are tensors of shape (count, ...) on its device."""

    count: int

    @abstractmethod
    def observe(self) -> Tensor:
        """(count, d) what the policy sees of each scene."""

    @abstractmethod
    def step(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Reward, success, terminated and truncated of each scene."""

    @abstractmethod
    def reset(self, which: Tensor) -> None:
        """Begin new episodes in the scenes of these indices."""

    @abstractmethod
    def learn(self) -> object:
        """Between two batches: time for what the environment itself learns."""

    def roll(self, net: ActorCritic, std: float, steps: int, random: torch.Generator) -> Rollout:
        """So many steps of a policy in each scene, whose actions have noise of this standard deviation. Episodes that
        end give way to new ones."""
        seen: list[tuple[Tensor, ...]] = []
        for _ in range(steps):
            observation = self.observe()
            with torch.no_grad():
                mean = net.act(observation)
            action = mean + std * torch.randn(mean.shape, generator=random, device=mean.device)
            gained, success, terminated, truncated = self.step(action)
            seen.append((observation, action, self.observe(), gained, success, terminated, truncated))
            ended = terminated | truncated
            if ended.any():
                self.reset(torch.nonzero(ended).flatten())
        columns = [*map(torch.stack, zip(*seen, strict=True)), self.observe()]
        return Rollout(**{f.name: column for f, column in zip(fields(Rollout), columns, strict=True)})


Progress = Callable[[int, int, float], None]
"""Called with steps so far, the budget, and the success rate."""


def train_policy(
    net: ActorCritic,
    open_environment: Callable[[int], AbstractContextManager[Environment]],
    settings: PpoSettings,
    seed: int,
    checkpoint: Path,
    progress: Progress,
) -> dict[str, list[float]]:
    """Train `net`, which lies on the environment's device; resumes from `checkpoint` where one lies.

    Args:
        open_environment: how many steps were done before -> the environment, with `settings.scenes` scenes.

    Returns:
        The learning curve: steps, success rate, mean return and seconds.
    """
    optimiser = _optimiser(net, settings)
    curve: dict[str, list[float]] = {"steps": [], "success": [], "return": [], "seconds": []}
    done_steps, spent = 0, 0.0
    if checkpoint.exists():
        done_steps, spent = _load(checkpoint, net, optimiser, curve)
    window = max(400, settings.scenes)
    finished: deque[float] = deque(maxlen=window)
    returns: deque[float] = deque(maxlen=window)
    begun, device = time.monotonic() - spent, net.mean.device
    with open_environment(done_steps) as env:
        running_return = torch.zeros(settings.scenes, device=device)
        random = torch.Generator(device).manual_seed(seed + 1 + done_steps)
        # A run that had learned enough when it was cut off has still learned enough.
        enough = done_steps >= max(settings.least_steps, 1) and (
            curve["success"][-1] >= settings.stop_at or has_plateaued(curve, settings)
        )
        while done_steps < settings.total_steps and not enough:
            fraction = min(1.0, (done_steps - _found(curve, settings, done_steps)) / settings.anneal_steps)
            std = settings.std_begin + fraction * (settings.std_end - settings.std_begin)
            batch = _collect(env, net, std, settings, random, finished, returns, running_return, done_steps == 0)
            remaining = 1.0 - (done_steps - _begun(curve, settings)) / settings.total_steps
            for group in optimiser.param_groups:
                group["lr"] = settings.learning_rate * max(0.1, remaining)
            _update(net, optimiser, batch, std, settings, random)
            env.learn()
            done_steps += settings.scenes * settings.steps
            rate = float(np.mean(finished)) if finished else 0.0
            for key, value in zip(
                curve, (done_steps, rate, float(np.mean(returns or [0.0])), time.monotonic() - begun), strict=True
            ):
                curve[key].append(float(value))
            progress(done_steps, settings.total_steps, rate)
            if _begun(curve, settings) == done_steps < settings.total_steps:
                net.begin_anew(seed + done_steps)
                optimiser = _optimiser(net, settings)
                finished.clear()
                _save(checkpoint, net, optimiser, curve)
            if len(curve["steps"]) % 20 == 0:
                _save(checkpoint, net, optimiser, curve)
            full = len(finished) == finished.maxlen and done_steps >= settings.least_steps
            enough = full and (rate >= settings.stop_at or has_plateaued(curve, settings))
    _save(checkpoint, net, optimiser, curve)
    return curve


def _optimiser(net: ActorCritic, s: PpoSettings) -> torch.optim.Adam:
    return torch.optim.Adam(net.parameters(), lr=s.learning_rate, eps=1e-5)


def _begun(curve: Mapping[str, Sequence[float]], s: PpoSettings) -> float:
    """Steps at which the policy last began anew; 0 where it never did."""
    begun, best = 0.0, 0.0
    for steps, rate in zip(curve["steps"], curve["success"], strict=True):
        best = max(best, rate)
        if s.restart and best < s.stop_at / 2 and steps - begun >= s.restart:
            begun, best = steps, 0.0
    return begun


def _found(curve: Mapping[str, Sequence[float]], s: PpoSettings, now: int) -> float:
    """Steps at which the success rate first was where annealing begins; `now` where it has not been yet."""
    if s.anneal_from <= 0.0:
        return 0.0
    reached = (steps for steps, rate in zip(curve["steps"], curve["success"], strict=True) if rate >= s.anneal_from)
    return next(reached, float(now))


def has_plateaued(curve: Mapping[str, Sequence[float]], s: PpoSettings) -> bool:
    """Whether the success rate has not risen for as long as the settings say."""
    best, since = -1.0, 0.0
    for steps, rate in zip(curve["steps"], curve["success"], strict=True):
        if steps >= s.least_steps and rate > best + 0.01:
            best, since = rate, steps
    return s.plateau > 0 and best >= s.stop_at / 2 and curve["steps"][-1] - since >= s.plateau


def _collect(
    env: Environment,
    net: ActorCritic,
    std: float,
    s: PpoSettings,
    random: torch.Generator,
    finished: deque[float],
    returns: deque[float],
    running_return: Tensor,
    first: bool,
) -> dict[str, Tensor]:
    """Roll the policy for `steps` and estimate advantages (GAE)."""
    rolled = env.roll(net, std, s.steps, random)
    ends = rolled.terminated | rolled.truncated
    for gained, success, ended in zip(rolled.gained, rolled.success, ends, strict=True):
        running_return += gained
        finished.extend(success[ended].float().tolist())
        returns.extend(running_return[ended].tolist())
        running_return[ended] = 0.0
    if first:
        # The normaliser is fixed after the first batch, so that old and new actions are scored alike.
        flat = rolled.observation.flatten(0, 1)
        net.mean.copy_(flat.mean(0))
        net.scale.copy_(flat.std(0).clamp(min=0.05))
    with torch.no_grad():
        values, next_value = net.value(rolled.observation), net.value(rolled.last)
        log_probs = _log_prob(rolled.action, net.act(rolled.observation), std)
        # A time-out is not the end of the world: what would have followed still counts.
        bootstraps = torch.where(rolled.truncated, net.value(rolled.after), 0.0)
    advantages: list[Tensor] = []
    advantage = torch.zeros_like(next_value)
    for t in reversed(range(s.steps)):
        going_on = (~ends[t]).float()
        delta = rolled.gained[t] + s.gamma * (next_value * going_on + bootstraps[t]) - values[t]
        advantage = delta + s.gamma * s.lam * going_on * advantage
        advantages.insert(0, advantage)
        next_value = values[t]
    advantages_t = torch.stack(advantages)
    batch = {
        "observation": rolled.observation,
        "action": rolled.action,
        "log_prob": log_probs,
        "advantage": advantages_t,
        "target": advantages_t + values,
    }
    return {k: v.flatten(0, 1) for k, v in batch.items()}


def _update(
    net: ActorCritic,
    optimiser: torch.optim.Optimizer,
    batch: dict[str, Tensor],
    std: float,
    s: PpoSettings,
    random: torch.Generator,
) -> None:
    count = len(batch["advantage"])
    for _ in range(s.epochs):
        order = torch.randperm(count, generator=random, device=batch["advantage"].device)
        for begin in range(0, count, s.minibatch):
            part = {k: v[order[begin : begin + s.minibatch]] for k, v in batch.items()}
            advantage = part["advantage"]
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
            ratio = (_log_prob(part["action"], net.act(part["observation"]), std) - part["log_prob"]).exp()
            clipped = ratio.clamp(1 - s.clip, 1 + s.clip)
            policy_loss = -torch.min(ratio * advantage, clipped * advantage).mean()
            value_loss = (net.value(part["observation"]) - part["target"]).pow(2).mean()
            optimiser.zero_grad()
            (policy_loss + s.value_weight * value_loss).backward()
            torch.nn.utils.clip_grad_norm_(net.parameters(), s.gradient_norm)
            optimiser.step()


def _log_prob(action: Tensor, mean: Tensor, std: float) -> Tensor:
    return -0.5 * ((action - mean) / std).pow(2).sum(-1)


def _save(path: Path, net: ActorCritic, optimiser: torch.optim.Optimizer, curve: dict[str, list[float]]) -> None:
    tensors = {f"net.{k}": v.contiguous() for k, v in net.state_dict().items()}
    for i, state in optimiser.state_dict()["state"].items():
        tensors |= {f"adam.{i}.{k}": torch.as_tensor(v).contiguous() for k, v in state.items()}
    tensors |= {f"curve.{k}": torch.tensor(v, dtype=torch.float64) for k, v in curve.items()}
    with whole(path) as beside:
        save_file(tensors, beside)


def _load(
    path: Path, net: ActorCritic, optimiser: torch.optim.Optimizer, curve: dict[str, list[float]]
) -> tuple[int, float]:
    """Go on where `_save` left off: steps so far and seconds spent. Raises TrainingError where the file is damaged or
    of another training."""
    with reading(path):
        tensors = load_file(path)
        net.load_state_dict({k[4:]: v for k, v in tensors.items() if k.startswith("net.")})
        state: dict[int, dict[str, Tensor]] = {}
        for key, value in tensors.items():
            if key.startswith("adam."):
                _, i, name = key.split(".")
                state.setdefault(int(i), {})[name] = value
        # torch takes an optimiser's state of any shape, and fails later.
        for number, parameter in enumerate(net.parameters()):
            if state and state[number]["exp_avg"].shape != parameter.shape:
                raise ValueError(f"the optimiser's state of parameter {number} is of another shape")
        if state:
            optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})
        for key in curve:
            curve[key] = tensors[f"curve.{key}"].tolist()
        if len({len(values) for values in curve.values()}) > 1:
            raise ValueError("its learning curve has parts of different lengths")
    return (int(curve["steps"][-1]), curve["seconds"][-1]) if curve["steps"] else (0, 0.0)
