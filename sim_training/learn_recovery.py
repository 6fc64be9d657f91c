"""The recovery of one stage, in any domain: attempts fit a model of success, PPO follows it, verdicts end it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.numpy import load_file, save_file

from resync_robot.core.damage import reading
from resync_robot.core.files import whole
from resync_robot.core.library import Record
from resync_robot.core.state import State
from resync_robot.learning.learned_recovery import LearnedRecovery
from resync_robot.learning.recovery_policy import ActorCritic
from resync_robot.learning.success_model import SuccessModel
from resync_robot.learning.terminals import Terminal, train_terminal
from resync_robot.sim_training.ppo import Environment, PpoSettings, Progress, train_policy
from resync_robot.sim_training.recovery_elsewhere import tried_elsewhere
from resync_robot.sim_training.recovery_env import JudgedSettings, RecoveryEnv, Tried
from resync_robot.sim_training.recovery_problem import Problem
from resync_robot.sim_training.shared_env import SharedEnv

EVIDENCE = "attempts.safetensors"
"""Lies beside the checkpoint."""


@dataclass(frozen=True, kw_only=True)
class RecoverySettings:
    """How much of everything."""

    attempts: int = 300
    """Runs of the failed skill that the model of success is first fitted to, from failures, from states where nothing
    obstructs, and from between the two."""
    ppo: PpoSettings = field(
        default_factory=lambda: PpoSettings(
            scenes=32,
            total_steps=400_000,
            least_steps=20_000,
            stop_at=0.97,
            plateau=80_000,
            restart=150_000,
            minibatch=256,
            std_end=0.1,
            anneal_steps=80_000,
            anneal_from=0.5,
        )
    )
    judged: JudgedSettings = field(default_factory=JudgedSettings)
    width: int = 128
    depth: int = 2
    elsewhere: int = 60
    """The same, for each other object that the failed skill can be applied to: a recovery is planned for these, too."""
    roll_outs: int = 80
    """Of the finished policy, from which the terminal function is learned."""
    judges: int = 32
    """Scenes in processes where the policy is learned on a device."""


OnDevice = Callable[
    [Problem, SuccessModel, "RecoveryEnv | SharedEnv", int, PpoSettings, JudgedSettings],
    AbstractContextManager[Environment],
]
"""(problem, model, the scenes in processes that judge, seed, settings) -> the scenes on a device."""


@dataclass(frozen=True)
class Learned:
    """What came of a stage's recovery.

    Attributes:
        recovery: policy and beta_N.
        failed: beta_F, over the same features: the failed skill fails from here.
        after: states from which it succeeds that the policy led to.
        figures: the learning curve, attempts and verdicts, accuracy of both terminal functions on held-out verdicts.
    """

    recovery: LearnedRecovery
    failed: Terminal
    after: tuple[State, ...]
    figures: dict[str, Any]

    def to_record(self) -> Record:
        """As a library keeps it: the policy, beta_N ("terminal") and beta_F ("failed")."""
        record, failed = self.recovery.to_record(), self.failed.to_record()
        tensors = {**record.tensors, **{f"failed.{k}": v for k, v in failed.tensors.items()}}
        return Record({**record.meta, "failed": failed.meta}, tensors)


def learn_recovery(
    problem: Problem,
    seed: int,
    checkpoint: Path,
    progress: Progress,
    settings: RecoverySettings | None = None,
    *,
    workers: int = 0,
    pose: Callable[[], Problem] | None = None,
    on_device: OnDevice | None = None,
    device: str = "cpu",
) -> Learned:
    """Learn the stage's recovery; resumes from `checkpoint` where one lies.

    Args:
        workers: processes that step the scenes; 0 steps them in this one.
        pose: makes the problem anew in each of them: a function of a module, or a partial of one.
        on_device: the scenes that the policy is learned in, where those in processes only judge.
        device: theirs, and the policy's meanwhile.

    Raises:
        TrainingError: a terminal function cannot be learned, for the policy hardly ever recovers.
    """
    s = settings or RecoverySettings()
    model = SuccessModel(problem.interface.features, seed)
    torch.manual_seed(seed)
    net = ActorCritic(s.width, s.depth, problem.interface.features, problem.interface.actions).to(device)
    scenes = s.ppo.scenes if on_device is None else s.judges
    evidence = _Evidence(checkpoint.with_name(EVIDENCE), model, problem.interface.features)

    @contextmanager
    def open_environment(done: int) -> Iterator[Environment]:
        # Of a run that was cut off before the policy was learned, the model learns anew what it had learned.
        known = evidence.read(done)
        with _opened(problem, model, scenes, seed + done, s, workers, pose) as env:
            if not known:
                others = tried_elsewhere(problem, seed, s.elsewhere)
                if others:
                    model.add(np.stack([run.features for run in others]), np.array([run.succeeded for run in others]))
                env.attempt(s.attempts)
                evidence.began([*others, *env.learn()])
                env.reset(torch.arange(scenes))
            if on_device is None:
                yield env
            else:
                with on_device(problem, model, env, seed + done, s.ppo, s.judged) as many:
                    yield many
            evidence.verdicts += env.judged

    curve = train_policy(net, open_environment, s.ppo, seed, checkpoint, progress)
    evidence.write(int(curve["steps"][-1]))
    net = net.cpu().eval()
    with _opened(problem, model, max(workers, 1), seed + s.ppo.total_steps + 1, s, workers, pose) as env:
        last = env.roll_out(net, s.roll_outs)
        verdicts = evidence.verdicts + env.judged
    # Every verdict that was asked for says where the skill succeeds, and so when the recovery is done.
    x, y = model.remembered()
    x = np.concatenate([x, *(run.features[None] for run in last)])
    y = np.append(y, [run.succeeded for run in last]).astype(bool)
    done, accuracy = train_terminal(_tensor(x), torch.as_tensor(y).long(), seed, reliability=model.reliability)
    # It fails where it was first seen to fail, and would not have failed where a recovery ends.
    begun = evidence.failed
    failed, failed_accuracy = train_terminal(
        _tensor(np.concatenate([x[y], begun])), torch.arange(int(y.sum()) + len(begun)) >= int(y.sum()), seed + 1
    )
    explanation = problem.explanation
    recovery = LearnedRecovery(
        name=problem.stage.recovery,
        types=tuple(o.type for o in explanation.parameters),
        sees=len(problem.objects),
        failed_skill=explanation.skill,
        arguments=tuple(explanation.parameters.index(o) for o in explanation.objects),
        horizon=problem.stage.horizon,
        policy=net,
        done=done,
    )
    figures = {
        "curve": curve,
        "steps": curve["steps"][-1],
        "scenes": s.ppo.scenes,
        "attempts": evidence.attempts,
        "verdicts": verdicts,
        "reliability": round(model.reliability, 3),
        "terminal_accuracy": round(accuracy, 4),
        "failure_detector_accuracy": round(failed_accuracy, 4),
    }
    return Learned(recovery, failed, tuple(run.state for run in last if run.succeeded), figures)


class _Evidence:
    """What learning a policy left of the skill's attempts, in a file beside its checkpoint: with both, a run that was
    cut off behind it ends as it would have.

    Attributes:
        failed: (n, d) features of the first attempts that failed.
        attempts, verdicts: how many were made first, and in all.
    """

    def __init__(self, path: Path, model: SuccessModel, features: int) -> None:
        self._path, self._model = path, model
        self.failed = np.zeros((0, features))
        self.attempts = self.verdicts = 0

    def began(self, runs: Tried) -> None:
        """The first attempts."""
        self.attempts = len(runs)
        failed = [run.features for run in runs if not run.succeeded]
        self.failed = np.stack(failed) if failed else self.failed

    def write(self, steps: int) -> None:
        """Of a policy that was learned in so many steps."""
        x, y = self._model.remembered()
        counts = np.array([steps, self.attempts, self.verdicts])
        found = {"features": x, "succeeded": y, "failed": self.failed, "counts": counts}
        with whole(self._path) as beside:
            save_file({**found, **{f"model.{k}": v for k, v in self._model.weights().items()}}, beside)

    def read(self, steps: int) -> bool:
        """Whether it is there of a policy that was learned in so many steps. Raises TrainingError where the file is
        damaged."""
        if steps == 0 or not self._path.exists():
            return False
        with reading(self._path):
            found = load_file(self._path)
            known, attempts, verdicts = found["counts"].tolist()
            if known != steps:
                return False
            self._model.add(found["features"], found["succeeded"])
            self._model.load({k[6:]: v for k, v in found.items() if k.startswith("model.")})
            self.failed, self.attempts, self.verdicts = found["failed"], attempts, verdicts
        return True


def _tensor(features: np.ndarray) -> torch.Tensor:
    return torch.as_tensor(features, dtype=torch.float32)


@contextmanager
def _opened(
    problem: Problem,
    model: SuccessModel,
    scenes: int,
    seed: int,
    s: RecoverySettings,
    workers: int,
    pose: Callable[[], Problem] | None,
) -> Iterator[RecoveryEnv | SharedEnv]:
    """The scenes, in this process or in others."""
    if workers > 0 and pose is not None:
        with SharedEnv(partial(_part, pose, workers, seed, s), model, scenes, workers) as env:
            yield env
    else:
        yield RecoveryEnv(problem, model, count=scenes, seed=seed, gamma=s.ppo.gamma, settings=s.judged)


def _part(
    pose: Callable[[], Problem], workers: int, seed: int, s: RecoverySettings, number: int, count: int
) -> RecoveryEnv:
    """Some of the scenes, of some of the failures: each is built once."""
    problem = pose()
    own = range(number, len(problem.starts), workers)
    model = SuccessModel(problem.interface.features, seed)
    part_seed = int(np.random.default_rng([seed, number]).integers(2**31))
    return RecoveryEnv(problem, model, count=count, seed=part_seed, gamma=s.ppo.gamma, settings=s.judged, own=own)
