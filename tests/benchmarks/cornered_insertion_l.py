"""How often the given model puts a tower of two away where no block is cornered, and how often each skill works.

    OMP_NUM_THREADS=1 python tests/benchmarks/cornered_insertion_l.py [--worlds 40] [--place]

The lid is on and the drawer is closed. A skill counts as good where all of its effects are seen afterwards. `--place`
tries the one skill that no such plan needs: what was picked is put down somewhere.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

from resync_robot.core.intervals import wilson
from resync_robot.core.rig import load_rig
from resync_robot.core.task import Task
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.execute import ExecuteSettings, Model, plan_and_execute
from resync_robot.planning.skill_run import run_skill
from resync_robot.policies.given_skills import given_skills
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.domains.cornered_insertion_l.domain import tower
from resync_robot.sim_training.domains.cornered_insertion_l.layouts import FurnishedLayout, sample_task
from resync_robot.sim_training.physics.world import SimWorld
from tests.scenes import B0, R

DOMAIN, RIG = find_domain("cornered-insertion-l"), load_rig()
MODEL = Model(
    {s.name: s for s in given_skills(RIG, DOMAIN.operators)},
    Abstraction(DOMAIN.predicates, DOMAIN.classifiers),
    DOMAIN.operators,
)


def free(seed: int, lid_on: bool) -> Task:
    layout = FurnishedLayout(free=("b0", "b1"), lid_on=lid_on)
    return sample_task(np.random.default_rng(seed), seed, tower("b0", "b1"), layout)


def put_away(worlds: int) -> None:
    tried, good, won, seconds = Counter[str](), Counter[str](), 0, []
    for seed in range(worlds):
        task = free(seed, lid_on=True)
        world = SimWorld(task, RIG)
        world.reset(task.initial)
        result = plan_and_execute(world, MODEL, task.goal, ExecuteSettings(max_failures=1))
        tried.update(t.skill for t in result.transitions)
        good.update(t.skill for t in result.transitions if t.succeeded)
        won += result.success
        seconds.append(world.time)
        print(f"{seed}: {result.end.value} {result.reason}, {world.time:.0f} s", flush=True)
    for skill in tried:
        report(skill, good[skill], tried[skill])
    report("goal", won, worlds)
    print(f"median {np.median(seconds):.0f} s on the robot's clock")


def put_down(worlds: int) -> None:
    good = 0
    for seed in range(worlds):
        task = free(seed, lid_on=False)
        world = SimWorld(task, RIG)
        world.reset(task.initial)
        held = run_skill(world, MODEL.skill("Pick").ground((R, B0))).done
        run_skill(world, MODEL.skill("Place").ground((R, B0)))
        good += held and DOMAIN.predicate("HandEmpty")(R) in MODEL.abstraction.true_atoms(world.perceive())
    report("Place", good, worlds)


def report(what: str, good: int, tried: int) -> None:
    low, high = wilson(good, tried)
    print(f"{what}: {good} of {tried} [{low:.2f}, {high:.2f}]", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=40)
    parser.add_argument("--place", action="store_true")
    args = parser.parse_args()
    (put_down if args.place else put_away)(args.worlds)


if __name__ == "__main__":
    main()
