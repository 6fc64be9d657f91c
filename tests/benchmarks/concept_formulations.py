"""The two formulations of concept learning on the same dreams: how often each finds the right model.

    python tests/benchmarks/concept_formulations.py RUN_FOLDER... --out FOLDER

Writes FOLDER/<formulation>-<run>/ as a library, to be compared with

    resync-robot evaluate --library FOLDER/paper-* --scenarios all
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from resync_robot.core.library import load_library, save_library
from resync_robot.core.rig import load_rig
from resync_robot.core.symbols import Operator
from resync_robot.core.trajectory import read_trajectories
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT, TYPES
from resync_robot.learning.concepts import learn_concepts
from resync_robot.learning.dataset import StageData
from resync_robot.library_models import make_library
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.parallel import parallel_map


def is_right(operators: Sequence[Operator], recovery: str) -> bool:
    """Pick needs something of its block, Insert something of its base, and the recovery gives both to its block."""
    by_name = {o.name: o for o in operators}
    if recovery not in by_name:
        return False
    recover = by_name[recovery]
    given = {a.predicate.name for a in recover.add if a.args == (recover.parameters[1],)}
    learned = [(by_name["Pick"], 1), (by_name["Insert"], 2)]
    return all(
        any(a.predicate.name in given and a.args == (o.parameters[i],) for a in o.preconditions) for o, i in learned
    )


def formulate(out: Path, job: tuple[Path, str]) -> dict[str, object]:
    """Learn from one run's dreams in one formulation and save the library."""
    run, mode = job
    base = load_library(run / "library")
    domain, seed = find_domain(base.domain), json.loads((run / "config.json").read_text())["seed"]
    predicates = {p.name: p for p in domain.predicates}
    files = [*sorted((run / "stages").glob("dreams-*.jsonl")), run / "stages" / "mining.jsonl"]
    trajectories = [t for f in files for t in read_trajectories(f, TYPES, predicates) if t.transitions]
    stage = base.stage(domain.recovery)
    data = StageData(stage.recovery, (ROBOT, BLOCK, BOX), stage.failure.skill, trajectories)
    concepts = learn_concepts([data], domain, mode=mode, seed=seed)
    provenance = {**base.provenance, "concepts": mode}
    library = make_library(domain, load_rig(), stage, base.skills[domain.recovery], concepts, provenance)
    save_library(library, out / f"{mode}-{run.name}")
    return {
        "run": run.name,
        "formulation": mode,
        "right": is_right(concepts.operators, domain.recovery),
        "changes": concepts.report.get("changes", []),
        "seconds": concepts.report["seconds"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--formulations", nargs="+", default=["default", "paper"])
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    jobs = [(run, mode) for run in args.runs for mode in args.formulations]
    rows = list(parallel_map(_formulate, jobs, partial(_keep, args.out), args.workers))
    for row in rows:
        print(json.dumps(row))
    for mode in args.formulations:
        mine = [bool(r["right"]) for r in rows if r["formulation"] == mode]
        models = Counter(tuple(sorted(map(str, r["changes"]))) for r in rows if r["formulation"] == mode)  # type: ignore[call-overload]
        print(f"{mode}: right in {sum(mine)} of {len(mine)}; the commonest model in {max(models.values())}")


def _keep(out: Path) -> Path:
    return out


def _formulate(out: Path, job: tuple[Path, str]) -> dict[str, object]:
    return formulate(out, job)


if __name__ == "__main__":
    main()
