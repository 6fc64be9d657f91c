"""The failures of a stage: tasks that fail with all that is known so far, and what they have in common."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from resync_robot.core.damage import Shape, check_shape, reading
from resync_robot.core.embodiment import Stage
from resync_robot.core.errors import TrainingError
from resync_robot.core.files import read_json, write_json
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.task import Domain, Task
from resync_robot.curriculum.context import Context, Known
from resync_robot.curriculum.stage_folder import StageFolder, Tell
from resync_robot.learning.failures import PairGaussian, fit_beside
from resync_robot.sim_training.failure_mining import Explanation, FailedAttempt, as_explained, attempt, explain
from resync_robot.sim_training.parallel import parallel_map
from resync_robot.sim_training.recovery_problem import Start

FAILURES = "failures.json"
MINED: Shape = {
    "skill": str,
    "objects": [str],
    "relevant": str,
    "causes": [str],
    "states": [{"seed": int, "before": dict, "failed": dict}],
    "likewise": [{"seed": int, "names": dict, "failed": dict}],
}
"""The fields of failures.json."""


@dataclass(frozen=True)
class Mined:
    """D^F of a stage.

    Attributes:
        explanation: what failed on what.
        before: for each cause the Gaussian of how it lies to what the failure is about when the skill is begun.
        starts: tasks, and the states in which their skill had failed; among them those in which it was on its way to
            something else, under the names of what the failure is about.
    """

    explanation: Explanation
    before: Mapping[Object, PairGaussian]
    starts: tuple[Start, ...]


def task_of(domain: Domain, stage: Stage, seed: int) -> Task:
    """The task of the stage's scenario that training draws with this seed."""
    return domain.scenario(stage.scenario).sample_practice(np.random.default_rng(seed), seed)


def _attempt(context: Context, job: tuple[Stage, int]) -> FailedAttempt | None:
    return attempt(context.embodiment, task_of(context.domain, *job), context.model)


def mine(
    domain: Domain, stage: Stage, folder: StageFolder, known: Known, seeds: range, count: int, workers: int, tell: Tell
) -> Mined:
    """`count` failures of the stage's scenario, from as many tasks as that takes; those that are there already, if any.

    Args:
        seeds: the tasks' own, at most so many.

    Raises:
        TrainingError: hardly any task fails, nothing explains the failures, or the file that holds them is damaged.
    """
    path = folder.path / FAILURES
    if folder.figures("mine") and path.exists():
        return read_mined(path, domain, stage)
    found: list[tuple[int, FailedAttempt]] = []
    tried, batch = 0, max(8, 4 * workers)
    while len(found) < count:
        if tried >= len(seeds) or (tried >= 10 * batch and len(found) < 0.05 * tried):
            raise TrainingError(
                f"{len(found)} of {tried} tasks of {stage.scenario} failed, {count} failures are needed",
                "train on a scenario that fails, and see what check-domain says of it",
            )
        some = seeds[tried : tried + max(batch, count - len(found))]
        jobs = [(stage, seed) for seed in some]
        for seed, failed in zip(some, parallel_map(_attempt, jobs, known.open, workers), strict=True):
            tried += 1
            if failed is not None and len(found) < count:
                found.append((seed, failed))
            tell(len(found) / count, f"{len(found)} failures in {tried} tasks")
    explanation = explain(domain, [f for _, f in found])
    alike = [(s, f) for s, f in found if (f.skill, f.objects) == (explanation.skill, explanation.objects)]
    other = [
        {"seed": s, "names": {a.name: b.name for a, b in names.items()}, "failed": f.state.renamed(names).to_json()}
        for s, f in found
        if (names := as_explained(f, explanation))
    ]
    write_json(
        path,
        {
            "skill": explanation.skill,
            "objects": [o.name for o in explanation.objects],
            "relevant": explanation.relevant.name,
            "causes": [o.name for o in explanation.culprits],
            "states": [{"seed": s, "before": f.before.to_json(), "failed": f.state.to_json()} for s, f in alike],
            "likewise": other,
        },
    )
    folder.record("mine", {"tasks": tried, "failed": len(found), "kept": len(alike) + len(other)})
    return read_mined(path, domain, stage)


def read_mined(path: Path, domain: Domain, stage: Stage) -> Mined:
    """What `mine` left. Raises TrainingError where the file is damaged."""
    with reading(path):
        saved: dict[str, Any] = read_json(path)
        check_shape(saved, MINED)
        types = {t.name: t for t in domain.types}
        befores = [State.from_json(s["before"], types) for s in saved["states"]]
        starts = [
            Start(task_of(domain, stage, s["seed"]), State.from_json(s["failed"], types)) for s in saved["states"]
        ]
        for s in saved["likewise"]:
            task = task_of(domain, stage, s["seed"])
            known = {o.name: o for o in task.objects}
            names = {known[a]: known[b] for a, b in s["names"].items()}
            starts.append(Start(task.renamed(names), State.from_json(s["failed"], types)))
        named = {o.name: o for o in befores[0].objects}
        explanation = Explanation(
            saved["skill"],
            tuple(named[n] for n in saved["objects"]),
            named[saved["relevant"]],
            tuple(named[n] for n in saved["causes"]),
        )
        about = explanation.relevant
        before = {cause: fit_beside(domain, befores, cause, about) for cause in explanation.culprits}
    return Mined(explanation, before, tuple(starts))
