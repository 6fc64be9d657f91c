"""The dreams of a stage, in files of their own, so that a run that was cut off goes on dreaming where it was."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from resync_robot.core.symbols import Type
from resync_robot.core.task import Domain
from resync_robot.core.trajectory import Trajectory, read_trajectories, write_trajectories
from resync_robot.curriculum.context import Known
from resync_robot.curriculum.stage_folder import StageFolder, Tell
from resync_robot.learning.failures import FailureModel
from resync_robot.sim_training.dreaming import Dream, Dreamer, tally
from resync_robot.sim_training.parallel import parallel_map

CHUNK = 40
"""Dreams in a file."""


@dataclass(frozen=True)
class _Asleep:
    """Makes a `Dreamer` in each process."""

    known: Known
    failures: tuple[FailureModel, ...]
    usual: tuple[tuple[Type, int], ...]

    def __call__(self) -> Dreamer:
        context = self.known.open()
        return Dreamer(context.domain, context.embodiment, self.failures, context.model, dict(self.usual))


def _live(dreamer: Dreamer, dream: Dream) -> list[Trajectory]:
    return dreamer.live(dream)


def usual_objects(
    domain: Domain, failures: tuple[FailureModel, ...], scenarios: tuple[str, ...], seed: int
) -> dict[Type, int]:
    """How many objects of each type the training scenes have, without the causes of failures."""
    usual: Counter[Type] = Counter()
    causes = {o.type for f in failures for o in f.causes}
    for name in scenarios:
        task = domain.scenario(name).sample(np.random.default_rng(seed), seed)
        usual |= Counter(o.type for o in task.objects)
    return {t: n for t, n in usual.items() if t not in causes}


def dream(
    known: Known,
    domain: Domain,
    failures: tuple[FailureModel, ...],
    scenarios: tuple[str, ...],
    folder: StageFolder,
    seeds: range,
    dreams: int,
    attempts: int,
    workers: int,
    tell: Tell,
) -> list[Trajectory]:
    """All dreams and attempts about `failures`, the newest of which is the stage's own.

    Args:
        known: the model to plan with; it holds every recovery.
        scenarios: the training scenarios of these failures.

    Raises:
        TrainingError: the domain has no scene to dream in, or a file is damaged.
    """
    usual = tuple(usual_objects(domain, failures, scenarios, seeds.start).items())
    make = _Asleep(known, failures, usual)
    specs = make().dreams(dreams, attempts, seeds.start)
    chunks = [specs[i : i + CHUNK] for i in range(0, len(specs), CHUNK)]
    paths = [folder.path / f"dreams-{i:03d}.jsonl" for i in range(len(chunks))]
    todo = [(path, chunk) for path, chunk in zip(paths, chunks, strict=True) if not path.exists()]
    stream = parallel_map(_live, [d for _, chunk in todo for d in chunk], make, workers)
    finished = len(specs) - sum(len(chunk) for _, chunk in todo)
    solved = lived = 0
    for path, chunk in todo:
        found: list[Trajectory] = []
        for _ in chunk:
            told = next(stream)
            found += told
            finished, lived, solved = finished + 1, lived + 1, solved + any(t.solved for t in told)
            tell(finished / len(specs), f"{solved} of {lived} dreams solved")
        write_trajectories(path, found)
    trajectories = _read(paths, domain)
    folder.record("dream", {"sources": tally(trajectories)})
    return trajectories


def earlier_dreams(domain: Domain, library: Path) -> list[Trajectory]:
    """What was dreamed of in the stage that left this library, where its files still lie beside it; else nothing."""
    return _read(sorted(library.parent.glob("dreams-*.jsonl")), domain)


def _read(paths: list[Path], domain: Domain) -> list[Trajectory]:
    types, predicates = {t.name: t for t in domain.types}, {p.name: p for p in domain.predicates}
    return [t for path in paths for t in read_trajectories(path, types, predicates) if t.transitions]
