"""The recovery of a cornered block, learned by PPO with a reward written by hand: its scenes and its training."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import torch
from torch import Tensor

from resync_robot.core.rig import Rig
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.learning import recovery_policy as view
from resync_robot.learning.recovery_policy import ActorCritic
from resync_robot.sim_training.ppo import PpoSettings, Progress, train_policy
from resync_robot.sim_training.recovery import FailedWorlds, RecoverySettings, lagging, reward
from resync_robot.sim_training.vector_env import RecoveryScenes

if TYPE_CHECKING:
    from resync_robot.sim_training.domains.cornered_insertion_s.maniskill_env import ManiSkillScenes


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
        self.count = scenes.count
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

    def observe(self) -> Tensor:
        """(count, 19) what the policy sees."""
        return view.observe(self.x)

    def learn(self) -> None:
        """Its reward is given."""

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
    from resync_robot.sim_training.domains.cornered_insertion_s.maniskill_env import (
        ManiSkillScenes,  # its import takes seconds
    )

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
    progress: Progress,
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

    @contextmanager
    def open_environment(done_steps: int) -> Iterator[RecoveryEnv]:
        with _make_scenes(tasks, block, rig, settings.scenes, workers, device) as scenes:
            yield RecoveryEnv(scenes, rig, recovery, settings.gamma, seed + done_steps, settings.rebuild)

    curve = train_policy(net, open_environment, settings, seed, checkpoint, progress)
    return net.cpu().eval(), {"curve": curve}
