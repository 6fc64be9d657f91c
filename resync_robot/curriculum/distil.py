"""The last step of a stage of the arm: from the recovery that knows the exact state to one that sees three cameras.

The teacher demonstrates in rendered scenes; the student learns from it; then, for a few rounds, the student drives
first and the teacher goes on from wherever that leads. Of the students along the way the one that recovers most often
in worlds of its own is kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from resync_robot.calibration.overlay import save_picture
from resync_robot.core.damage import check_folder_kind, check_shape, reading
from resync_robot.core.errors import TrainingError
from resync_robot.core.files import read_json, read_text, whole_folder, write_json
from resync_robot.core.library import Record
from resync_robot.core.rig import Rig
from resync_robot.core.runs import git_hash
from resync_robot.core.task import Domain
from resync_robot.curriculum.plots import contact_sheet, draw_distillation
from resync_robot.curriculum.presets import TRAINING_SEEDS
from resync_robot.curriculum.stage_folder import StageFolder, Tell
from resync_robot.learning.camera_view import PICTURE, VIEWS, CameraPolicy, Prediction
from resync_robot.learning.failures import PairGaussian
from resync_robot.sim_training.demonstrations import shards as stored
from resync_robot.sim_training.demonstrations.rollouts import (
    RolloutSettings,
    Teacher,
    Trial,
    demonstrate,
    look_around,
    try_student,
)
from resync_robot.sim_training.demonstrations.starts import draw_start
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.parallel import parallel_map
from resync_robot.sim_training.physics.randomise import PICTURED, Ranges

if TYPE_CHECKING:
    from resync_robot.policies.diffusion import DiffusionStudent

SHARD = 16
"""Worlds of one shard; they are stepped together, so that the student thinks for all of them at once."""
STILL, STILL_SEEDS = 48, 100_000
"""Worlds of a shard that are only looked at, and how far their seeds lie from the others."""
DEMONSTRATIONS, TRIALS = 700_000, 900_000
"""Where in a training seed's worlds those of the demonstrations and of the trials begin."""
CHECKPOINT_EVERY = 250


@dataclass(frozen=True, kw_only=True)
class DistilPlan:
    """How much of everything."""

    worlds: int = 480
    """Worlds of the teacher alone."""
    rounds: int = 1
    """Rounds in which the student drives first."""
    round_worlds: int = 160
    steps: int = 1500
    """Of training on the teacher's own worlds."""
    round_steps: int = 1000
    """Of training after each round."""
    trials: int = 96
    """Worlds in which each candidate is tried."""
    batch: int = 64
    size: str = "small"
    """Of the student, as in `resync_robot.policies.diffusion.SIZES`."""
    picture: int = PICTURE
    """Pixels of a side of the student's pictures."""
    looks: Ranges = PICTURED
    blind: tuple[str, ...] = ()
    """Cameras whose pictures the student never gets to see, for ablations."""
    unrecorded_noise: float = 0.0
    """m, as in `RolloutSettings`, for ablations."""


PLANS = {
    "smoke": DistilPlan(worlds=16, rounds=1, round_worlds=16, steps=20, round_steps=10, trials=8, batch=16),
    "quick": DistilPlan(),
    "full": DistilPlan(
        worlds=8000,
        rounds=3,
        round_worlds=2000,
        steps=40_000,
        round_steps=15_000,
        trials=400,
        batch=128,
        size="large",
        picture=128,
    ),
}


@dataclass(frozen=True)
class DistilContext:
    """What demonstrations and trials need, rebuilt in each worker."""

    domain: Domain
    rig: Rig
    teacher: Teacher
    student: CameraPolicy | None
    gaussians: Mapping[str, PairGaussian]


@dataclass(frozen=True)
class _Blind:
    """A student that does not see some of the cameras."""

    student: CameraPolicy
    blind: tuple[str, ...]

    @property
    def picture(self) -> int:
        return self.student.picture

    def __call__(self, pictures: np.ndarray, state: np.ndarray) -> Prediction:
        return self.student(_blinded(pictures, self.blind), state)


def _blinded(pictures: np.ndarray, blind: tuple[str, ...]) -> np.ndarray:
    if not blind:
        return pictures
    pictures = pictures.copy()
    pictures[:, [VIEWS.index(view) for view in blind]] = 0
    return pictures


def make_context(
    domain: str,
    rig: Rig,
    record: Record,
    gaussians: Mapping[str, PairGaussian],
    student: Path | None,
    blind: tuple[str, ...] = (),
) -> DistilContext:
    policy: CameraPolicy | None = None
    if student is not None:
        from resync_robot.policies.diffusion import load_student

        policy = _Blind(load_student(student), blind) if blind else load_student(student)
    return DistilContext(find_domain(domain), rig, teacher_of(record), policy, gaussians)


def teacher_of(record: Record) -> Teacher:
    """The recovery of a library record, which sees the exact state."""
    from resync_robot.policies.state_recovery import how_sure, recovery_nets

    (net, done), sure = recovery_nets(record), how_sure(record)
    return Teacher(net.act, lambda seen: done.probability(seen) > sure)


@dataclass(frozen=True)
class _Shard:
    folder: Path
    first_seed: int
    looks: Ranges
    rollout: RolloutSettings


def _demonstrate(context: DistilContext, shard: _Shard) -> int:
    """Write one shard. Returns how many of its worlds were recovered."""
    seeds = range(shard.first_seed, shard.first_seed + SHARD)
    starts = [draw_start(context.domain, context.gaussians, s, shard.looks) for s in seeds]
    found = demonstrate(starts, context.rig, context.teacher, shard.first_seed, context.student, shard.rollout)
    more = range(shard.first_seed + STILL_SEEDS, shard.first_seed + STILL_SEEDS + STILL)
    still = [draw_start(context.domain, context.gaussians, s, shard.looks) for s in more]
    around = look_around(still, context.rig, context.teacher, more.start, settings=shard.rollout)
    segments = [s for of in found for s in of] + ([around] if around else [])
    stamp = {"first_seed": shard.first_seed, "rig_hash": context.rig.hash, "git": git_hash()}
    task = context.domain.instruction or context.domain.recovery
    robot = f"{context.rig.arm.model}_{context.rig.gripper.model}"
    stored.write_shard(shard.folder, segments, task, robot, stamp)
    return sum(1 for segments in found if segments)


def _try(context: DistilContext, seeds: tuple[int, ...]) -> list[Trial | None]:
    if context.student is None:
        raise TrainingError("there is no student to try")
    starts = [draw_start(context.domain, context.gaussians, s, failed_only=True) for s in seeds]
    return try_student(starts, context.rig, context.student, context.teacher, seeds[0])


def distil(
    domain: Domain,
    folder: StageFolder,
    plan: DistilPlan,
    record: Record,
    gaussians: Mapping[str, PairGaussian],
    seed: int,
    workers: int,
    device: str,
    progress: Tell,
) -> dict[str, bytes]:
    """Teach, train, try, and keep one of the best. Returns the files of the policy that a library takes in.

    Resumes from what it left in the stage's folder: finished shards, the training's own checkpoint, finished trials.
    """
    saved = folder.path / "distil.json"
    points = _read_points(saved)
    shares = _Shares(plan, progress)
    shards: list[Path] = []
    check_folder_kind(folder.path / "demonstrations")
    with_student = partial(make_context, domain.spec, folder.run.rig, record, gaussians)
    for turn in range(plan.rounds + 1):
        student = None if turn == 0 else _candidate(folder, shares.until[turn - 1])
        context = partial(with_student, student, plan.blind)
        shards += _demonstrations(folder, plan, turn, seed, context, workers, shares)
        until = shares.until[turn]
        if _candidate(folder, until).exists():
            _check_candidate(_candidate(folder, until), folder.run.rig)
        else:
            _train(folder, plan, shards, until, seed, device, shares)
            points = [p for p in points if p["step"] != until]
        if not any(p["step"] == until for p in points):
            trials = _trials(partial(with_student, _candidate(folder, until), plan.blind), plan, seed, workers)
            points.append({"step": until, "worlds": len(trials), "success": sum(t.success for t in trials)})
            points.sort(key=lambda p: int(p["step"]))
            write_json(saved, points)
        shares.tried(points[-1])
    step = to_keep(points)
    folder.record("distil", {"points": points, "chosen": step, **_show(folder, shards, points, step)})
    return {p.name: p.read_bytes() for p in sorted(_candidate(folder, step).iterdir())}


def _read_points(path: Path) -> list[dict[str, Any]]:
    """How the candidates did so far. Raises TrainingError where the file cannot be used."""
    if not path.exists():
        return []
    with reading(path):
        points: list[dict[str, Any]] = read_json(path)
        check_shape(points, [{"step": int, "worlds": int, "success": int}])
        if any(not 0 <= p["success"] <= p["worlds"] for p in points):
            raise ValueError("a candidate recovered more often than it was tried")
    return points


def _check_candidate(path: Path, rig: Rig) -> None:
    """Raises TrainingError where that is no whole student."""
    from resync_robot.policies.diffusion import load_student

    with reading(path):
        load_student(path, rig)


def to_keep(points: Sequence[Mapping[str, int]]) -> int:
    """The step of the candidate to keep: of those that trials cannot tell from the best, the one trained longest.

    It recovers as often as far as anybody knows, and its eyes are better.

    Args:
        points: `step`, `worlds` and `success` (how many of these) of each candidate.
    """
    rates = [p["success"] / max(1, p["worlds"]) for p in points]
    best = max(range(len(points)), key=rates.__getitem__)
    error = math.sqrt(rates[best] * (1 - rates[best]) / max(1, points[best]["worlds"]))
    return max(p["step"] for p, rate in zip(points, rates, strict=True) if rate >= rates[best] - error)


def _show(folder: StageFolder, shards: list[Path], points: list[dict[str, Any]], chosen: int) -> dict[str, int]:
    """What a person wants to see: what the cameras saw, the curves. Returns how much there is, as `shards.count`."""
    shown = stored.moments(stored.read_shards(shards[:: max(1, len(shards) // 6)]))
    save_picture(folder.run.path / "demonstrations.png", contact_sheet(shown, VIEWS))
    draw_distillation(_read_losses(folder.path / "distil.csv"), points, chosen, folder.run.path / "distil.png")
    return stored.count(shards)


def _read_losses(path: Path) -> list[tuple[float, float]]:
    """(step, loss of the action) so far; none where the file is missing, for it is only drawn. Raises TrainingError."""
    if not path.exists():
        return []
    with reading(path):
        text = read_text(path)
        if text and not text.endswith("\n"):
            raise ValueError("its last line was cut off")
        return [(float(step), float(loss)) for step, loss, *_ in (line.split(",") for line in text.splitlines())]


WORLD = 3
"""Steps of training that take as long as one world of the demonstrations, on two cores."""


class _Shares:
    """Turns what is done into the share of the whole, and remembers the last success to show."""

    def __init__(self, plan: DistilPlan, progress: Tell) -> None:
        turns = range(plan.rounds + 1)
        self.until = [plan.steps + turn * plan.round_steps for turn in turns]
        self._progress, self._last, self._worlds = progress, "", 0
        self._whole = self.until[-1] + WORLD * (plan.worlds + plan.rounds * plan.round_worlds)

    def demonstrated(self, shards: int) -> None:
        """So many more of them are there."""
        self._worlds += SHARD * shards

    def shown(self, step: int, words: str) -> None:
        self._progress(min(0.99, (step + WORLD * self._worlds) / self._whole), words + self._last)

    def tried(self, point: Mapping[str, Any]) -> None:
        self._last = f"; {point['success']} of {point['worlds']} recovered at step {point['step']}"
        self.shown(point["step"], f"step {point['step']}")


def _candidate(folder: StageFolder, step: int) -> Path:
    return folder.path / f"student-{step:06d}"


def _demonstrations(
    folder: StageFolder,
    plan: DistilPlan,
    turn: int,
    seed: int,
    context: Callable[[], DistilContext],
    workers: int,
    shares: _Shares,
) -> list[Path]:
    """The shards of one turn, written where they are missing."""
    worlds = plan.worlds if turn == 0 else plan.round_worlds
    first = seed * TRAINING_SEEDS + DEMONSTRATIONS + turn * 20_000
    count = max(1, worlds // SHARD)
    rollout = RolloutSettings(unrecorded_noise=plan.unrecorded_noise, picture=plan.picture)
    shards = [
        _Shard(folder.path / "demonstrations" / f"turn-{turn}-{i:04d}", first + i * SHARD, plan.looks, rollout)
        for i in range(count)
    ]
    todo = [s for s in shards if not s.folder.exists()]
    recovered = 0
    shares.demonstrated(len(shards) - len(todo))
    for i, found in enumerate(parallel_map(_demonstrate, todo, context, workers)):
        recovered += found
        shares.demonstrated(1)
        step = shares.until[turn - 1] if turn else 0
        shares.shown(step, f"turn {turn}: {recovered} of {(i + 1) * SHARD} worlds demonstrated")
    return [s.folder for s in shards]


def _train(
    folder: StageFolder, plan: DistilPlan, shards: list[Path], until: int, seed: int, device: str, shares: _Shares
) -> None:
    """Train up to step `until` on all shards so far, and save the averaged student."""
    import torch

    from resync_robot.policies.diffusion import SIZES, DiffusionStudent
    from resync_robot.policies.training import DistilSettings, Trainer, has_bf16, statistics_of, step_of

    frames = stored.read_shards(shards)
    frames = replace(frames, pictures=_blinded(frames.pictures, plan.blind))
    checkpoint = folder.path / "distil.safetensors"
    torch.manual_seed(seed)
    first = stored.read_shards([s for s in shards if s.name.startswith("turn-0")])
    # The statistics of the first turn stay: weights learned with them would not survive others.
    student: DiffusionStudent = DiffusionStudent.create(SIZES[plan.size], statistics_of(first), device)
    trainer = Trainer(student, DistilSettings(batch=plan.batch, bf16=has_bf16(device)), shares.until[-1], seed)
    trainer.use(frames)
    # A candidate that was removed may lie before the checkpoint: then the training begins anew.
    if checkpoint.exists() and step_of(checkpoint) <= until:
        trainer.load(checkpoint)

    def report(step: int, losses: Mapping[str, float]) -> None:
        shares.shown(step, f"step {step}, {len(frames)} frames, loss {losses['action']:.4f}")
        with (folder.path / "distil.csv").open("a", encoding="utf-8") as log:
            log.write(",".join([str(step), *(f"{v:.6f}" for v in losses.values())]) + "\n")

    threads = torch.get_num_threads()
    torch.set_num_threads(THREADS)
    while trainer.step < until:
        trainer.run(min(until, trainer.step + CHECKPOINT_EVERY), report)
        trainer.save(checkpoint)
    torch.set_num_threads(threads)
    with trainer.averaged(), whole_folder(_candidate(folder, until)) as beside:
        student.save(beside, folder.run.rig)


THREADS = 2
"""Of the training process. Fixed, for sums depend on it, and the same seed shall give the same policy."""


def _trials(context: Callable[[], DistilContext], plan: DistilPlan, seed: int, workers: int) -> list[Trial]:
    first = seed * TRAINING_SEEDS + TRIALS
    jobs = [tuple(range(first + i, first + min(i + SHARD, plan.trials))) for i in range(0, plan.trials, SHARD)]
    return [t for found in parallel_map(_try, jobs, context, workers) for t in found if t is not None]
