"""The recovery MDP of any domain (section 3.1): begins where a skill failed, ends by the planner's verdict.

An episode begins in a state from which a skill failed, and has succeeded where the failed skill, run from there,
reaches its effects. Nothing else says what recovered means. Running the skill is dear, so a model of where it succeeds
gives the reward and says when a run is worth its time; the model learns from each run, and as long as runs confirm
what it claims, most of its claims are believed. Episodes also begin between failure and freedom, and on the way of
earlier successes, so that success is found early.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from resync_robot.core.errors import TrainingError
from resync_robot.core.state import State
from resync_robot.learning.recovery_policy import ActorCritic
from resync_robot.learning.success_model import SuccessModel
from resync_robot.sim_training.claims import Claims
from resync_robot.sim_training.ppo import Environment
from resync_robot.sim_training.recovery_episodes import Episodes, Scene
from resync_robot.sim_training.recovery_problem import Problem


@dataclass(frozen=True)
class Try:
    """One run of the failed skill: the state that it began in, what the recovery sees of it, how it ended, and whether
    nothing obstructed it."""

    state: State
    features: Float[np.ndarray, " d"]
    succeeded: bool
    free: bool = False


Tried = list[Try]


@dataclass(frozen=True, kw_only=True)
class JudgedSettings:
    """The reward, and how often the planner is asked."""

    shaping: float = 3.0
    """Reward for going from certain failure to certain success, as the model sees it; 0: the verdict alone."""
    success_reward: float = 5.0
    step_cost: float = 0.01
    worth_a_try: float = 0.8
    """Probability of success from which on a state counts as a claim: the failed skill is run to see..."""
    confirmed: float = 0.95
    """...and share of claims that are to hold: each that does not raises that probability, each that does lowers it
    again a little."""
    surest: float = 0.0
    """An episode may need more: up to this, drawn anew for each. A policy whose episodes all end on one line comes to
    rest on it, and whoever sees that line a little wrong stops short of it."""
    patience: int = 3
    """Actions after a run that failed until the next one in the same episode."""
    believed: float = 0.75
    """Share of claims that runs confirmed lately, from which on most are believed without a run..."""
    checked: float = 0.1
    """...but for this share."""
    verdicts: float = 0.2
    """Most runs of the failed skill for each action that is taken, while the model can be asked instead."""
    judged_ends: float = 0.2
    """Share of the episodes that run out of time whose end is judged all the same: what the model is sure of is
    what it never learns otherwise."""
    between: float = 0.5
    """Share of episodes that begin between failure and freedom, or where an earlier one passed on its way to
    success."""
    kept: int = 512
    """How many such states are kept of either kind, and scenes."""

    def claims(self) -> Claims:
        """None was made yet."""
        return Claims(self.worth_a_try, self.confirmed, self.believed)

    def needed(self, rng: np.random.Generator) -> float:
        """The probability of success that a new episode needs at least to be over."""
        return float(rng.uniform(self.worth_a_try, self.surest)) if self.surest > self.worth_a_try else self.worth_a_try


AT_ONCE = 50
"""Runs that are allowed before there was any action."""
STUMBLES = 8
"""Most actions at random before one of the first attempts: what an episode passes looks other than where it begins."""
BEYOND = 4
"""Actions that a roll-out goes on for where the model is sure of success."""


def teach(model: SuccessModel, runs: Tried) -> None:
    """Fit the model anew to all that it remembers, and these runs."""
    if runs:
        model.add_free(np.array([run.succeeded for run in runs if run.free], dtype=bool))
        model.add(np.stack([run.features for run in runs]), np.array([run.succeeded for run in runs]))
    # As long as all attempts end alike, every state is worth one.
    if model.has_both:
        model.fit()


class RecoveryEnv(Environment):
    """Scenes of one failure, stepped one after the other in this process: an `Environment` of `ppo`.

    Args:
        count: scenes.
        own: the problem's starts, by number, that its own episodes begin in; None: all of them.

    Raises:
        TrainingError: there is nowhere to begin.
    """

    def __init__(
        self,
        problem: Problem,
        model: SuccessModel,
        *,
        count: int,
        seed: int,
        gamma: float = 0.98,
        settings: JudgedSettings | None = None,
        own: Sequence[int] | None = None,
    ) -> None:
        if not problem.starts:
            raise TrainingError("there is no state in which the skill failed: mine failures first")
        self.problem, self.model, self.count, self.gamma = problem, model, count, gamma
        self.settings = settings or JudgedSettings()
        self._judge, self._rng = problem.judge, np.random.default_rng(seed)
        self._own = [problem.starts[i] for i in own or range(len(problem.starts))]
        self._episodes = Episodes(problem, self._own, self._rng, self.settings.between, self.settings.kept)
        self._tried: Tried = []
        self._claims = self.settings.claims()
        self._allowed = float(AT_ONCE)
        self.judged = 0
        self._scenes = [self._begun() for _ in range(count)]
        self._look(range(count), first=True)

    # -- an environment for PPO ----------------------------------------------------------------------------------------

    def observe(self) -> Tensor:
        """(count, d) what the policy sees."""
        return torch.as_tensor(self._features, dtype=torch.float32)

    def step(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Take (count, k) actions in [-1, 1]. Reward, success, terminated and truncated."""
        s = self.settings
        self._episodes.move(self._scenes, action.double().numpy())
        before = self._potential
        self._look(range(self.count))
        self._allowed += self.count * self.settings.verdicts
        ended = np.array([scene.steps >= self.problem.stage.horizon for scene in self._scenes])
        success = self._ask(ended)
        # A potential that is 0 where an episode ends for good leaves the best policy what it is (Ng et al. 1999).
        gained = s.shaping * (self.gamma * np.where(success, 0.0, self._potential) - before)
        gained += s.success_reward * success - s.step_cost
        self._remember_ways(success)
        return (
            torch.as_tensor(gained, dtype=torch.float32),
            torch.as_tensor(success),
            torch.as_tensor(success),
            torch.as_tensor(ended & ~success),
        )

    def reset(self, which: Tensor) -> None:
        """Begin new episodes."""
        for i in which.tolist():
            self._episodes.end(self._scenes[i])
            self._scenes[i] = self._begun()
        self._look(which.tolist())

    def learn(self) -> Tried:
        """The model learns from the runs since the last time, of all scenes; these runs."""
        runs = self.taken()
        teach(self.model, runs)
        self.follow(self.model)
        return runs

    def taken(self) -> Tried:
        """The runs of the failed skill since the last time that somebody asked."""
        tried, self._tried = self._tried, []
        return tried

    def follow(self, model: SuccessModel) -> None:
        """Rewards are those of `model` from here on."""
        self.model, self._claims.reliability = model, model.reliability
        self._judge_features(range(self.count))

    # -- what the model is fitted to first, and the terminal function in the end ---------------------------------------

    def attempt(self, count: int) -> None:
        """Run the failed skill from failures, from states where nothing obstructs, and twice as often from states
        between the two, every second time after a few actions at random; `taken` tells how it went. Where it fails
        between, episodes can begin."""
        for i in range(count):
            kind = i // 2 % 4
            failed = self._own[int(self._rng.integers(len(self._own)))]
            free = self.problem.free(int(self._rng.integers(2**31))) if kind else None
            start = failed if free is None else free if kind == 1 else self.problem.between(failed, free, self._rng)
            scene = self._episodes.begin_in(start.task, start.state)
            if scene is None:
                continue
            snapshot, stumbles = scene.simulator.save(), int(self._rng.integers(STUMBLES)) if i % 2 else 0
            for _ in range(stumbles):
                self._episodes.move([scene], self._rng.uniform(-1, 1, (1, self.problem.interface.actions)))
            undisturbed = start is free and not stumbles
            if not self._verdict(scene, self._episodes.see([scene])[0], undisturbed) and start is not failed:
                self._episodes.keep(self._episodes.between, start.task, snapshot)
            self._episodes.end(scene)

    def judge_in(self, asked: Sequence[tuple[int, State]]) -> list[Try | None]:
        """Run the failed skill from states that another simulator reached; `taken` tells of these runs as well.

        Args:
            asked: for each the number of the problem's start in whose task it lies, and the state.

        Returns:
            In the same order; None where the state does not stand here.
        """
        found: list[Try | None] = []
        for number, state in asked:
            scene = self._episodes.begin_in(self.problem.starts[number].task, state, approach=False)
            if scene is None:
                found.append(None)
                continue
            self._verdict(scene, self._episodes.see([scene])[0])
            found.append(self._tried[-1])
            self._episodes.end(scene)
        return found

    def roll_out(self, net: ActorCritic, count: int) -> Tried:
        """Verdicts along episodes of a policy, and a little beyond success: each time halfway between the last state
        that is known to fail and the first that is known to succeed."""
        found: Tried = []
        for _ in range(count):
            scene = self._episodes.begin()
            way, sure = [], 0
            while True:
                seen = self._episodes.see([scene])
                way.append((scene.simulator.save(), scene.state, seen[0]))
                sure += float(self.model.probability(seen)[0]) >= self._claims.claimed_from
                if len(way) > self.problem.stage.horizon or sure > BEYOND:
                    break
                with torch.no_grad():
                    action = net.act(torch.as_tensor(seen, dtype=torch.float32)).double().numpy()
                self._episodes.move([scene], action)
            fails, succeeds = -1, len(way)
            while succeeds - fails > 1:
                middle = (fails + succeeds) // 2
                snapshot, state, features = way[middle]
                scene.simulator.restore(snapshot)
                verdict = self._judge(scene.simulator, scene.task.initial)
                found.append(Try(state, features, verdict))
                fails, succeeds = (fails, middle) if verdict else (middle, succeeds)
            self._episodes.end(scene)
        self.judged += len(found)
        return found

    # -- episodes ------------------------------------------------------------------------------------------------------

    def _ask(self, ended: Bool[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
        """Where the failed skill succeeds: by a run, where it is worth one, or by the model, where that can be
        believed."""
        s, success = self.settings, np.zeros(self.count, dtype=bool)
        for i, scene in enumerate(self._scenes):
            claimed = self._likely[i] >= max(scene.needed, self._claims.claimed_from) or not self.model.fitted
            claimed &= scene.rested >= s.patience
            # Without shaping nothing but verdicts counts.
            if claimed and s.shaping > 0 and self._claims.believed and self._rng.random() >= s.checked:
                success[i] = True
            elif (claimed or (ended[i] and self._rng.random() < s.judged_ends)) and (
                not s.shaping or self._allowed > 0
            ):
                success[i] = self._verdict(scene, self._features[i])
                self._allowed -= 1
                scene.rested = 0
                self._episodes.limit(scene.simulator)
                if claimed:
                    self._claims.heard(bool(success[i]))
        return success

    def _verdict(self, scene: Scene, features: Float[np.ndarray, " d"], free: bool = False) -> bool:
        succeeded = self._judge(scene.simulator, scene.task.initial)
        self.judged += 1
        self._tried.append(Try(scene.state, features.copy(), succeeded, free))
        return succeeded

    def _remember_ways(self, success: Bool[np.ndarray, "n"]) -> None:
        if self.settings.between <= 0:
            return
        for i, scene in enumerate(self._scenes):
            scene.way.append(scene.simulator.save())
            if success[i]:
                snapshot = scene.way[int(self._rng.integers(len(scene.way)))]
                self._episodes.keep(self._episodes.passed, scene.task, snapshot)

    def _begun(self) -> Scene:
        """A new episode, in which the skill can be run at once."""
        scene = self._episodes.begin()
        scene.rested, scene.needed = self.settings.patience, self.settings.needed(self._rng)
        return scene

    def _look(self, which: Sequence[int], first: bool = False) -> None:
        """See these scenes anew."""
        if not len(which):
            return
        seen = self._episodes.see([self._scenes[i] for i in which])
        if first:
            self._features = np.array(seen, dtype=np.float64)
            self._likely, self._potential = np.zeros(self.count), np.zeros(self.count)
        self._features[list(which)] = seen
        self._judge_features(which)

    def _judge_features(self, which: Sequence[int]) -> None:
        # New arrays: the ones before are the potentials that rewards compare with.
        self._likely, self._potential = self._likely.copy(), self._potential.copy()
        self._likely[list(which)] = self.model.probability(self._features[list(which)])
        self._potential[list(which)] = self.model.potential(self._features[list(which)])
