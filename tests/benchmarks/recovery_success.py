"""How often the recovery that a run learned, followed by the real skill that had failed, succeeds in fresh tasks.

python tests/benchmarks/recovery_success.py RUN_FOLDER [--stage 1] [--worlds 200] [--workers 2] [--physics reference]
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path

from resync_robot.core.intervals import wilson
from resync_robot.core.library import load_library
from resync_robot.core.rig import load_rig
from resync_robot.curriculum.context import Context, Known
from resync_robot.curriculum.mine import FAILURES, read_mined
from resync_robot.curriculum.recover import _Check, _check
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.parallel import parallel_map
from resync_robot.sim_training.physics.solver import REFERENCE, with_solver

FRESH = 900_000_000
"""First world seed; training seeds stay far below it."""


@dataclass(frozen=True)
class Fresh:
    """Makes the context in each process."""

    known: Known
    reference: bool

    def __call__(self) -> Context:
        context = self.known.open()
        if not self.reference:
            return context
        body = context.embodiment
        fine = replace(body, simulate=lambda task: body.simulate(with_solver(task, REFERENCE)))
        return replace(context, embodiment=fine)


def succeeded(
    known: Known, stage_folder: Path, worlds: int, workers: int, reference: bool = False
) -> dict[str, object]:
    """Tries of the recovery that `known` holds beside the library of the stages before."""
    domain = find_domain(known.domain)
    stage = next(s for s in domain.stages if s.recovery == stage_folder.name.partition("-")[2])
    mined = read_mined(stage_folder / FAILURES, domain, stage)
    jobs = [_Check(stage, mined.explanation, FRESH + i) for i in range(worlds)]
    found = [r for r in parallel_map(_check, jobs, Fresh(known, reference), workers) if r is not None]
    mended, said = sum(s is not None for _, s in found), sum(done for done, _ in found)
    low, high = wilson(mended, len(found))
    return {"worlds": len(found), "done": said, "mended": mended, "ci95": [round(low, 3), round(high, 3)]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--stage", type=int, default=1)
    parser.add_argument("--worlds", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--physics", choices=["shipped", "reference"], default="shipped")
    args = parser.parse_args()
    folders = {int(p.name.partition("-")[0]): p for p in (args.run / "stages").glob("*-*")}
    library = load_library(folders[args.stage] / "library")
    domain, stage = find_domain(library.domain), library.stages[args.stage - 1]
    before = load_library(folders[args.stage - 1] / "library") if args.stage > 1 else None
    known = Known(domain=domain.spec, rig=load_rig() if domain.embodiment is None else None, library=before)
    known = known.with_recovery(stage.recovery, library.skills[stage.recovery])
    reference = args.physics == "reference"
    print(json.dumps(succeeded(known, folders[args.stage], args.worlds, args.workers, reference)))


if __name__ == "__main__":
    main()
