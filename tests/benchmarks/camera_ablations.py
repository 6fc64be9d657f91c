"""What each part of the camera policy's training is worth: the same budget without it, in the same fresh worlds.

    python tests/benchmarks/camera_ablations.py RUN_FOLDER --out FOLDER [--variants NAME...] [--worlds 100]

RUN_FOLDER is one of `train-sim`; its recovery is the teacher. Half of the quick preset's budget. Prints JSON, a line
for each variant: how many of the worlds, all of which begin with a block that is stuck, the student recovered by its
own word and in truth, with looks as in training and with looks, friction and sizes that training never had.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from shutil import copytree
from tempfile import TemporaryDirectory

from resync_robot.core.intervals import wilson
from resync_robot.core.library import load_library
from resync_robot.core.task import Domain
from resync_robot.curriculum.distil import SHARD, DistilPlan, distil, make_context
from resync_robot.curriculum.run_folder import RunFolder
from resync_robot.curriculum.stage_folder import StageFolder
from resync_robot.sim_training.demonstrations.rollouts import try_student
from resync_robot.sim_training.demonstrations.starts import draw_start
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.parallel import parallel_map
from resync_robot.sim_training.physics.randomise import PICTURED, PRACTICE, UNSEEN
from tests.libraries import gaussians_of

WHOLE = DistilPlan(worlds=320, rounds=1, round_worlds=160, steps=1800, round_steps=1000)
VARIANTS = {
    "whole": WHOLE,
    "plain-looks": replace(WHOLE, looks=PRACTICE),
    "no-rounds": replace(WHOLE, worlds=480, rounds=0, steps=2800),
    "wrist-only": replace(WHOLE, blind=("front", "side")),
    "recorded-is-not-executed": replace(WHOLE, unrecorded_noise=0.008),
}
FRESH = 970_000_000
BATCH = 10


def _teaching(plan: DistilPlan) -> tuple[object, ...]:
    """What the demonstrations of a teacher alone depend on, but for their number."""
    return plan.looks, plan.unrecorded_noise, plan.picture


def _stage(domain: Domain, name: str, out: Path) -> StageFolder:
    """Where a variant learns."""
    return StageFolder(RunFolder(out / name), 1, domain.recovery)


def _take_over_demonstrations(domain: Domain, name: str, out: Path) -> None:
    """Copy what the teacher demonstrated for other variants, where this one's would be the same."""
    plan, inside = VARIANTS[name], _stage(domain, name, out).path / "demonstrations"
    for other in (v for v in VARIANTS if v != name and _teaching(VARIANTS[v]) == _teaching(plan)):
        for shard in (_stage(domain, other, out).path / "demonstrations").glob("turn-0-[0-9][0-9][0-9][0-9]"):
            here = inside / shard.name
            if int(shard.name[-4:]) < plan.worlds // SHARD and not here.exists():
                copytree(shard, here)


def _try(context, job: tuple[str, int]) -> list[bool]:  # type: ignore[no-untyped-def]
    looks, first = job
    ranges = UNSEEN if looks == "unseen" else PICTURED
    starts = [draw_start(context.domain, context.gaussians, first + i, ranges, failed_only=True) for i in range(BATCH)]
    trials = try_student(starts, context.rig, context.student, context.teacher, first)
    return [t.success for t in trials if t is not None]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), choices=list(VARIANTS))
    parser.add_argument("--worlds", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    library = load_library(args.run / "library")
    domain = find_domain(library.domain)
    record = library.skills[domain.recovery]
    gaussians = gaussians_of(library)
    for name in args.variants:
        _take_over_demonstrations(domain, name, args.out)
        plan, folder = VARIANTS[name], _stage(domain, name, args.out)
        files = distil(domain, folder, plan, record, gaussians, 0, args.workers, "cpu", lambda *_: None)
        result: dict[str, object] = {"variant": name}
        with TemporaryDirectory() as student:
            for file, data in files.items():
                (Path(student) / file).write_bytes(data)
            context = partial(make_context, domain.spec, folder.run.rig, record, gaussians, Path(student), plan.blind)
            for looks in ("usual", "unseen"):
                jobs = [(looks, FRESH + i) for i in range(0, args.worlds, BATCH)]
                found = [t for trials in parallel_map(_try, jobs, context, args.workers) for t in trials]
                low, high = wilson(sum(found), len(found))
                result[looks] = {"recovered": sum(found), "of": len(found), "ci95": [round(low, 2), round(high, 2)]}
        print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main()
