"""The recovery of a stage: learned from its failures, then tried out in fresh tasks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load_file, save_file

from resync_robot.core.damage import Shape, check_shape, reading
from resync_robot.core.embodiment import Stage
from resync_robot.core.errors import TrainingError
from resync_robot.core.files import read_json, whole, write_json
from resync_robot.core.library import Record
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.curriculum.context import Context, Known
from resync_robot.curriculum.mine import FAILURES, Mined, read_mined, task_of
from resync_robot.curriculum.presets import StagePreset
from resync_robot.curriculum.stage_folder import StageFolder, Tell
from resync_robot.learning.failures import PairGaussian, changed_features, fit_beside
from resync_robot.learning.learned_recovery import FIELDS, SURE, LearnedRecovery
from resync_robot.learning.terminals import Terminal
from resync_robot.planning.skill_run import run_skill
from resync_robot.sim_training.device_env import open_on_device, scaled_to_device
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.failure_mining import Explanation
from resync_robot.sim_training.learn_recovery import learn_recovery
from resync_robot.sim_training.parallel import parallel_map
from resync_robot.sim_training.recovery_problem import Problem, judge_of, pose_problem

LEAST_RECOVERED = 5
"""Fresh tasks that a recovery has to mend at least: fewer tell nothing of what it leaves behind."""
CHECKED: Shape = {"begun": [dict], "states": [dict]}
"""The fields of recovered.json: states that a recovery began in and led to, where the failed skill then succeeded."""


def _pose(known: Known, recovery: str, failures: Path) -> Problem:
    """The problem, made anew in each process from what was mined."""
    context = known.open()
    stage = context.stage(recovery)
    mined = read_mined(failures, context.domain, stage)
    return pose_problem(context.domain, context.embodiment, stage, context.model, mined.explanation, mined.starts)


def recover(
    known: Known,
    stage: Stage,
    folder: StageFolder,
    preset: StagePreset,
    mined: Mined,
    seed: int,
    trials: range,
    workers: int,
    tell: Tell,
    device: str = "cpu",
) -> Record:
    """The record of the recovery: learned from what was mined, or read where it is there already. Resumes in between.

    Args:
        trials: seeds of the fresh tasks that tell how sure beta_N has to be.
        device: where the policy is learned, if the stage has scenes there.

    Raises:
        TrainingError: it cannot be learned, or a file is damaged.
    """
    meta, weights = folder.path / "recovery.json", folder.path / "recovery.safetensors"
    if not (folder.figures("recover") and meta.exists() and weights.exists()):
        checkpoint = folder.path / "ppo.safetensors"

        def progress(steps: int, budget: int, rate: float) -> None:
            tell(steps / budget, f"success {rate:.3f} after {steps // 1000} k actions")

        pose = partial(_pose, known, stage.recovery, folder.path / FAILURES)
        shared = workers if workers > 1 else 0
        settings, on_device = preset.recovery, None
        if device != "cpu" and stage.on_device is not None and known.rig is not None:
            settings = replace(settings, ppo=scaled_to_device(settings.ppo))
            on_device = partial(open_on_device, make=stage.on_device, rig=known.rig, device=device)
        learned = learn_recovery(
            pose(),
            seed,
            checkpoint,
            progress,
            settings,
            workers=shared,
            pose=pose,
            on_device=on_device,
            device="cpu" if on_device is None else device,
        )
        figures = learned.figures
        record = _as_sure_as_needed(known, stage, mined, learned.to_record(), trials, workers)
        with whole(weights) as beside:
            save_file({k: np.ascontiguousarray(v) for k, v in record.tensors.items()}, beside)
        write_json(meta, record.meta)
        folder.record("recover", {**figures, "stop_at": preset.recovery.ppo.stop_at, "sure": record.meta["sure"]})
    with reading(meta):
        saved = read_json(meta)
        check_shape(saved, {**FIELDS, "failed": dict})
    with reading(weights):
        record = Record(saved, load_file(weights))
        LearnedRecovery.from_record(stage.recovery, record, {t.name: t for t in find_domain(known.domain).types})
        detector = {k.removeprefix("failed."): v for k, v in record.tensors.items() if k.startswith("failed.")}
        Terminal.from_record(Record(record.meta["failed"], detector))
    return record


def _as_sure_as_needed(known: Known, stage: Stage, mined: Mined, record: Record, trials: range, workers: int) -> Record:
    """The record with the probability of beta_N at which the recovery is done and has mended its failure most often, by
    trials in the same fresh tasks. Where these do not tell two apart it is the higher one: to be taken for done wrongly
    costs more than a moment more does, and a few trials seldom show it."""
    worth: dict[float, int] = {}
    for sure in SURE:
        one = known.with_recovery(stage.recovery, Record({**record.meta, "sure": sure}, record.tensors))
        jobs = [_Check(stage, mined.explanation, seed) for seed in trials]
        results = [r for r in parallel_map(_check, jobs, one.open, workers) if r is not None]
        worth[sure] = sum(done and mended is not None for done, mended in results)
    return Record({**record.meta, "sure": max(SURE, key=lambda s: (worth[s], s))}, record.tensors)


@dataclass(frozen=True)
class _Check:
    """One fresh task for the recovery."""

    stage: Stage
    explanation: Explanation
    seed: int


def _check(context: Context, job: _Check) -> tuple[bool, tuple[State, State] | None] | None:
    """Whether the recovery said that it is done, and the states it began in and left, if the failed skill then did its
    work; None where the scene does not stand."""
    task = task_of(context.domain, job.stage, job.seed)
    simulator = context.embodiment.simulate(task)
    if not simulator.reset(task.initial):
        return None
    about = job.explanation
    judge = judge_of(context.domain, context.model, about)
    judge.makes_ready(simulator, context.model, task)
    begun = simulator.perceive()
    done = run_skill(simulator, context.model.skill(job.stage.recovery).ground(about.parameters)).done
    left = simulator.perceive()
    return done, (begun, left) if judge(simulator, begun) else None


def check(
    known: Known,
    context: Context,
    stage: Stage,
    folder: StageFolder,
    mined: Mined,
    seeds: range,
    workers: int,
    tell: Tell,
) -> tuple[dict[Object, PairGaussian], dict[Object, dict[str, tuple[float, float]]]]:
    """Try the recovery in fresh tasks, with the failed skill behind it: for each cause the Gaussian of where it lies
    afterwards, and the features that have changed.

    Args:
        known: holds the recovery as a skill.

    Raises:
        TrainingError: it mends hardly any, or the file that holds what it left is damaged.
    """
    path, about = folder.path / "recovered.json", mined.explanation
    if not (folder.figures("check") and path.exists()):
        jobs = [_Check(stage, about, seed) for seed in seeds]
        results: list[tuple[bool, tuple[State, State] | None]] = []
        for i, result in enumerate(parallel_map(_check, jobs, known.open, workers)):
            if result is not None:
                results.append(result)
            mended = sum(s is not None for _, s in results)
            tell((i + 1) / len(jobs), f"{about.skill} succeeds in {mended} of {len(results)} fresh tasks")
        states = [s for _, s in results if s is not None]
        figures = {"worlds": len(results), "done": sum(d for d, _ in results), "mended": len(states)}
        if len(states) < LEAST_RECOVERED:
            raise TrainingError(
                f"{stage.recovery} mends {len(states)} of {len(results)} fresh tasks of {stage.scenario}",
                "train for longer with --preset full, or see what check-domain says of the domain",
            )
        begun, ended = ([pair[i].to_json() for pair in states] for i in (0, 1))
        write_json(path, {"begun": begun, "states": ended})
        folder.record("check", figures)
    with reading(path):
        saved: Any = read_json(path)
        check_shape(saved, CHECKED)
        types = {t.name: t for t in context.domain.types}
        before, left = ([State.from_json(s, types) for s in saved[name]] for name in ("begun", "states"))
        lies = {cause: fit_beside(context.domain, left, cause, about.relevant) for cause in about.culprits}
        return lies, {cause: changed_features(cause, before, left) for cause in about.culprits}
