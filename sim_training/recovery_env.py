"""The recovery MDP of any domain (section 3.1): begins where a skill failed, ends by the planner's verdict.

An episode begins in a state from which a skill failed, acts in the embodiment's own actions, and has succeeded where
the failed skill, run from there, reaches its effects. Nothing else says what recovered means. Running the skill is
dear, so a model of where it succeeds gives the reward and says when a run is worth its time; the run has the last word,
and the model learns from each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from resync_robot.core.embodiment import Embodiment, TrainingSimulator
from resync_robot.core.errors import TrainingError
from resync_robot.core.skill import GroundSkill
from resync_robot.core.state import State
from resync_robot.core.symbols import Atoms
from resync_robot.core.task import Task
from resync_robot.learning.success_model import SuccessModel
from resync_robot.planning.execute import run_skill


@dataclass(frozen=True, kw_only=True)
class JudgedSettings:
    """The reward, and how often the planner is asked."""

    shaping: float = 3.0
    """Reward for going from certain failure to certain success, as the model sees it; 0: the verdict alone."""
    success_reward: float = 5.0
    step_cost: float = 0.01
    worth_a_try: float = 0.5
    """Probability of success from which on the failed skill is run to see."""
    patience: int = 5
    """Actions after a run that failed until the next one in the same episode."""
    judged_ends: float = 0.5
    """Share of the episodes that run out of time whose end is judged all the same: what the model is sure of is
    what it never learns otherwise."""
    between: float = 0.5
    """Share of episodes that begin where an earlier one passed on its way to success."""
    passed: int = 512
    """How many such states are kept."""


@dataclass(frozen=True)
class Judge:
    """Says whether the failed skill succeeds now; leaves the simulator as it was.

    Attributes:
        failed: the skill that failed, with its objects.
        effects: what holds once it has succeeded.
        true_atoms: the atoms of a state, by the given predicates.
    """

    failed: GroundSkill
    effects: Atoms
    true_atoms: Callable[[State], Atoms]

    def __call__(self, simulator: TrainingSimulator) -> bool:
        before = simulator.save()
        run_skill(simulator, self.failed)
        succeeded = self.effects <= self.true_atoms(simulator.perceive())
        simulator.restore(before)
        return succeeded


@dataclass(frozen=True)
class Start:
    """Where an episode may begin: a task, and the state in which its skill had failed."""

    task: Task
    state: State


@dataclass
class _Scene:
    task: Task
    simulator: TrainingSimulator
    steps: int = 0
    rested: int = 0
    """Actions since the planner was asked last."""
    way: list[tuple[Any, float]] | None = None
    """Snapshots along this episode, each with the probability of success there."""


def try_from(
    embodiment: Embodiment, starts: Sequence[Start], judge: Judge, see: Callable[[State], Float[np.ndarray, " d"]]
) -> tuple[Float[np.ndarray, "n d"], Bool[np.ndarray, "n"]]:
    """Attempts of the failed skill from each start that stands still: what a success model is fitted to first.

    Returns:
        The features that the attempts began with, and whether they succeeded.

    Raises:
        TrainingError: no start stands still.
    """
    features, succeeded = [], []
    for start in starts:
        simulator: TrainingSimulator = embodiment.simulate(start.task)
        if simulator.reset(start.state):
            features.append(see(simulator.observe(live=True).state))
            succeeded.append(judge(simulator))
    if not features:
        raise TrainingError(f"none of {len(starts)} states stands still in the simulator", "check-domain tells more")
    return np.stack(features), np.array(succeeded)


def teach(model: SuccessModel, tried: Sequence[Sequence[tuple[Float[np.ndarray, " d"], bool]]]) -> None:
    """Fit the model anew to all that it remembers, and these runs."""
    runs = [run for some in tried for run in some]
    if runs:
        model.add(np.stack([x for x, _ in runs]), np.array([y for _, y in runs]))
    # As long as all attempts end alike, every state is worth one.
    if model.has_both:
        model.fit()


class RecoveryEnv:
    """Scenes of one failure, stepped one after the other in this process: an `Environment` of `ppo`.

    Args:
        see: a state -> the relational features of what the recovery is about, which the policy and the model see.
        count: scenes.
        horizon: actions after which an episode ends.

    Raises:
        TrainingError: there is nowhere to begin.
    """

    def __init__(
        self,
        embodiment: Embodiment,
        starts: Sequence[Start],
        judge: Judge,
        see: Callable[[State], Float[np.ndarray, " d"]],
        model: SuccessModel,
        *,
        count: int,
        horizon: int,
        seed: int,
        gamma: float = 0.98,
        settings: JudgedSettings | None = None,
    ) -> None:
        if not starts:
            raise TrainingError("there is no state in which the skill failed: mine failures first")
        self.count, self.horizon, self.gamma = count, horizon, gamma
        self.settings = settings or JudgedSettings()
        self._embodiment, self._starts, self._judge, self._see, self.model = embodiment, starts, judge, see, model
        limits = np.array(list(embodiment.actions.values()))
        self._middle, self._half = limits.mean(1), (limits[:, 1] - limits[:, 0]) / 2
        self._rng = np.random.default_rng(seed)
        self._passed: list[tuple[Task, Any]] = []
        self._tried: list[tuple[np.ndarray, bool]] = []
        self._scenes = [self._open(starts[int(self._rng.integers(len(starts)))]) for _ in range(count)]
        self._features = np.stack([self._look(scene) for scene in self._scenes])
        self._likely = self.model.probability(self._features)
        self.judged = 0

    # -- an environment for PPO ----------------------------------------------------------------------------------------

    def observe(self) -> Tensor:
        """(count, d) relational features."""
        return torch.as_tensor(self._features, dtype=torch.float32)

    def step(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Take (count, k) actions in [-1, 1], scaled to the embodiment's. Reward, success, terminated and truncated."""
        s = self.settings
        sent = self._middle + self._half * action.clamp(-1, 1).double().numpy()
        for scene, vector in zip(self._scenes, sent, strict=True):
            scene.simulator.act(vector, 1.0 / self._embodiment.rate_hz)
            scene.steps += 1
            scene.rested += 1
        self._features = np.stack([self._look(scene) for scene in self._scenes])
        before, self._likely = self._likely, self.model.probability(self._features)
        ended = np.array([scene.steps >= self.horizon for scene in self._scenes])
        success = self._ask(ended)
        # A potential that is 0 where an episode ends for good leaves the best policy what it is (Ng et al. 1999).
        gained = s.shaping * (self.gamma * np.where(success, 0.0, self._likely) - before)
        gained += s.success_reward * success - s.step_cost
        self._remember_ways(success)
        return (
            torch.as_tensor(gained, dtype=torch.float32),
            torch.as_tensor(success),
            torch.as_tensor(success),
            torch.as_tensor(ended & ~success),
        )

    def reset(self, which: Tensor) -> None:
        """Begin new episodes, in states of failures or on the way of episodes that ended well."""
        for i in which.tolist():
            if self._passed and self._rng.random() < self.settings.between:
                task, snapshot = self._passed[int(self._rng.integers(len(self._passed)))]
                scene = self._scenes[i] = self._renewed(self._scenes[i], task)
                scene.simulator.restore(snapshot)
            else:
                start = self._starts[int(self._rng.integers(len(self._starts)))]
                scene = self._scenes[i] = self._renewed(self._scenes[i], start.task)
                scene.simulator.reset(start.state)
            self._features[i] = self._look(scene)
        self._likely = self.model.probability(self._features)

    def learn(self) -> None:
        """The model learns from the runs since the last time, of all scenes."""
        teach(self.model, [self.taken()])
        self.follow(self.model)

    def taken(self) -> list[tuple[Float[np.ndarray, " d"], bool]]:
        """The runs of the failed skill since the last time that somebody asked: where each began, and how it ended."""
        tried, self._tried = self._tried, []
        return tried

    def follow(self, model: SuccessModel) -> None:
        """Rewards are those of `model` from here on."""
        self.model = model
        self._likely = model.probability(self._features)

    # ------------------------------------------------------------------------------------------------------------------

    def _ask(self, ended: Bool[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
        """Run the failed skill where it is worth a try. Returns where it succeeded."""
        s, success = self.settings, np.zeros(self.count, dtype=bool)
        for i, scene in enumerate(self._scenes):
            hopeful = self._likely[i] >= s.worth_a_try and scene.rested >= s.patience
            if hopeful or (ended[i] and self._rng.random() < s.judged_ends):
                success[i] = self._judge(scene.simulator)
                scene.rested = 0
                self.judged += 1
                self._tried.append((self._features[i].copy(), bool(success[i])))
        return success

    def _remember_ways(self, success: Bool[np.ndarray, "n"]) -> None:
        for i, scene in enumerate(self._scenes):
            if scene.way is not None:
                scene.way.append((scene.simulator.save(), float(self._likely[i])))
            if success[i] and scene.way:
                snapshot, _ = scene.way[int(self._rng.integers(len(scene.way)))]
                self._passed.append((scene.task, snapshot))
                if len(self._passed) > self.settings.passed:
                    self._passed.pop(int(self._rng.integers(len(self._passed))))

    def _open(self, start: Start) -> _Scene:
        simulator: TrainingSimulator = self._embodiment.simulate(start.task)
        simulator.reset(start.state)
        return _Scene(start.task, simulator, way=[] if self.settings.between > 0 else None)

    def _renewed(self, scene: _Scene, task: Task) -> _Scene:
        simulator = scene.simulator if scene.task is task else self._embodiment.simulate(task)
        return _Scene(task, simulator, way=[] if self.settings.between > 0 else None)

    def _look(self, scene: _Scene) -> Float[np.ndarray, " d"]:
        return self._see(scene.simulator.observe(live=True).state)
