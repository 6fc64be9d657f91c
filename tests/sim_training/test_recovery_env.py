"""The recovery MDP that only the planner judges: what it rewards, where it begins, and that PPO learns in it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from resync_robot.core.errors import TrainingError
from resync_robot.learning.recovery_policy import ActorCritic
from resync_robot.learning.success_model import SuccessModel
from resync_robot.sim_training.claims import LATELY
from resync_robot.sim_training.ppo import PpoSettings, train_policy
from resync_robot.sim_training.recovery_env import AT_ONCE, JudgedSettings, RecoveryEnv
from resync_robot.sim_training.recovery_problem import Start
from resync_robot.sim_training.shared_env import SharedEnv
from tests.sim_training.sliding import GRIP, HELD, JUDGE, Rail, S, attempts, problem, see, task_at


def failing(count: int, seed: int = 0) -> list[Start]:
    rng = np.random.default_rng(seed)
    tasks = [task_at(0.0, rng.uniform(0.1, 0.3)) for _ in range(count)]
    return [Start(t, t.initial) for t in tasks]


def anywhere(count: int, seed: int = 1) -> list[Start]:
    rng = np.random.default_rng(seed)
    tasks = [task_at(*sorted(rng.uniform(0, 1, 2))) for _ in range(count)]
    return [Start(t, t.initial) for t in tasks]


def environment(model: SuccessModel, count: int = 8, **settings: float) -> RecoveryEnv:
    chosen = JudgedSettings(worth_a_try=0.5, judged_ends=0.5)
    return RecoveryEnv(problem(failing(16)), model, count=count, seed=3, settings=replace(chosen, **settings))  # type: ignore[arg-type]


def test_the_judge_runs_the_skill_and_leaves_everything_as_it_was() -> None:
    for slider, succeeds in ((0.2, False), (0.6, True), (0.9, False)):
        rail = Rail(task_at(0.0, slider))
        before = rail.save()
        assert JUDGE(rail, rail.perceive()) == succeeds  # type: ignore[arg-type]
        np.testing.assert_array_equal(rail.save(), before)


class _Near(Rail):
    """The slider can be gripped only from nearby."""

    def act(self, target: Any, duration: float) -> None:
        if target is GRIP and self.x[1] - self.x[0] > 0.2:
            return
        super().act(target, duration)


def test_a_failure_that_is_only_passed_by_is_not_mended() -> None:
    """The skill would fail again, were the robot where it set out; unless it cannot have been there."""
    strict, here, begun = replace(JUDGE, wherever=True), _Near(task_at(0.55, 0.6)), task_at(0.0, 0.6).initial
    before = here.save()
    assert JUDGE(here, begun) and not strict(here, begun)  # type: ignore[arg-type]
    assert strict(here, task_at(0.5, 0.6).initial)  # type: ignore[arg-type]
    # Beyond the slider no robot can stand, and without a slider in its hand this one cannot have begun.
    assert strict(here, task_at(0.9, 0.6).initial)  # type: ignore[arg-type]
    assert replace(strict, needs=frozenset({HELD(S)}))(here, begun)  # type: ignore[arg-type]
    np.testing.assert_array_equal(here.save(), before)


def test_attempts_tell_the_model_where_the_skill_succeeds() -> None:
    features, succeeded = attempts(anywhere(300))
    assert 0.1 < succeeded.mean() < 0.5
    model = SuccessModel(2, 0)
    model.add(features, succeeded)
    model.fit()
    fresh, truth = attempts(anywhere(300, seed=2))
    assert ((model.probability(fresh) > 0.5) == truth).mean() > 0.9


def test_a_model_that_knows_one_outcome_refuses_to_guess() -> None:
    model = SuccessModel(2, 0)
    np.testing.assert_array_equal(model.probability(np.zeros((3, 2))), 0.5)
    model.add(np.zeros((5, 2)), np.zeros(5, dtype=bool))
    with pytest.raises(TrainingError, match="all 5 attempts failed"):
        model.fit()


def test_weights_travel() -> None:
    features, succeeded = attempts(anywhere(100))
    model, copy = SuccessModel(2, 0), SuccessModel(2, 1)
    model.add(features, succeeded)
    model.fit()
    copy.load(model.weights())
    np.testing.assert_array_equal(copy.probability(features), model.probability(features))


def test_success_is_what_the_skill_says_and_not_what_the_model_believes() -> None:
    """A model that is sure of success everywhere is refuted at each try, and learns from it."""
    model = SuccessModel(2, 0)
    model.add(np.random.default_rng(0).normal(size=(50, 2)), np.arange(50) % 50 > 0)
    model.fit()
    env = environment(model, worth_a_try=0.0, between=0.0)
    still = torch.zeros(env.count, 1)
    for _ in range(6):
        _, success, terminated, truncated = env.step(still)
        assert not (success | terminated | truncated).any()
    assert env.judged == 2 * env.count, "at once, and again after five actions"
    before = model.attempts
    env.learn()
    assert model.attempts == before + 2 * env.count


def test_rewards_of_an_episode_add_up_to_where_it_went() -> None:
    """Shaping only moves reward about: with gamma 1, an episode's sum tells its first potential and its success."""
    features, succeeded = attempts(anywhere(300))
    model = SuccessModel(2, 0)
    model.add(features, succeeded)
    model.fit()
    env = environment(model, between=0.0, patience=1, worth_a_try=0.3)
    env.gamma, s = 1.0, env.settings
    first = model.potential(env.observe().numpy().astype(float))
    total, done, steps = np.zeros(env.count), np.zeros(env.count, dtype=bool), np.zeros(env.count)
    for _ in range(20):
        gained, success, _, _ = env.step(torch.full((env.count, 1), 0.5))
        total += np.where(done, 0, gained.numpy())
        steps += ~done
        done |= success.numpy()
    assert done.all()
    np.testing.assert_allclose(total, s.success_reward - s.shaping * first - s.step_cost * steps, atol=1e-5)


def test_time_out_ends_an_episode_and_some_begin_on_the_way_of_a_success() -> None:
    env = environment(SuccessModel(2, 0), between=1.0)
    for _ in range(20):
        _, success, _, truncated = env.step(torch.full((env.count, 1), 0.5))
        env.reset(torch.nonzero(success | truncated).flatten())
    later = environment(SuccessModel(2, 0))
    for _ in range(19):
        assert not later.step(torch.full((later.count, 1), -1.0))[3].any()
    assert later.step(torch.full((later.count, 1), -1.0))[3].all()
    assert (env.observe()[:, 0] > 0.31).any()


def knowing() -> SuccessModel:
    model = SuccessModel(2, 0)
    model.add(*attempts(anywhere(300)))
    model.fit()
    return model


def pushed(env: RecoveryEnv, steps: int) -> int:
    """How many episodes of pushing the slider along succeed."""
    succeeded = 0
    for _ in range(steps):
        _, success, _, truncated = env.step(torch.full((env.count, 1), 0.5))
        succeeded += int(success.sum())
        env.reset(torch.nonzero(success | truncated).flatten())
    return succeeded


def test_claims_are_believed_while_verdicts_confirm_them() -> None:
    trusting = environment(knowing(), worth_a_try=0.8, between=0.0)
    believed = pushed(trusting, 150)
    doubting = environment(knowing(), worth_a_try=0.8, between=0.0, believed=1.1)
    assert pushed(doubting, 150) <= doubting.judged
    assert LATELY < trusting.judged < 0.7 * believed
    alone = environment(knowing(), worth_a_try=0.8, between=0.0, shaping=0.0)
    assert pushed(alone, 150) <= alone.judged, "without shaping, verdicts alone count"


@pytest.mark.parametrize("surest", [0.0, 0.9])
def test_each_episode_draws_how_likely_success_has_to_be(surest: float) -> None:
    env = environment(knowing(), worth_a_try=0.3, surest=surest, between=0.0, patience=1, judged_ends=0.0)
    env._judge = lambda *_: True
    likely = []
    for _ in range(150):
        _, success, _, truncated = env.step(torch.full((env.count, 1), 0.35))
        likely += env._likely[success.numpy()].tolist()
        env.reset(torch.nonzero(success | truncated).flatten())
    assert len(likely) > 20
    # Steps are small, so without a draw all end where 0.3 was just passed.
    assert min(likely) >= 0.3
    assert (np.quantile(likely, 0.9) > 0.7) == (surest > 0), np.quantile(likely, 0.9)


def test_a_model_that_is_refuted_is_not_believed() -> None:
    wrong = SuccessModel(2, 0)
    x = np.random.default_rng(0).normal(size=(400, 2))
    wrong.add(x, np.arange(400) % 400 > 0)
    wrong.fit()
    env = environment(wrong, worth_a_try=0.0, between=0.0, patience=1)
    for _ in range(19):
        success = env.step(torch.zeros(env.count, 1))[1]
        assert not success.any()


def test_runs_are_rationed() -> None:
    env = environment(knowing(), believed=1.1, between=0.0, verdicts=0.0)
    pushed(env, 200)
    assert env.judged == AT_ONCE
    env = environment(knowing(), believed=1.1, between=0.0, verdicts=0.01)
    pushed(env, 200)
    assert env.judged == AT_ONCE + 0.01 * 200 * env.count


def test_the_potential_climbs_where_probabilities_are_flat() -> None:
    model, far = knowing(), np.array([[x, 0.2] for x in (0.0, 0.15, 0.3, 0.45)])
    assert (np.diff(model.potential(far)) > 0.01).all()
    assert model.probability(far[:2]).max() < 0.1


def test_verdicts_of_a_roll_out_close_in_on_where_it_begins_to_succeed() -> None:
    class Push:
        def act(self, seen: torch.Tensor) -> torch.Tensor:
            return torch.full((len(seen), 1), 0.5)

    env = environment(knowing(), worth_a_try=0.8, between=0.0)
    runs = env.roll_out(Push(), 6)  # type: ignore[arg-type]
    assert 12 <= len(runs) <= 36 and env.judged == len(runs)
    where = {yes: [run.state[S][0] for run in runs if run.succeeded == yes] for yes in (False, True)}
    assert all(0.5 < x < 0.8 for x in where[True]) and not any(0.5 < x < 0.8 for x in where[False])
    assert min(where[True]) - max(where[False]) < 0.051


def test_first_attempts_begin_in_failures_and_a_few_actions_on() -> None:
    env = environment(SuccessModel(2, 0))
    env.attempt(40)
    runs = env.learn()
    assert len(runs) == 40 == env.judged and not any(run.succeeded for run in runs)
    begun = {tuple(see(start.state)) for start in failing(16)}
    assert 20 <= sum(tuple(run.features) in begun for run in runs) < 40


def test_nowhere_to_begin_is_an_error() -> None:
    with pytest.raises(TrainingError, match="mine failures first"):
        RecoveryEnv(problem([]), SuccessModel(2, 0), count=1, seed=0)


@pytest.mark.parametrize(("shaping", "while_exploring"), [(3.0, 0.9), (0.0, 0.7)])
def test_ppo_learns_to_recover_by_the_verdict(shaping: float, while_exploring: float, tmp_path: Path) -> None:
    """With what the model knows of the skill, and with the verdict alone."""
    model = SuccessModel(2, 0)
    if shaping:
        model.add(*attempts(anywhere(200)))
        model.fit()

    @contextmanager
    def opened(done: int) -> Iterator[RecoveryEnv]:
        yield environment(model, count=32, shaping=shaping)

    torch.manual_seed(0)
    net = ActorCritic(width=32, depth=2, observations=2, actions=1)
    settings = PpoSettings(
        scenes=32, steps=16, total_steps=20_000, least_steps=4_000, minibatch=128, anneal_steps=8_000, stop_at=0.95
    )
    curve = train_policy(net, opened, settings, 0, tmp_path / "ppo.safetensors", lambda *_: None)
    assert curve["success"][-1] >= while_exploring
    # And in fresh failures, without noise, judged by the skill itself.
    recovered = 0
    for start in failing(20, seed=9):
        rail = Rail(start.task)
        for _ in range(20):
            with torch.no_grad():
                action = net.act(torch.as_tensor(see(rail.perceive()), dtype=torch.float32)[None])
            rail.act(0.1 * action.clamp(-1, 1).numpy()[0], 0.1)
            if JUDGE(rail, rail.perceive()):  # type: ignore[arg-type]
                recovered += 1
                break
    assert recovered >= 18


def _part(number: int, count: int) -> RecoveryEnv:
    return environment(SuccessModel(2, number), count=count)


def _no_part(number: int, count: int) -> RecoveryEnv:
    raise TrainingError("the simulator is broken")


def test_processes_step_as_one_environment_and_follow_one_model() -> None:
    model = SuccessModel(2, 0)
    model.add(*attempts(anywhere(200)))
    model.fit()
    action = torch.linspace(-1, 1, 6)[:, None]
    alone = environment(SuccessModel(2, 0), count=3)
    alone.model.load(model.weights())
    alone.follow(alone.model)
    with SharedEnv(_part, model, 6, 2) as env:
        np.testing.assert_array_equal(env.observe()[:3], alone.observe())
        for _ in range(25):
            told, mine = env.step(action), alone.step(action[:3])
            for column, own in zip(told, mine, strict=True):
                np.testing.assert_allclose(column[:3], own)
            over = torch.nonzero(told[2] | told[3]).flatten()
            env.reset(over)
            alone.reset(over[over < 3])
            np.testing.assert_array_equal(env.observe()[:3], alone.observe())
        before = model.attempts
        env.learn()
        assert model.attempts > before


def test_shared_out_scenes_are_rolled_as_they_are_alone() -> None:
    net, random = ActorCritic(8, 1, 2, 1), torch.Generator().manual_seed(4)
    model = SuccessModel(2, 0)
    with SharedEnv(_part, model, 6, 2) as env:
        rolled = env.roll(net, 0.5, 30, random)
        seeds = torch.randint(2**31, (2,), generator=torch.Generator().manual_seed(4)).tolist()
        alone = _part(1, 3).roll(net, 0.5, 30, torch.Generator().manual_seed(seeds[1]))
        assert rolled.observation.shape == (30, 6, 2) and rolled.action.shape == (30, 6, 1)
        for field in fields(rolled):
            mine, whole = getattr(alone, field.name), getattr(rolled, field.name)
            assert torch.equal(whole[3:] if field.name == "last" else whole[:, 3:], mine), field.name
        assert torch.equal(env.observe(), rolled.last)
        going_on = ~(rolled.terminated | rolled.truncated)[:-1]
        assert torch.equal(rolled.observation[1:][going_on], rolled.after[:-1][going_on]) and not going_on.all()


def test_a_process_that_cannot_begin_says_why() -> None:
    with pytest.raises(TrainingError, match="the simulator is broken"):
        SharedEnv(_no_part, SuccessModel(2, 0), 4, 2)
