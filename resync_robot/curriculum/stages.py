"""The stages of training, each a function from what earlier ones left in the run folder to a file of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from safetensors.numpy import save_file

from resync_robot.core.errors import TrainingError
from resync_robot.core.files import whole, write_json
from resync_robot.core.library import Record
from resync_robot.core.relations import between, seen
from resync_robot.core.rig import Rig
from resync_robot.core.symbols import Object
from resync_robot.core.task import Domain
from resync_robot.core.trajectory import Trajectory, read_trajectories, write_trajectories
from resync_robot.core.vocabulary import ROBOT, TYPES
from resync_robot.curriculum.arm_recovery import RECOVERY, learn_arm_recovery
from resync_robot.curriculum.run_folder import RunFolder
from resync_robot.curriculum.stage_files import Mined, read_learned, read_mined
from resync_robot.curriculum.written_reward import learn_by_written_reward
from resync_robot.learning.failures import PairGaussian, find_culprit
from resync_robot.library_models import initial_model, model_with_recovery
from resync_robot.planning.execute import Model, run_skill
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.dream import DreamSpec, dream, dream_specs, useful
from resync_robot.sim_training.learn_recovery import RecoverySettings
from resync_robot.sim_training.mine import Attempt, attempt_task, is_at_rest, resample_failure
from resync_robot.sim_training.parallel import parallel_map
from resync_robot.sim_training.physics.solver import Solver, with_solver
from resync_robot.sim_training.physics.world import SimWorld
from resync_robot.sim_training.ppo import PpoSettings

Progress = Callable[[float, str], None]
"""Called with the share of a stage that is done and the figure that matters."""


@dataclass(frozen=True, kw_only=True)
class Preset:
    """How much of everything."""

    tasks: int = 10
    """N, the training tasks that are tried first."""
    failures: int = 256
    """Size of the mined set D^F."""
    recovery: RecoverySettings = RECOVERY
    """How it is learned by the verdict."""
    ppo: PpoSettings = field(default_factory=PpoSettings)
    """How it is learned by the written reward."""
    proxy_checks: int = 24
    """Fresh worlds in which the recovery is followed by the real failed skill."""
    dreams: int = 150
    attempts: int = 600


PRESETS = {
    "smoke": Preset(
        failures=16,
        recovery=replace(
            RECOVERY,
            attempts=60,
            roll_outs=24,
            ppo=replace(RECOVERY.ppo, total_steps=45_000, least_steps=0, stop_at=0.9),
        ),
        ppo=PpoSettings(total_steps=45_000, least_steps=0, stop_at=0.9),
        proxy_checks=4,
        dreams=24,
        attempts=12,
    ),
    "quick": Preset(),
    "full": Preset(
        failures=512,
        recovery=replace(
            RECOVERY, ppo=replace(RECOVERY.ppo, total_steps=2_000_000, least_steps=1_000_000, stop_at=0.999)
        ),
        ppo=PpoSettings(total_steps=2_000_000, least_steps=1_000_000, stop_at=0.999),
        proxy_checks=200,
        dreams=600,
        attempts=2000,
    ),
}

TRAINING_SEEDS = 1_000_000
"""Each training seed owns this many world seeds from seed * TRAINING_SEEDS on; evaluation draws from elsewhere."""


@dataclass(frozen=True)
class Context:
    """What episodes need, rebuilt in each worker process."""

    domain: Domain
    rig: Rig
    model: Model


def make_context(domain: str, rig: Rig, recovery: Record | None) -> Context:
    found = find_domain(domain)
    model = initial_model(found, rig) if recovery is None else model_with_recovery(found, rig, recovery)
    return Context(found, rig, model)


# -- mining -----------------------------------------------------------------------------------------------------------


def _try(context: Context, job: tuple[str, int]) -> Attempt | None:
    scenario, seed = job
    task = context.domain.scenario(scenario).sample_practice(np.random.default_rng(seed), seed)
    return attempt_task(task, context.model, context.rig)


def _retry(context: Context, job: tuple[str, Object, Object, PairGaussian, int]) -> Attempt | None:
    task = resample_failure(context.domain, *job)
    return attempt_task(task, context.model, context.rig)


def mine(domain: Domain, folder: RunFolder, preset: Preset, seed: int, workers: int, progress: Progress) -> Mined:
    """Try the training tasks, explain their failure, and make many more like it."""
    path, attempts = folder.stages / "failures.json", folder.stages / "mining.jsonl"
    mined = read_mined(path, domain)
    if mined is None or not attempts.exists() or not folder.has_figures("mine"):
        first = seed * TRAINING_SEEDS
        scenario = next(s.name for s in domain.scenarios.values() if s.training)
        context = partial(make_context, domain.spec, folder.rig, None)
        tried = [
            a for a in parallel_map(_try, [(scenario, first + i) for i in range(preset.tasks)], context, workers) if a
        ]
        failures = [a.failure for a in tried if a.failure]
        if not failures:
            raise TrainingError(f"none of {len(tried)} tasks of {scenario} failed: there is nothing to learn from")
        culprit = find_culprit(failures, frozenset(o for a in tried for o in a.task.objects if o.type == ROBOT))
        relevant = next(f.objects[culprit.relevant_argument] for f in failures if f.skill == culprit.skill)
        alike = [f for f in failures if f.skill == culprit.skill and relevant in f.objects]
        pair = relevant, culprit.failure_object
        relation = between(relevant.type, culprit.failure_object.type, domain.relations)
        before = PairGaussian.fit([seen(f.state, *pair, domain.relations) for f in alike], relation.resolution)
        trajectories = [a.trajectory for a in tried]
        seeds: list[int] = []
        batch, drawn = 2 * workers * 4, 0
        while len(seeds) < preset.failures:
            if drawn > 20 * preset.failures:
                raise TrainingError(f"only {len(seeds)} of {drawn} resampled states fail like the first ones")
            jobs = [
                (scenario, *pair, before, first + 1000 + drawn + i) for i in range(max(batch, preset.failures // 2))
            ]
            for job, attempt in zip(jobs, parallel_map(_retry, jobs, context, workers), strict=True):
                drawn += 1
                if attempt is None:
                    continue
                trajectories.append(attempt.trajectory)
                if attempt.failure and attempt.failure.skill == culprit.skill and len(seeds) < preset.failures:
                    seeds.append(job[-1])
                progress(min(1.0, len(seeds) / preset.failures), f"{len(seeds)} failures in {drawn} worlds")
        write_trajectories(attempts, [_as_attempt(t) for t in trajectories])
        folder.record("mine", {"tasks": len(tried), "failed": len(failures), "resampled": drawn, "kept": len(seeds)})
        mined = Mined(culprit, relevant, before, tuple(seeds), scenario)
        write_json(path, mined.to_json())
    return mined


def _as_attempt(t: Trajectory) -> Trajectory:
    return Trajectory(t.transitions, t.goal, t.solved, "attempt")


# -- recovery ---------------------------------------------------------------------------------------------------------


def learn_recovery(
    domain: Domain,
    folder: RunFolder,
    preset: Preset,
    mined: Mined,
    seed: int,
    workers: int,
    progress: Progress,
    device: str = "cpu",
    reward: str = "written",
) -> tuple[Record, PairGaussian]:
    """PPO on the mined failures, its terminal functions, and the Gaussian of states after it.

    Args:
        reward: "verdict" or "written".
        device: where PPO's scenes and networks live; what it learned is then tried out on the CPU in any case.
    """
    weights, meta = folder.stages / "recovery.safetensors", folder.stages / "recovery.json"
    relation = between(mined.relevant.type, mined.culprit.failure_object.type, domain.relations)
    learned = read_learned(meta, weights, len(relation.names))
    if learned is None or not folder.has_figures("recovery"):
        checkpoint = folder.stages / "ppo.safetensors"

        def shown(steps: int, budget: int, rate: float) -> None:
            progress(steps / budget, f"success {rate:.3f} after {steps // 1000} k steps")

        if reward == "verdict":
            made = learn_arm_recovery(domain.spec, folder.rig, mined, seed, workers, checkpoint, shown, preset.recovery)
        else:
            made = learn_by_written_reward(
                domain, folder.rig, mined, seed, workers, checkpoint, shown, preset.ppo, device
            )
        record, after, figures = made
        with whole(weights) as beside:
            save_file({k: np.ascontiguousarray(v) for k, v in record.tensors.items()}, beside)
        folder.record("recovery", figures)
        write_json(meta, {**record.meta, "after": after.to_json()})
        learned = record, after
    return learned


def _check(context: Context, job: tuple[Mined, int, Solver | None]) -> tuple[bool, bool] | None:
    """Recovery, then the skill that failed: (done as far as beta says, the failed skill's effects came true)."""
    mined, seed, solver = job
    task = context.domain.scenario(mined.scenario).sample_practice(np.random.default_rng(seed), seed)
    if solver is not None:
        task = with_solver(task, solver)
    world = SimWorld(task, context.rig)
    if not is_at_rest(world):
        return None
    robot = next(o for o in task.objects if o.type == ROBOT)
    recover = context.model.skill(context.domain.recovery)
    outcome = run_skill(world, recover.ground((robot, mined.relevant, mined.culprit.failure_object)))
    operator = next(o for o in context.model.operators if o.name == mined.culprit.skill)
    objects = tuple(mined.relevant if v.type == mined.relevant.type else robot for v in operator.parameters)
    run_skill(world, context.model.skill(operator.name).ground(objects))
    holds = operator.ground(objects).add <= context.model.abstraction.true_atoms(world.perceive())
    return outcome.done, holds


def check_recovery(
    domain: Domain,
    rig: Rig,
    mined: Mined,
    record: Record,
    first_seed: int,
    worlds: int,
    workers: int,
    progress: Progress,
    solver: Solver | None = None,
) -> dict[str, Any]:
    """How often the recovery, then the real failed skill, succeed in fresh worlds; their physics is solved as `solver`
    says, or as was drawn."""
    jobs = [(mined, first_seed + i, solver) for i in range(worlds)]
    results = []
    for i, r in enumerate(parallel_map(_check, jobs, partial(make_context, domain.spec, rig, record), workers)):
        if r is not None:
            results.append(r)
        progress((i + 1) / worlds, f"{sum(h for _, h in results)} of {len(results)} picked")
    return {"worlds": len(results), "beta": sum(d for d, _ in results), "picked": sum(h for _, h in results)}


# -- dreaming ---------------------------------------------------------------------------------------------------------

CHUNK = 24


def _dream(context: tuple[Context, dict[str, PairGaussian]], spec: DreamSpec) -> list[Trajectory]:
    base, gaussians = context
    return dream(spec, base.domain, gaussians, base.model, base.rig)


def _dream_context(domain: str, rig: Rig, record: Record, gaussians: dict[str, PairGaussian]) -> Any:
    return make_context(domain, rig, record), gaussians


def dream_all(
    domain: Domain,
    folder: RunFolder,
    preset: Preset,
    record: Record,
    gaussians: dict[str, PairGaussian],
    seed: int,
    workers: int,
    progress: Progress,
) -> list[Trajectory]:
    """All dreams and attempts; each finished chunk is a file, so that a resumed run goes on where it was."""
    specs = dream_specs(preset.dreams, preset.attempts, seed * TRAINING_SEEDS + 500_000)
    predicates = {p.name: p for p in domain.predicates}
    chunks = [specs[i : i + CHUNK] for i in range(0, len(specs), CHUNK)]
    paths = [folder.stages / f"dreams-{i:03d}.jsonl" for i in range(len(chunks))]
    todo = [(path, chunk) for path, chunk in zip(paths, chunks, strict=True) if not path.exists()]
    flat = [spec for _, chunk in todo for spec in chunk]
    stream = parallel_map(_dream, flat, partial(_dream_context, domain.spec, folder.rig, record, gaussians), workers)
    finished, solved, count = len(specs) - len(flat), 0, 0
    for path, chunk in todo:
        found: list[Trajectory] = []
        for _ in chunk:
            lived = next(stream)
            found += lived
            finished, count, solved = finished + 1, count + 1, solved + any(t.solved for t in lived)
            progress(finished / len(specs), f"{solved} of {count} dreams solved")
        write_trajectories(path, found)
    paths.append(folder.stages / "mining.jsonl")
    trajectories = [t for p in paths for t in read_trajectories(p, TYPES, predicates)]
    kept, counts = useful(trajectories)
    folder.record("dream", {"sources": counts, "trajectories": len(kept)})
    return kept
