"""One attempt of the recovery as it is deployed: a scan, the approach, the camera policy with its guards, the way out.

    python tests/benchmarks/deployed_recovery.py LIBRARY --out ROWS.jsonl [--worlds 200] [--looks usual unseen]
        [--physics reference] [--workers 2]

In each fresh world a block is stuck. The attempt counts where the skill says that it is done and the skill that had
failed then succeeds, run from there with the exact state. Time-outs count as failures. `camera_recovery.py` tries the
policy alone, without guards. Rows that the file holds already are not run again. Prints JSON, a line for each look.

`tipping` of a row is floor friction times the height of the stud's top over half the diagonal of the footprint: from
about 1 on a block that is pressed in the middle and drawn from above tips over its corner before it slides. Blocks
above 0.85 are counted apart as well.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from resync_robot.core.errors import MotionError, PerceptionError
from resync_robot.core.intervals import wilson
from resync_robot.core.library import Library, load_library
from resync_robot.core.rig import load_rig
from resync_robot.core.skill import GroundSkill
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BOX, ROBOT
from resync_robot.deployment.devices import open_simulated
from resync_robot.deployment.world import DeployedWorld
from resync_robot.hardware.base import RobotError
from resync_robot.learning.recovery_policy import STUD
from resync_robot.library_models import camera_recovery, learned_model
from resync_robot.planning.execute import Model
from resync_robot.planning.skill_run import run_skill
from resync_robot.sim_training.demonstrations.starts import draw_start
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.parallel import parallel_map
from resync_robot.sim_training.physics.randomise import LOOKS
from resync_robot.sim_training.physics.solver import REFERENCE, with_solver
from resync_robot.sim_training.physics.world import SimWorld
from resync_robot.sim_training.recovery_problem import Judge
from tests.libraries import gaussians_of

TIPPING = 0.85
FRESH = 980_000_000
"""First world seed; those of training and of the other benchmarks stay below it."""


@dataclass(frozen=True)
class _Context:
    library: Library
    model: Model


def _open(path: Path) -> _Context:
    library, rig = load_library(path), load_rig()
    domain = find_domain(library.domain)
    recovery = camera_recovery(domain, rig, library)
    return _Context(library, learned_model(domain, rig, library, [recovery]))


def _attempt(context: _Context, job: tuple[str, int, bool]) -> dict[str, object] | None:
    """How it went; None where the scene does not stand still."""
    looks, seed, reference = job
    library, model, rig = context.library, context.model, load_rig()
    domain = find_domain(library.domain)
    start = draw_start(domain, gaussians_of(library), seed, LOOKS[looks], failed_only=True)
    task = with_solver(start.task, REFERENCE) if reference else start.task
    robot, box = (next(o for o in task.objects if o.type == kind) for kind in (ROBOT, BOX))
    if not SimWorld(task, rig).settles():
        return None
    with open_simulated(replace(task, seed=seed), rig) as devices:
        seen = DeployedWorld(devices.robot, devices.cameras, rig, task.objects, devices.truth)
        try:
            seen.perceive()
            outcome = run_skill(seen, model.skill(domain.recovery).ground((robot, start.block, box)))
            done, why = outcome.done, f"{outcome.ending.value} {outcome.reason}".strip()
        except (PerceptionError, MotionError, RobotError) as error:
            done, why = False, error.what
        left, begun = devices.truth(), task.initial
    failed: GroundSkill = model.skill(library.stage(domain.recovery).failure.skill).ground((robot, start.block))
    operator = next(o for o in domain.operators if o.name == failed.name).ground(failed.objects)
    judge = Judge(failed, operator.preconditions, operator.add, model.abstraction.true_atoms, wherever=True)
    world = SimWorld(task, rig)
    mended = world.reset(left) and judge(world, begun)
    row = {"looks": looks, "seed": seed, "reference": reference, "done": done, "mended": mended, "end": why}
    return row | {"tipping": round(_tipping(task, start.block), 3)}


def _tipping(task: Task, block: Object) -> float:
    width, height = task.initial.get(block, "size_x", "size_z")
    friction = (task.physics["friction_block"] + task.physics["friction_box"]) / 2
    return float(friction * (height + STUD) / (width / np.sqrt(2)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("library", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--worlds", type=int, default=200)
    parser.add_argument("--looks", nargs="+", default=["usual", "unseen"], choices=list(LOOKS))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--physics", choices=["shipped", "reference"], default="shipped")
    args = parser.parse_args()
    reference = args.physics == "reference"
    rows = [json.loads(line) for line in args.out.read_text(encoding="utf-8").splitlines()] if args.out.exists() else []
    known = {(r["looks"], r["seed"], r["reference"]) for r in rows}
    jobs = [(looks, FRESH + i, reference) for i in range(args.worlds) for looks in args.looks]
    todo = [job for job in jobs if job not in known]
    for row in parallel_map(_attempt, todo, partial(_open, args.library), args.workers):
        if row is not None:
            rows.append(row)
            with args.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
    for looks in args.looks:
        of = [r for r in rows if r["looks"] == looks and r["reference"] == reference]
        right = sum(r["done"] and r["mended"] for r in of)
        low, high = wilson(right, len(of))
        tipping = [r for r in of if r.get("tipping", 0.0) > TIPPING]
        said, mended = sum(r["done"] for r in of), sum(r["mended"] for r in of)
        print(
            json.dumps(
                {
                    "library": load_library(args.library).content_hash[:12],
                    "looks": looks,
                    "physics": args.physics,
                    "worlds": len(of),
                    "done": said,
                    "mended": mended,
                    "done_and_mended": right,
                    "ci95": [round(low, 3), round(high, 3)],
                    "tipping": len(tipping),
                    "tipping_done_and_mended": sum(r["done"] and r["mended"] for r in tipping),
                }
            )
        )


if __name__ == "__main__":
    main()
