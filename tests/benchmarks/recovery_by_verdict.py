"""The recovery of a first stage by the verdict of the failed skill: its learning curve, and how often it mends.

    python tests/benchmarks/recovery_by_verdict.py --out FOLDER [--domain cornered-insertion-s] [--seed 0] [--workers 2]
        [--shaping 3] [--steps 400000] [--worlds 200]

With --shaping 0 nothing but the verdict rewards; otherwise a learned model of success does, too.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

from resync_robot.core.rig import load_rig
from resync_robot.curriculum.context import Known
from resync_robot.curriculum.learn_stages import Curriculum
from resync_robot.curriculum.mine import mine
from resync_robot.curriculum.recover import recover
from resync_robot.curriculum.run_folder import RunFolder
from resync_robot.curriculum.stage_folder import StageFolder
from resync_robot.sim_training.domains import find_domain
from tests.benchmarks.recovery_success import succeeded


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--out", type=Path, required=True, help="keep what was learned in this folder, and go on with it"
    )
    parser.add_argument("--domain", default="cornered-insertion-s")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--worlds", type=int, default=200)
    parser.add_argument("--shaping", type=float)
    parser.add_argument("--steps", type=int, help="budget in actions")
    args = parser.parse_args()
    domain, begun = find_domain(args.domain), time.monotonic()
    stage, rig = domain.stages[0], load_rig() if domain.embodiment is None else None
    c = Curriculum(
        domain=domain, stages=(stage,), preset="quick", seed=args.seed, workers=args.workers, concepts="default",
        provenance={}, rig=rig,
    )  # fmt: skip
    known, folder = Known(domain=domain.spec, rig=rig), StageFolder(RunFolder(args.out), 1, stage.recovery)

    def tell(share: float, words: str) -> None:
        print(f"{share:.3f} {words} {time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)

    budgets, r = c.budgets, c.budgets.recovery
    if args.shaping is not None:
        r = replace(r, judged=replace(r.judged, shaping=args.shaping))
    if args.steps is not None:
        r = replace(r, ppo=replace(r.ppo, total_steps=args.steps, least_steps=min(args.steps, r.ppo.least_steps)))
    budgets = replace(budgets, recovery=r)
    mined = mine(domain, stage, folder, known, c.seeds(1, "mine"), budgets.failures, args.workers, tell)
    mining = time.monotonic() - begun
    trials = c.seeds(1, "recover")[: budgets.checks]
    record = recover(known, stage, folder, budgets, mined, args.seed, trials, args.workers, tell)
    learning = time.monotonic() - begun - mining
    found = succeeded(known.with_recovery(stage.recovery, record), folder.path, args.worlds, args.workers)
    minutes = {"mining_minutes": round(mining / 60, 2), "minutes": round(learning / 60, 2)}
    print(json.dumps({"seed": args.seed, **folder.figures("recover"), **minutes, **found}))


if __name__ == "__main__":
    main()
