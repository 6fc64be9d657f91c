"""How often a tower of two is lifted whole by its lower block, beside the same with a finely solved physics.

    OMP_NUM_THREADS=1 python tests/benchmarks/lift_test.py [--worlds 20] [--also iterations=200,inertia=2 ...]

Worlds are those of practice in which the block to be picked is covered. Rigid pads touch both blocks at once, so which
of them carries the grip is for the solver to say: this is where it shows how far to trust it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from itertools import count, islice

import numpy as np

from resync_robot.core.intervals import wilson
from resync_robot.core.rig import load_rig
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK, ROBOT
from resync_robot.library_models import initial_model
from resync_robot.planning.skill_run import run_skill
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.physics.solver import REFERENCE, SHIPPED, Solver, with_solver
from resync_robot.sim_training.physics.world import SimWorld
from tests.benchmarks.drag_test import read

LOWER, UPPER = BLOCK("b0"), BLOCK("b2")
FIRST = 700_000
"""Seed of the first world."""
LIFTED = 0.05
"""m."""


def towers() -> Iterator[Task]:
    """Worlds of practice in which the block to be picked is covered."""
    domain = find_domain("cornered-insertion-s")
    for seed in count(FIRST):
        task = domain.practice(np.random.default_rng(seed), seed)
        if UPPER in task.objects:
            lower, upper = task.initial[LOWER], task.initial[UPPER]
            if np.hypot(*(upper[:2] - lower[:2])) < 0.03 and upper[2] > lower[2]:
                yield task


def is_lifted_whole(task: Task, solver: Solver) -> bool:
    """Whether both blocks come up when the lower one is picked."""
    domain, rig = find_domain("cornered-insertion-s"), load_rig()
    world = SimWorld(with_solver(task, solver), rig)
    world.settles()
    before = world.perceive()
    run_skill(world, initial_model(domain, rig).skill("Pick").ground((before.of_type(ROBOT)[0], LOWER)))
    after = world.perceive()
    return all(after[block][2] - before[block][2] > LIFTED for block in (LOWER, UPPER))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=20)
    parser.add_argument("--also", nargs="*", default=[], help="more solvers, as fields over the shipped one's")
    args = parser.parse_args()
    tasks = list(islice(towers(), args.worlds))
    for name, solver in {"reference": REFERENCE, "shipped": SHIPPED, **{t: read(t) for t in args.also}}.items():
        lifted = sum(is_lifted_whole(task, solver) for task in tasks)
        low, high = wilson(lifted, len(tasks))
        print(f"{name}: {lifted} of {len(tasks)} lifted whole [{low:.2f}, {high:.2f}]", flush=True)


if __name__ == "__main__":
    main()
