"""What parts of concept learning are worth: learn again from a run's dreams without one of them, stage after stage.

    python tests/benchmarks/learning_ablations.py RUN_FOLDER... --out FOLDER [--variants NAME...]

Writes FOLDER/<variant>-<run>/<stage>/ as libraries, to be compared with

    resync-robot evaluate --domain DOMAIN --library FOLDER/no-tuning-RUN/2-Wiggle --scenarios all

The recoveries are the run's own. A stage begins with what the variant itself learned in the stages before it. The seed
is that of the run, unless --seed says another one. Variants: "whole" learns as the program does; "no-tuning" keeps the
classifiers of earlier stages as they are; "paper" is the published formulation.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch

from resync_robot.core.errors import TrainingError
from resync_robot.core.library import Library, load_library, save_library
from resync_robot.core.rig import load_rig
from resync_robot.curriculum.dream import earlier_dreams
from resync_robot.learning.concepts import ConceptConfig, learn_concepts
from resync_robot.learning.dataset import StageData
from resync_robot.learning.tuning import TuneConfig
from resync_robot.library_models import known_concepts, make_library
from resync_robot.planning.pddl import operator_to_pddl
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.parallel import parallel_map

VARIANTS = {
    "whole": ConceptConfig(),
    "no-tuning": replace(ConceptConfig(), tune=TuneConfig(epochs=0)),
    "paper": ConceptConfig.of("paper"),
}


def learn(context: tuple[Path, int | None], job: tuple[Path, str]) -> list[dict[str, object]]:
    """Learn all stages of one run in one variant, and save the library of each."""
    torch.set_num_threads(1)
    (out, seed), (run, variant) = context, job
    places = sorted((run / "stages").glob("*/library"))
    base = load_library(places[-1])
    domain, rig = find_domain(base.domain), load_rig() if base.rig_hash else None
    chosen = seed if seed is not None else int(json.loads((run / "config.json").read_text())["seed"])
    types = {t.name: t for t in domain.types}
    data: list[StageData] = []
    library: Library | None = None
    told: list[dict[str, object]] = []
    for place, stage in zip(places, base.stages, strict=True):
        record = base.skills[stage.recovery]
        signature = tuple(types[name] for name in record.meta["signature"])
        data.append(StageData(stage.recovery, signature, stage.failure.skill, earlier_dreams(domain, place)))
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
    parser.add_argument("--seed", type=int)
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    jobs = [(run, variant) for run in args.run for variant in args.variants]
    for rows in parallel_map(learn, jobs, partial(_context, args.out, args.seed), args.workers):
        for row in rows:
            print(json.dumps(row), flush=True)


def _context(out: Path, seed: int | None) -> tuple[Path, int | None]:
    return out, seed


if __name__ == "__main__":
    main()
