"""How often the given model puts a tower of two away, with all poses seen by camera.

    OMP_NUM_THREADS=1 python tests/benchmarks/cornered_insertion_l_camera.py
        [--worlds 10] [--first 0] [--lid-off] [--cornered]

Everything is as in a deployment but the robot and the cameras, which are simulated. An episode counts that reached its
goal in truth. No block is cornered, and the worlds are those of `cornered_insertion_l.py`; or, with `--cornered`, they
are as in l0, or l4, and the recovery of the library for Cornered Insertion-S that comes with the program runs where a
skill has failed. While it runs, it is told exactly where its block is.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import replace

import numpy as np

from resync_robot.baselines.recovery_chaining import chaining
from resync_robot.core.errors import MotionError, PerceptionError
from resync_robot.core.library import load_library
from resync_robot.core.task import Task
from resync_robot.deployment.devices import open_simulated
from resync_robot.deployment.uncertain_atoms import SampledModel, with_sampled_atoms
from resync_robot.deployment.world import DeployedWorld
from resync_robot.hardware.base import RobotError
from resync_robot.library_models import recovery_of, shipped_library
from resync_robot.planning.execute import ExecuteSettings, Listener, Reaction, plan_and_execute
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.domains.cornered_insertion_l.domain import tower
from resync_robot.sim_training.domains.cornered_insertion_l.layouts import FurnishedLayout, sample_task
from tests.benchmarks.cornered_insertion_l import MODEL, RIG, free, report


class Told(Listener):
    """Prints what is planned and how each skill ends."""

    def on_plan(self, plan, reason) -> None:
        print(f"    plan ({reason}): {' '.join(str(s) for s in plan.steps)}", flush=True)

    def on_skill_end(self, skill, outcome) -> None:
        print(f"    {skill}: {outcome.ending.value} {outcome.reason}", flush=True)


def cornered(seed: int, lid_on: bool) -> Task:
    layout = FurnishedLayout(cornered=("b0",), free=("b1",), lid_on=lid_on)
    return sample_task(np.random.default_rng(seed), seed, tower("b0", "b1"), layout)


def with_recovery() -> tuple[SampledModel, Reaction]:
    """The given model with a recovery, and when to run it."""
    library, small = load_library(shipped_library("cornered-insertion-s")), find_domain("cornered-insertion-s")
    name = library.stages[0].recovery
    recovery = recovery_of(small, RIG, name, library.skills[name], MODEL.skills)
    model = with_sampled_atoms(replace(MODEL, skills={**MODEL.skills, name: recovery}))
    return model, chaining(small, library, model.skills)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--lid-off", action="store_true")
    parser.add_argument("--cornered", action="store_true")
    args = parser.parse_args()
    model, reaction = with_sampled_atoms(MODEL), None
    if args.cornered:
        model, reaction = with_recovery()
    tried, good, won, seconds = Counter[str](), Counter[str](), 0, []
    for seed in range(args.first, args.first + args.worlds):
        begun = time.monotonic()
        task = cornered(seed, not args.lid_off) if args.cornered else free(seed, not args.lid_off)
        with open_simulated(task, RIG) as devices:
            world = DeployedWorld(
                devices.robot,
                devices.cameras,
                RIG,
                task.objects,
                live_state=devices.live,
                abstraction=model.abstraction,
            )
            try:
                result = plan_and_execute(world, model, task.goal, ExecuteSettings(), Told(), reaction)
                tried.update(t.skill for t in result.transitions)
                good.update(t.skill for t in result.transitions if t.succeeded)
                end, reason = result.end.value, result.reason
            except (PerceptionError, MotionError, RobotError) as error:
                end, reason = "fault", error.what
            reached = task.goal <= MODEL.abstraction.true_atoms(devices.truth())
            clock = devices.clock()
        won += reached
        seconds.append(clock)
        words = f"{'reached' if reached else 'not reached'}; {end} {reason}"
        print(f"{seed}: {words}, {clock:.0f} s, {world.scans} scans, {time.monotonic() - begun:.0f} s real", flush=True)
    for skill in tried:
        report(skill, good[skill], tried[skill])
    report("goal", won, args.worlds)
    print(f"median {np.median(seconds):.0f} s on the robot's clock")


if __name__ == "__main__":
    main()
