"""How often the given model puts a tower of two away where no block is cornered, with all poses seen by camera.

    OMP_NUM_THREADS=1 python tests/benchmarks/cornered_insertion_l_camera.py [--worlds 10] [--first 0] [--lid-off]

The worlds are those of `cornered_insertion_l.py`. Everything is as in a deployment but the robot and the cameras, which
are simulated. An episode counts that reached its goal in truth.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

import numpy as np

from resync_robot.core.errors import MotionError, PerceptionError
from resync_robot.deployment.devices import open_simulated
from resync_robot.deployment.uncertain_atoms import with_sampled_atoms
from resync_robot.deployment.world import DeployedWorld
from resync_robot.hardware.base import RobotError
from resync_robot.planning.execute import ExecuteSettings, Listener, plan_and_execute
from tests.benchmarks.cornered_insertion_l import MODEL, RIG, free, report


class Told(Listener):
    """Prints what is planned and how each skill ends."""

    def on_plan(self, plan, reason) -> None:
        print(f"    plan ({reason}): {' '.join(str(s) for s in plan.steps)}", flush=True)

    def on_skill_end(self, skill, outcome) -> None:
        print(f"    {skill}: {outcome.ending.value} {outcome.reason}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--lid-off", action="store_true")
    args = parser.parse_args()
    model = with_sampled_atoms(MODEL)
    tried, good, won, seconds = Counter[str](), Counter[str](), 0, []
    for seed in range(args.first, args.first + args.worlds):
        task, begun = free(seed, lid_on=not args.lid_off), time.monotonic()
        with open_simulated(task, RIG) as devices:
            world = DeployedWorld(devices.robot, devices.cameras, RIG, task.objects, abstraction=model.abstraction)
            try:
                result = plan_and_execute(world, model, task.goal, ExecuteSettings(max_failures=2), Told())
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
