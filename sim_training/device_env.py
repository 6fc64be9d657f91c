"""The recovery by pressing in thousands of scenes on a device, judged as everywhere by the failed skill.

A verdict needs a scene in a process of its own, and there are far more actions here than anybody can judge. So what
the model of success claims is rewarded at once, a few of its claims are put to the test between two batches, and the
model learns from those before the next one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from resync_robot.core import spatial
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.learning import recovery_policy as view
from resync_robot.learning.success_model import SuccessModel
from resync_robot.sim_training.failed_worlds import FailedWorlds, lagging
from resync_robot.sim_training.ppo import Environment, PpoSettings
from resync_robot.sim_training.recovery_env import JudgedSettings, RecoveryEnv, Tried
from resync_robot.sim_training.recovery_problem import Problem
from resync_robot.sim_training.shared_env import SharedEnv

DEVICE_SCENES = 4096
PLACES = 8
"""Places between failure and freedom, for each world, that episodes may begin in."""
ASKED = 64
"""Most verdicts after each batch."""
SEEN = 4
"""Most states of a step that are kept to be asked about."""


class Scenes(Protocol):
    """Simulated scenes, one failed world each, whose block and arm can be put anywhere, such as `ManiSkillScenes`.
    Arrays are of shape (count, ...), and of numpy or torch."""

    tasks: Sequence[Task]
    block: Object
    count: int

    @property
    def joints(self) -> Any:
        """(count, 6) measured joint positions."""
        ...

    @property
    def blocks(self) -> Any:
        """(count, 7) poses of the block."""
        ...

    def step(self, q: Any, opening: float = 0.0) -> None:
        """Drive all arms to (count, 6) over one control step."""
        ...

    def reset(self, resets: Sequence[tuple[int, int, Any, Any]]) -> None:
        """Begin anew: (scene, task index, (7,) block pose, (6,) joints) each."""
        ...


class DeviceEnv(Environment):
    """An `Environment` of `ppo` over such scenes, scene i holding task i modulo their number.

    Everything it holds is a tensor on the device of the scenes.

    Args:
        problem: whose starts are in the scenes' tasks, in that order.
        judges: scenes in processes, in which the failed skill can be run; they follow the same model.
        variety: how late an arm is, and where the policy takes over, in training.
    """

    def __init__(
        self,
        problem: Problem,
        model: SuccessModel,
        judges: RecoveryEnv | SharedEnv,
        scenes: Scenes,
        rig: Rig,
        *,
        seed: int,
        gamma: float,
        settings: JudgedSettings,
        variety: view.PressVariety,
    ) -> None:
        self.problem, self.model, self.judges, self.scenes, self.rig = problem, model, judges, scenes, rig
        self.count, self.gamma, self.settings, self.variety = scenes.count, gamma, settings, variety
        measured = scenes.joints
        xp, device = (torch, measured.device) if isinstance(measured, Tensor) else (np, torch.device("cpu"))
        self.worlds = FailedWorlds(scenes.tasks, scenes.block, rig, xp, device)
        self._claims, self._rng = settings.claims(), np.random.default_rng(seed)
        self.random = torch.Generator(device).manual_seed(seed)
        self._everyone = torch.arange(scenes.count, device=device)
        self.task = self._everyone % len(scenes.tasks)
        self._places = torch.as_tensor(self._between(), device=device)
        self.steps = torch.zeros(scenes.count, dtype=torch.long, device=device)
        self.commanded = torch.zeros(scenes.count, 3, device=device)
        self.lag = torch.zeros(scenes.count, device=device)
        self.needed = torch.zeros(scenes.count, device=device)
        self.x = torch.zeros(scenes.count, view.PROJECTED_SIZE, device=device)
        self._kept: list[tuple[int, State, bool]] = []
        self.reset(self._everyone)

    def observe(self) -> Tensor:
        """(count, 19) what the policy sees."""
        return view.observe(self.x)

    def step(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Reward, success, terminated and truncated, each (count,); `x` is then the state to act from."""
        s, before, sent_before = self.settings, self._potential, self.commanded
        self.commanded = view.commanded_tip(self.x, action)
        self.scenes.step(self.worlds.joints_at(lagging(self.commanded, sent_before, self.lag), self.task))
        self.x = self._read(self._everyone)
        self.steps += 1
        self._judge()
        ended = self.steps >= self.problem.stage.horizon
        success = self._likely >= self.needed.clamp(min=self._claims.claimed_from)
        if not self.model.fitted:
            success = torch.zeros_like(success)
        self._keep(success, ended)
        # A potential that is 0 where an episode ends for good leaves the best policy what it is (Ng et al. 1999).
        gained = s.shaping * (self.gamma * torch.where(success, 0.0, self._potential) - before)
        gained = gained + s.success_reward * success - s.step_cost
        return gained, success, success, ended & ~success

    def reset(self, which: Tensor) -> None:
        """Begin new episodes in these scenes: in the failure, or between it and freedom."""
        which = torch.as_tensor(which, device=self.x.device)
        n, task, v = len(which), self.task[which], self.variety
        easier = self._uniform(n) < self.settings.between
        place = torch.where(easier, 1 + (PLACES * self._uniform(n)).long().clamp(max=PLACES - 1), 0)
        poses = self._places[task, place]
        tip = poses[:, :3].float()
        tip[:, :2] += v.aside * (2 * self._uniform(n, 2) - 1)
        height = v.height[0] + (v.height[1] - v.height[0]) * self._uniform(n)
        tip[:, 2] += self.worlds.failures[task][:, view.BLOCK][:, 9] / 2 + view.STUD + height
        q = self.worlds.joints_at(tip, task)
        self.scenes.reset(list(zip(which.tolist(), task.tolist(), self.worlds.array(poses), q, strict=True)))
        self.commanded[which] = tip
        self.lag[which] = v.lag * self._uniform(n)
        worth = self.settings.worth_a_try
        self.needed[which] = worth + max(0.0, self.settings.surest - worth) * self._uniform(n)
        self.steps[which] = 0
        self.x[which] = self._read(which)
        self._judge()

    def learn(self) -> Tried:
        """Put some of what was claimed since the last time to the test; the model learns from it."""
        order = self._rng.permutation(len(self._kept))[:ASKED]
        asked, self._kept = [self._kept[i] for i in order], []
        runs = self.judges.judge_in([(number, state) for number, state, _ in asked])
        for (_, _, claimed), run in zip(asked, runs, strict=True):
            if claimed and run is not None:
                self._claims.heard(run.succeeded)
        learned = self.judges.learn()
        self._claims.reliability = self.model.reliability
        self._judge()
        return learned

    def _between(self) -> Float[np.ndarray, "tasks places 7"]:
        """Poses of the block to begin with, for each task: that of the failure, then others on its way to freedom."""
        block, rows = self.scenes.block, []
        for start in self.problem.starts:
            states = [start.state]
            for _ in range(PLACES):
                free = self.problem.free(int(self._rng.integers(2**31)))
                states.append(start.state if free is None else self.problem.between(start, free, self._rng).state)
            rows.append([state[block][:7] for state in states])
        return np.array(rows)

    def _uniform(self, *shape: int) -> Tensor:
        return torch.rand(*shape, generator=self.random, device=self.x.device)

    def _read(self, which: Tensor) -> Tensor:
        i = self.worlds.index(which)
        joints, blocks = self.scenes.joints[i], self.scenes.blocks[i]
        return self.worlds.states(joints, blocks, self.commanded[which], self.task[which])

    def _judge(self) -> None:
        """What the model says of where everything stands now."""
        seen = self.observe().double().cpu().numpy()
        said = self.model.probability(seen), self.model.potential(seen)
        self._likely, self._potential = (torch.as_tensor(v, dtype=torch.float32, device=self.x.device) for v in said)

    def _keep(self, claimed: Tensor, ended: Tensor) -> None:
        """Remember some of the states that are claimed to be successes, or that end an episode, to ask about them."""
        worth = claimed | (ended & (self._uniform(self.count) < self.settings.judged_ends))
        if not self.model.fitted:
            worth = ended | (self._uniform(self.count) < SEEN / self.count)
        found = torch.nonzero(worth).flatten().cpu().numpy()
        for i in self._rng.permutation(found)[:SEEN].tolist():
            self._kept.append((int(self.task[i]), self._state(i), bool(claimed[i])))

    def _state(self, i: int) -> State:
        """That of scene i, as the judges' simulator takes it."""
        start, robot = self.problem.starts[int(self.task[i])], self.problem.objects[0]
        q = np.asarray(torch.as_tensor(self.scenes.joints[i]).cpu(), dtype=np.float64)
        block = np.asarray(torch.as_tensor(self.scenes.blocks[i]).cpu(), dtype=np.float64)
        tip = spatial.features_from_pose(self.rig.tip_pose(q))
        state = start.state.with_features(self.scenes.block, **_named(self.scenes.block, block))
        return state.with_features(robot, **_named(robot, tip))


def _named(obj: Object, values: np.ndarray) -> dict[str, float]:
    """The first features of an object."""
    return dict(zip(obj.type.features, values.tolist(), strict=False))


@contextmanager
def open_on_device(
    problem: Problem,
    model: SuccessModel,
    judges: RecoveryEnv | SharedEnv,
    seed: int,
    ppo: PpoSettings,
    judged: JudgedSettings,
    *,
    make: Callable[[Sequence[Task], Object, Rig, int, str], AbstractContextManager[Scenes]],
    rig: Rig,
    device: str,
) -> Iterator[DeviceEnv]:
    """The scenes of a stage on a device. Raises TrainingError where it cannot hold them.

    Args:
        make: (tasks, the block, the rig, how many scenes, the device) -> the scenes.
    """
    tasks = [start.task for start in problem.starts]
    with make(tasks, problem.explanation.relevant, rig, ppo.scenes, device) as scenes:
        yield DeviceEnv(
            problem,
            model,
            judges,
            scenes,
            rig,
            seed=seed,
            gamma=ppo.gamma,
            settings=judged,
            variety=view.PressVariety(),
        )


def scaled_to_device(settings: PpoSettings) -> PpoSettings:
    """The same training in thousands of scenes: larger batches, and a budget that lets as many updates happen."""
    more = DEVICE_SCENES // settings.scenes
    return replace(
        settings,
        scenes=DEVICE_SCENES,
        minibatch=settings.minibatch * more // 4,
        total_steps=settings.total_steps * more // 4,
        least_steps=settings.least_steps * more // 4,
        plateau=settings.plateau * more // 4,
        anneal_steps=settings.anneal_steps * more // 4,
    )
