"""Proximal policy optimisation of a recovery skill, read from top to bottom.

Schulman et al. 2017. Differences from the textbook: the policy's standard deviation is annealed on a schedule (a
constant one leaves the deterministic policy much worse than its sampled self), and episodes that time out bootstrap.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from resync_robot.core import kinematics, spatial
from resync_robot.core.rig import Rig
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BOX as BOX_TYPE
from resync_robot.learning import recovery_policy as view
from resync_robot.learning.recovery_policy import ActorCritic
from sim_training.recovery import RecoverySettings, draw_starts, reward
from sim_training.vector_env import RecoveryScenes


@dataclass(frozen=True, kw_only=True)
class PpoSettings:
    scenes: int = 64
    steps: int = 32
    """Control steps of each scene between two updates."""
    total_steps: int = 400_000
    """Budget in control steps over all scenes."""
    stop_at: float = 0.98
    """Sampled success rate over the last 400 episodes at which training ends early..."""
    least_steps: int = 150_000
    """...but not before this many steps, for the rare corners of the randomisation."""
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
    rebuild: float = 0.15
    """Share of resets that build another world: new sizes, box and friction."""


class RecoveryEnv:
    """The recovery MDP over `RecoveryScenes`: projected states in, rewards out, finished scenes reset themselves."""

    def __init__(
        self, scenes: RecoveryScenes, rig: Rig, settings: RecoverySettings, gamma: float, seed: int, rebuild: float
    ):
        self.scenes, self.rig, self.settings, self.gamma, self.rebuild = scenes, rig, settings, gamma, rebuild
        self.random = torch.Generator().manual_seed(seed)
        self._draw = np.random.default_rng(seed)
        self._base_T_world = spatial.inverse(rig.arm.world_T_base)
        self._tip_T_flange = spatial.inverse(rig.gripper.flange_T_tip)
        n = scenes.count
        self.task_index = np.arange(n) % len(scenes.tasks)
        self._failures = torch.stack([self._failure_state(t) for t in scenes.tasks])
        self._yaws = np.array([_tool_yaw(f) for f in self._failures])
        self.steps = torch.zeros(n, dtype=torch.long)
        self.commanded = torch.zeros(n, 3)
        self.x = torch.zeros(n, view.PROJECTED_SIZE)
        self.reset(np.arange(n))

    def _failure_state(self, task: Task) -> Tensor:
        box = next(o for o in task.objects if o.type == BOX_TYPE)
        row = np.concatenate([np.zeros(6), task.initial[self.scenes.block], task.initial[box]])
        return torch.as_tensor(row, dtype=torch.float32)

    def reset(self, which: np.ndarray) -> None:
        """Begin new episodes in the given scenes."""
        for i in which:
            if self._draw.random() < self.rebuild:
                self.task_index[i] = self._draw.integers(len(self.scenes.tasks))
        failure = self._failures[self.task_index[which]]
        block, tip = draw_starts(failure, self.random)
        poses = failure[:, view.BLOCK][:, :7].double().numpy().copy()
        poses[:, :2] = block
        q = self.joints_at(tip.double().numpy(), which)
        self.scenes.reset([(int(i), int(self.task_index[i]), p, c) for i, p, c in zip(which, poses, q, strict=True)])
        self.commanded[which] = tip
        self.steps[which] = 0
        self.x[which] = self._read(which)

    def joints_at(self, tip: np.ndarray, which: np.ndarray) -> np.ndarray:
        """(k, 6) joints that put the tips at (k, 3), tool down and square to the box."""
        rotation = spatial.rotation_about("z", self._yaws[self.task_index[which]]) @ spatial.rotation_about("x", np.pi)
        flange = self._base_T_world @ spatial.transform(rotation, tip) @ self._tip_T_flange
        q = kinematics.inverse_branch(flange, kinematics.WORK_BRANCH)
        home = self.rig.arm.home
        return q + 2 * np.pi * np.round((home - q) / (2 * np.pi))

    def _read(self, which: np.ndarray) -> Tensor:
        tip = self.rig.tip_pose(self.scenes.joints[which])
        x = self._failures[self.task_index[which]].clone()
        x[:, view.TIP] = torch.as_tensor(tip[:, :3, 3], dtype=torch.float32)
        x[:, view.COMMANDED] = self.commanded[which]
        x[:, 6:13] = torch.as_tensor(self.scenes.blocks[which], dtype=torch.float32)
        return x

    def step(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Reward, success, terminated and truncated, each (n,); `x` is then the state to act from."""
        everyone = np.arange(self.scenes.count)
        previous = self.x
        self.commanded = view.commanded_tip(previous, action)
        self.scenes.step(self.joints_at(self.commanded.double().numpy(), everyone))
        self.x = self._read(everyone)
        self.steps += 1
        gained, success, failed = reward(self.x, previous, self.gamma, self.settings)
        truncated = (self.steps >= self.settings.horizon) & ~success & ~failed
        return gained, success, success | failed, truncated


def _tool_yaw(failure: Tensor) -> float:
    w, z = float(failure[view.BOX][3]), float(failure[view.BOX][6])
    return float(spatial.wrap(2 * np.arctan2(z, w), np.pi / 2))


def train_recovery(
    tasks: Sequence[Task],
    block: Object,
    rig: Rig,
    seed: int,
    workers: int,
    settings: PpoSettings,
    recovery: RecoverySettings,
    checkpoint: Path,
    progress: Callable[[int, int, float], None],
) -> tuple[ActorCritic, dict[str, Any]]:
    """Learn a recovery from failure worlds; resumes from `checkpoint` where one lies.

    Args:
        tasks: the mined failures (D^F), each as a task whose initial state fails.
        progress: called with (steps so far, budget, success rate).

    Returns:
        The policy and its learning curve: lists of steps, success rate, mean return and seconds.
    """
    torch.manual_seed(seed)
    net = ActorCritic()
    optimiser = torch.optim.Adam(net.parameters(), lr=settings.learning_rate, eps=1e-5)
    curve: dict[str, list[float]] = {"steps": [], "success": [], "return": [], "seconds": []}
    done_steps, spent = 0, 0.0
    if checkpoint.exists():
        done_steps, spent = _load(checkpoint, net, optimiser, curve)
    finished: deque[float] = deque(maxlen=400)
    returns: deque[float] = deque(maxlen=400)
    begun = time.monotonic() - spent
    with RecoveryScenes(tasks, block, rig, settings.scenes, workers) as scenes:
        env = RecoveryEnv(scenes, rig, recovery, settings.gamma, seed + done_steps, settings.rebuild)
        running_return = torch.zeros(settings.scenes)
        random = torch.Generator().manual_seed(seed + 1 + done_steps)
        while done_steps < settings.total_steps:
            fraction = min(1.0, done_steps / settings.anneal_steps)
            std = settings.std_begin + fraction * (settings.std_end - settings.std_begin)
            batch = _collect(env, net, std, settings, random, finished, returns, running_return, done_steps == 0)
            remaining = 1.0 - done_steps / settings.total_steps
            for group in optimiser.param_groups:
                group["lr"] = settings.learning_rate * max(0.1, remaining)
            _update(net, optimiser, batch, std, settings, random)
            done_steps += settings.scenes * settings.steps
            rate = float(np.mean(finished)) if finished else 0.0
            for key, value in zip(
                curve, (done_steps, rate, float(np.mean(returns or [0.0])), time.monotonic() - begun), strict=True
            ):
                curve[key].append(float(value))
            progress(done_steps, settings.total_steps, rate)
            if len(curve["steps"]) % 20 == 0:
                _save(checkpoint, net, optimiser, curve)
            enough = len(finished) == finished.maxlen and rate >= settings.stop_at
            if enough and done_steps >= settings.least_steps:
                break
    _save(checkpoint, net, optimiser, curve)
    return net.eval(), {"curve": curve}


def _collect(
    env: RecoveryEnv,
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
    observations, actions, log_probs, values, rewards, ends, bootstraps = [], [], [], [], [], [], []
    for _ in range(s.steps):
        observation = view.observe(env.x)
        with torch.no_grad():
            mean, value = net.act(observation), net.value(observation)
        action = mean + std * torch.randn(mean.shape, generator=random)
        gained, success, terminated, truncated = env.step(action)
        ended = terminated | truncated
        with torch.no_grad():
            # A time-out is not the end of the world: what would have followed still counts.
            bootstraps.append(torch.where(truncated, net.value(view.observe(env.x)), torch.zeros(len(ended))))
        observations.append(observation)
        actions.append(action)
        log_probs.append(_log_prob(action, mean, std))
        values.append(value)
        rewards.append(gained)
        ends.append(ended)
        running_return += gained
        if ended.any():
            finished.extend(success[ended].float().tolist())
            returns.extend(running_return[ended].tolist())
            running_return[ended] = 0.0
            env.reset(torch.nonzero(ended).flatten().numpy())
    stacked = torch.stack(observations)
    if first:
        # The normaliser is fixed after the first batch, so that old and new actions are scored alike.
        flat = stacked.flatten(0, 1)
        net.mean.copy_(flat.mean(0))
        net.scale.copy_(flat.std(0).clamp(min=0.05))
        with torch.no_grad():
            means = net.act(stacked)
            values = list(net.value(stacked))
            log_probs = list(_log_prob(torch.stack(actions), means, std))
    with torch.no_grad():
        next_value = net.value(view.observe(env.x))
    advantages: list[Tensor] = []
    advantage = torch.zeros_like(next_value)
    for t in reversed(range(s.steps)):
        going_on = (~ends[t]).float()
        delta = rewards[t] + s.gamma * (next_value * going_on + bootstraps[t]) - values[t]
        advantage = delta + s.gamma * s.lam * going_on * advantage
        advantages.insert(0, advantage)
        next_value = values[t]
    advantages_t = torch.stack(advantages)
    batch = {
        "observation": stacked,
        "action": torch.stack(actions),
        "log_prob": torch.stack(log_probs),
        "advantage": advantages_t,
        "target": advantages_t + torch.stack(values),
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
        order = torch.randperm(count, generator=random)
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
    beside = path.with_suffix(".part")
    save_file(tensors, beside)
    beside.replace(path)


def _load(
    path: Path, net: ActorCritic, optimiser: torch.optim.Optimizer, curve: dict[str, list[float]]
) -> tuple[int, float]:
    tensors = load_file(path)
    net.load_state_dict({k[4:]: v for k, v in tensors.items() if k.startswith("net.")})
    state: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors.items():
        if key.startswith("adam."):
            _, i, name = key.split(".")
            state.setdefault(int(i), {})[name] = value
    if state:
        optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})
    for key in curve:
        curve[key] = tensors[f"curve.{key}"].tolist()
    return (int(curve["steps"][-1]), curve["seconds"][-1]) if curve["steps"] else (0, 0.0)
