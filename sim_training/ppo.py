"""Proximal policy optimisation of a recovery skill, read from top to bottom.

Schulman et al. 2017. Differences from the textbook: the policy's standard deviation is annealed on a schedule (a
constant one leaves the deterministic policy much worse than its sampled self), and episodes that time out bootstrap.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from resync_robot.core.damage import reading
from resync_robot.core.files import whole
from resync_robot.core.rig import Rig
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.learning import recovery_policy as view
from resync_robot.learning.recovery_policy import ActorCritic
from resync_robot.sim_training.recovery import FailedWorlds, RecoverySettings, lagging, reward
from resync_robot.sim_training.vector_env import RecoveryScenes

if TYPE_CHECKING:
    from resync_robot.sim_training.maniskill_env import ManiSkillScenes


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


class Scenes(Protocol):
    """Simulated scenes, one failed world each, whose block and arm can be put anywhere: `RecoveryScenes` (processes,
    numpy) or `ManiSkillScenes` (tensors on a device). Arrays are of shape (count, ...)."""

    tasks: Sequence[Task]
    block: Object
    count: int

    @property
    def joints(self) -> Any: ...
    @property
    def blocks(self) -> Any: ...
    def step(self, q: Any, opening: float = 0.0) -> None: ...
    def reset(self, resets: Sequence[tuple[int, int, Any, Any]]) -> None: ...


class RecoveryEnv:
    """The recovery MDP over `Scenes`: projected states in, rewards out, finished scenes reset themselves.

    Everything it holds is a tensor on the device of the scenes.

    Args:
        rebuild: share of resets that put another world into the scene; 0 where scenes cannot be rebuilt.
    """

    def __init__(self, scenes: Scenes, rig: Rig, settings: RecoverySettings, gamma: float, seed: int, rebuild: float):
        self.scenes, self.settings, self.gamma, self.rebuild = scenes, settings, gamma, rebuild
        measured = scenes.joints
        xp, device = (torch, measured.device) if isinstance(measured, Tensor) else (np, torch.device("cpu"))
        self.worlds = FailedWorlds(scenes.tasks, scenes.block, rig, xp, device)
        self.random = torch.Generator(device).manual_seed(seed)
        self._draw = np.random.default_rng(seed)
        self._everyone = torch.arange(scenes.count, device=device)
        self.task_index = self._everyone % len(scenes.tasks)
        self.steps = torch.zeros(scenes.count, dtype=torch.long, device=device)
        self.commanded = torch.zeros(scenes.count, 3, device=device)
        self.lag = torch.zeros(scenes.count, device=device)
        self.x = torch.zeros(scenes.count, view.PROJECTED_SIZE, device=device)
        self.reset(self._everyone)

    def reset(self, which: Any) -> None:
        """Begin new episodes in the given scenes."""
        which = torch.as_tensor(which, device=self.x.device)
        if self.rebuild > 0:
            for i in which.tolist():
                if self._draw.random() < self.rebuild:
                    self.task_index[i] = int(self._draw.integers(len(self.scenes.tasks)))
        task = self.task_index[which]
        poses, q, tip = self.worlds.draw_starts(task, self.random)
        self.scenes.reset(list(zip(which.tolist(), task.tolist(), poses, q, strict=True)))
        self.commanded[which] = tip
        self.lag[which] = self.settings.lag * torch.rand(len(which), generator=self.random, device=self.x.device)
        self.steps[which] = 0
        self.x[which] = self._read(which)

    def _read(self, which: Tensor) -> Tensor:
        i = self.worlds.index(which)
        return self.worlds.states(
            self.scenes.joints[i], self.scenes.blocks[i], self.commanded[which], self.task_index[which]
        )

    def step(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Reward, success, terminated and truncated, each (n,); `x` is then the state to act from."""
        previous, before = self.x, self.commanded
        self.commanded = view.commanded_tip(previous, action)
        sent = lagging(self.commanded, before, self.lag)
        self.scenes.step(self.worlds.joints_at(sent, self.task_index))
        self.x = self._read(self._everyone)
        self.steps += 1
        gained, success, failed = reward(self.x, previous, self.gamma, self.settings)
        truncated = (self.steps >= self.settings.horizon) & ~success & ~failed
        return gained, success, success | failed, truncated


DEVICE_SCENES = 4096


def scaled_to_device(settings: PpoSettings, device: str) -> PpoSettings:
    """The same training for thousands of scenes on a GPU: larger batches, and a budget that lets as many updates
    happen. Their worlds stay as they were built, for there are enough of them."""
    if device == "cpu":
        return settings
    more = DEVICE_SCENES // settings.scenes
    return replace(
        settings,
        scenes=DEVICE_SCENES,
        minibatch=settings.minibatch * more // 4,
        total_steps=settings.total_steps * more // 4,
        least_steps=settings.least_steps * more // 4,
        anneal_steps=settings.anneal_steps * more // 4,
        rebuild=0.0,
    )


def _make_scenes(
    tasks: Sequence[Task], block: Object, rig: Rig, count: int, workers: int, device: str
) -> RecoveryScenes | ManiSkillScenes:
    if device == "cpu":
        return RecoveryScenes(tasks, block, rig, count, workers)
    from resync_robot.sim_training.maniskill_env import ManiSkillScenes  # its import takes seconds

    return ManiSkillScenes(tasks, block, rig, count, device)


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
    device: str = "cpu",
) -> tuple[ActorCritic, dict[str, Any]]:
    """Learn a recovery from failure worlds; resumes from `checkpoint` where one lies.

    Args:
        tasks: the mined failures (D^F), each as a task whose initial state fails.
        workers: processes that step the scenes on the CPU.
        progress: called with (steps so far, budget, success rate).
        device: where scenes and networks live; not "cpu": ManiSkill's scenes on that GPU.

    Returns:
        The policy, on the CPU, and its learning curve: lists of steps, success rate, mean return and seconds.
    """
    torch.manual_seed(seed)
    net = ActorCritic().to(device)
    optimiser = torch.optim.Adam(net.parameters(), lr=settings.learning_rate, eps=1e-5)
    curve: dict[str, list[float]] = {"steps": [], "success": [], "return": [], "seconds": []}
    done_steps, spent = 0, 0.0
    if checkpoint.exists():
        done_steps, spent = _load(checkpoint, net, optimiser, curve)
    window = max(400, settings.scenes)
    finished: deque[float] = deque(maxlen=window)
    returns: deque[float] = deque(maxlen=window)
    begun = time.monotonic() - spent
    with _make_scenes(tasks, block, rig, settings.scenes, workers, device) as scenes:
        env = RecoveryEnv(scenes, rig, recovery, settings.gamma, seed + done_steps, settings.rebuild)
        running_return = torch.zeros(settings.scenes, device=device)
        random = torch.Generator(device).manual_seed(seed + 1 + done_steps)
        # A run that had learned enough when it was cut off has still learned enough.
        enough = (
            done_steps >= settings.least_steps and bool(curve["success"]) and curve["success"][-1] >= settings.stop_at
        )
        while done_steps < settings.total_steps and not enough:
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
            full = len(finished) == finished.maxlen and done_steps >= settings.least_steps
            enough = full and rate >= settings.stop_at
    _save(checkpoint, net, optimiser, curve)
    return net.cpu().eval(), {"curve": curve}


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
        action = mean + std * torch.randn(mean.shape, generator=random, device=mean.device)
        gained, success, terminated, truncated = env.step(action)
        ended = terminated | truncated
        with torch.no_grad():
            # A time-out is not the end of the world: what would have followed still counts.
            bootstraps.append(torch.where(truncated, net.value(view.observe(env.x)), torch.zeros_like(value)))
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
            env.reset(torch.nonzero(ended).flatten())
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
