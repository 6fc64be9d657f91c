"""What parts of concept learning are worth: learn again from a run's dreams without one of them, stage after stage.

    python tests/benchmarks/learning_ablations.py RUN_FOLDER... --out FOLDER [--variants NAME...]

Writes FOLDER/<variant>-<run>/<stage>/ as libraries, to be compared with

    resync-robot evaluate --domain DOMAIN --library FOLDER/no-tuning-RUN/2-Wiggle --scenarios all

The recoveries are the run's own. A stage begins with what the variant itself learned in the stages before it. The seed
is that of the run, unless --seed says another one. Variants: "whole" learns as the program does; "no-tuning" keeps the
classifiers of earlier stages as they are; "paper" is the published formulation; "no-dreams" learns from episodes of the
stage's own training scenario, each with its failure and its recovery: as many as the stage had dreams and attempts.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from resync_robot.core.errors import TrainingError
from resync_robot.core.library import Library, load_library, save_library
from resync_robot.core.rig import load_rig
from resync_robot.core.task import Task
from resync_robot.core.trajectory import Trajectory
from resync_robot.curriculum.context import Known
from resync_robot.curriculum.dream import earlier_dreams
from resync_robot.curriculum.learn_stages import STAGE_SEEDS
from resync_robot.curriculum.mine import FAILURES
from resync_robot.curriculum.presets import STAGE_PRESETS, TRAINING_SEEDS
from resync_robot.learning.concepts import ConceptConfig, learn_concepts
from resync_robot.learning.dataset import StageData
from resync_robot.learning.failures import FailureModel
from resync_robot.learning.tuning import TuneConfig
from resync_robot.library_models import known_concepts, make_library
from resync_robot.planning.pddl import operator_to_pddl
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.dreaming import Dream, Dreamer, Placement
from resync_robot.sim_training.parallel import parallel_map

VARIANTS = {
    "whole": ConceptConfig(),
    "no-dreams": ConceptConfig(),
    "no-tuning": replace(ConceptConfig(), tune=TuneConfig(epochs=0)),
    "paper": ConceptConfig.of("paper"),
}

AWAKE = 90_000
"""Where in a stage's seeds those begin that no step of a run draws from."""


@dataclass(frozen=True)
class Awake(Dreamer):
    """Lives through tasks of a scenario instead."""

    scenario: str

    def task(self, dream: Dream, again: int = 0) -> Task:
        return self.domain.scenario(self.scenario).sample(np.random.default_rng([dream.seed, again]), dream.seed)


def experience(known: Known, run: Path, base: Library, number: int, seed: int) -> list[Trajectory]:
    """As many episodes of a stage's training scenario as the stage had dreams and attempts."""
    stages, context = base.stages[:number], known.open()
    stage, folder = stages[-1], run / "stages" / f"{number}-{stages[-1].recovery}"
    failures = tuple(FailureModel.from_learned(s.recovery, s.failure, context.domain) for s in stages)
    awake = Awake(context.domain, context.embodiment, failures, context.model, {}, stage.scenario)
    relevant = json.loads((folder / FAILURES).read_text(encoding="utf-8"))["relevant"]
    budgets, first = STAGE_PRESETS["quick"], seed * TRAINING_SEEDS + number * STAGE_SEEDS + AWAKE
    found: list[Trajectory] = []
    for i in range(budgets.dreams_of(number) + budgets.attempts):
        there = awake.task(Dream((), first + i)).initial.of_type(failures[-1].relevant)
        others = sorted((o for o in there if o not in failures[-1].causes), key=lambda o: (len(o.name), o.name))
        which = next((k for k, o in enumerate(others) if o.name == relevant), 0)
        found += awake.live(Dream((Placement(number - 1, "before", which),), first + i))
    return [t for t in found if t.transitions]


def learn(context: tuple[Path, int | None, int], job: tuple[Path, str]) -> list[dict[str, object]]:
    """Learn the stages of one run in one variant, and save the library of each."""
    torch.set_num_threads(1)
    (out, seed, most), (run, variant) = context, job
    places = sorted((run / "stages").glob("*/library"))[:most]
    base = load_library(places[-1])
    domain, rig = find_domain(base.domain), load_rig() if base.rig_hash else None
    chosen = seed if seed is not None else int(json.loads((run / "config.json").read_text(encoding="utf-8"))["seed"])
    types = {t.name: t for t in domain.types}
    data: list[StageData] = []
    library: Library | None = None
    told: list[dict[str, object]] = []
    for place, stage in zip(places, base.stages, strict=True):
        record = base.skills[stage.recovery]
        signature = tuple(types[name] for name in record.meta["signature"])
        trajectories = earlier_dreams(domain, place)
        if variant == "no-dreams":
            able = Known(domain=domain.spec, rig=rig, library=library).with_recovery(stage.recovery, record)
            trajectories = experience(able, run, base, len(data) + 1, chosen)
        data.append(StageData(stage.recovery, signature, stage.failure.skill, trajectories))
        known = known_concepts(domain, library) if library is not None else None
        begun, row = time.monotonic(), {"run": run.name, "variant": variant, "stage": stage.recovery}
        try:
            concepts = learn_concepts(data, domain, known, seed=chosen, config=VARIANTS[variant])
        except TrainingError as error:
            told.append({**row, "error": error.what})
            break
        provenance = {**base.provenance, "variant": variant, "seed": chosen}
        library = make_library(domain, rig, stage, record, concepts, provenance, known=library)
        save_library(library, out / f"{variant}-{run.name}" / place.parent.name)
        told.append(
            {
                **row,
                "minutes": round((time.monotonic() - begun) / 60, 1),
                "J": concepts.report["curve"][-1]["J"],
                "tuned": [entry["verdict"] for entry in concepts.report["tuned"]],
                "operators": [operator_to_pddl(o) for o in concepts.operators],
            }
        )
    return told


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), choices=list(VARIANTS))
    parser.add_argument("--stages", type=int, default=99, help="learn so many of them at most")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    jobs = [(run, variant) for run in args.run for variant in args.variants]
    for rows in parallel_map(learn, jobs, partial(_context, args.out, args.seed, args.stages), args.workers):
        for row in rows:
            print(json.dumps(row), flush=True)


def _context(out: Path, seed: int | None, stages: int) -> tuple[Path, int | None, int]:
    return out, seed, stages


if __name__ == "__main__":
    main()
