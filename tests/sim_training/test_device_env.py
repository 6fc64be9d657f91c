"""The recovery on a device, tried with one scene that is none: rewarded by claims, corrected by verdicts."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from resync_robot.core.rig import load_rig
from resync_robot.learning import recovery_policy as view
from resync_robot.learning.success_model import SuccessModel
from resync_robot.sim_training.device_env import DEVICE_SCENES, DeviceEnv, open_on_device, scaled_to_device
from resync_robot.sim_training.learn_recovery import RecoverySettings, learn_recovery
from resync_robot.sim_training.ppo import PpoSettings
from resync_robot.sim_training.recovery_env import JudgedSettings, RecoveryEnv
from resync_robot.sim_training.recovery_problem import Problem
from tests.cornered import pose_cornered
from tests.scenes import B0
from tests.sim_training.one_scene import OneScene

RIG = load_rig()
ACTIONS = torch.tensor([[0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def problem() -> Problem:
    return pose_cornered(1)


class Known(SuccessModel):
    """Claims what it was told to."""

    says = 0.0

    def probability(self, features: np.ndarray) -> np.ndarray:
        return np.full(len(features), self.says)

    @property
    def fitted(self) -> bool:
        return True


@contextmanager
def opened(problem: Problem, model: SuccessModel, **judged: Any) -> Iterator[tuple[DeviceEnv, RecoveryEnv]]:
    settings = JudgedSettings(**judged)
    judges = RecoveryEnv(problem, model, count=1, seed=0, settings=settings)
    scenes = OneScene([s.task for s in problem.starts], B0, RIG)
    yield (
        DeviceEnv(
            problem, model, judges, scenes, RIG, seed=1, gamma=0.98, settings=settings, variety=view.PressVariety()
        ),
        judges,
    )


def test_episodes_begin_over_the_block_and_end_at_the_horizon(problem: Problem) -> None:
    with opened(problem, Known(view.OBSERVATION_SIZE, 0), between=0.0) as (env, _):
        assert env.observe().shape == (1, view.OBSERVATION_SIZE)
        assert view.wall_gaps(env.x).max() < 0.006, "the block stands in its corner"
        assert 0.0 < float(view.tip_above_stud(env.x)[0]) < 0.08
        for step in range(1, problem.stage.horizon + 1):
            _, success, terminated, truncated = env.step(torch.zeros(1, 3))
            assert not success.any() and not terminated.any()
            assert bool(truncated[0]) == (step == problem.stage.horizon)
        env.reset(torch.tensor([0]))
        assert env.steps.tolist() == [0]


def test_some_episodes_begin_between_failure_and_freedom(problem: Problem) -> None:
    with opened(problem, Known(view.OBSERVATION_SIZE, 0), between=1.0) as (env, _):
        gaps = []
        for _ in range(10):
            env.reset(torch.tensor([0]))
            gaps.append(float(view.wall_gaps(env.x).max()))
        assert max(gaps) > 0.01 and min(gaps) >= -1e-3


def test_an_arm_is_late_by_what_its_episode_draws(problem: Problem) -> None:
    risen = []
    for lag in (0.0, 0.9):
        with opened(problem, Known(view.OBSERVATION_SIZE, 0), between=0.0) as (env, _):
            env.lag[:] = lag
            before = float(env.x[0, 2])
            env.step(ACTIONS)
            risen.append(float(env.x[0, 2]) - before)
    assert risen[1] < 0.6 * risen[0]


def test_a_claim_is_rewarded_at_once_and_a_verdict_corrects_it(problem: Problem) -> None:
    model = Known(view.OBSERVATION_SIZE, 0)
    with opened(problem, model, between=0.0) as (env, judges):
        model.says = 0.9
        gained, success, terminated, _ = env.step(ACTIONS)
        assert bool(success[0]) and bool(terminated[0]) and float(gained[0]) > 1
        demanded = env._claims.claimed_from
        (run,) = env.learn()
        assert not run.succeeded and judges.judged == 1, "Pick fails in the corner"
        np.testing.assert_allclose(run.state[B0][:7], env.scenes.blocks[0], atol=2e-3)
        assert env._claims.claimed_from > demanded and model.attempts == 1
        assert env.learn() == [], "nothing was claimed since"


def test_judges_say_of_a_state_what_the_skill_does_there(problem: Problem) -> None:
    free = problem.free(3)
    assert free is not None
    judges = RecoveryEnv(problem, SuccessModel(view.OBSERVATION_SIZE, 0), count=1, seed=0)
    start = problem.starts[0]
    middle = dict(zip(("x", "y"), start.state.get(problem.objects[2], "x", "y"), strict=True))
    sunk = start.state.with_features(B0, z=0.0)
    runs = judges.judge_in([(0, start.state), (0, start.state.with_features(B0, **middle)), (0, sunk)])
    assert [run is not None and run.succeeded for run in runs] == [False, True, False]
    assert runs[2] is None, "that does not stand"


def test_a_device_gets_thousands_of_scenes_and_as_many_updates() -> None:
    settings = PpoSettings()
    scaled = scaled_to_device(settings)
    assert scaled.scenes == DEVICE_SCENES
    assert scaled.total_steps / scaled.scenes >= settings.total_steps / settings.scenes / 4


@pytest.mark.slow
def test_a_recovery_is_learned_through_a_device(problem: Problem, tmp_path: Path) -> None:
    """All the way to a record, in a few actions: it need not be any good."""

    @contextmanager
    def make(tasks, block, rig, count, device):  # type: ignore[no-untyped-def]
        assert (count, device) == (1, "cpu")
        yield OneScene(tasks, block, rig)

    ppo = PpoSettings(scenes=1, steps=8, minibatch=8, total_steps=16, least_steps=0)
    settings = RecoverySettings(attempts=60, ppo=ppo, roll_outs=1, elsewhere=0, judges=1)
    learned = learn_recovery(
        problem,
        0,
        tmp_path / "ppo.safetensors",
        lambda *_: None,
        settings,
        on_device=partial(open_on_device, make=make, rig=RIG, device="cpu"),
    )
    assert learned.figures["steps"] == 16 and learned.figures["scenes"] == 1
    record = learned.to_record()
    assert {"terminal", "failed"} <= set(record.meta) and all(np.isfinite(v).all() for v in record.tensors.values())
