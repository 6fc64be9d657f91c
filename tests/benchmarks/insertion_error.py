"""How often Insert seats a block where it is wrong about the pose of the block below.

    OMP_NUM_THREADS=1 python tests/benchmarks/insertion_error.py [--worlds 30] [--seed 1100]
        [--offsets 0 1 2 3 4] [--angles 0 2 4] [--reference]

Two free blocks, exact state, but for the block to insert onto: the skill believes it so many mm beside where it stands,
in a direction that is drawn, and turned by so many degrees to either side. A trial is good where the predicate On holds
in truth afterwards. The same worlds for every pair of errors.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from resync_robot.core import spatial
from resync_robot.core.intervals import wilson
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig, load_rig
from resync_robot.core.skill import SkillEnd
from resync_robot.core.state import State
from resync_robot.core.task import Task
from resync_robot.core.world import ArmObservation
from resync_robot.planning.skill_run import run_skill
from resync_robot.policies.scripted import scripted_skills
from resync_robot.sim_training.domains.cornered_insertion_s.domain import ON, on
from resync_robot.sim_training.domains.cornered_insertion_s.layouts import Layout, sample_task
from resync_robot.sim_training.physics.solver import REFERENCE, SHIPPED, Solver, with_solver
from resync_robot.sim_training.physics.world import SimWorld
from tests.scenes import B0, B1, R

RIG = load_rig()
GOAL = frozenset({ON(B0, B1)})


class Mistaken:
    """A world that shows one block elsewhere than it stands."""

    def __init__(self, world: SimWorld, shift: np.ndarray, turn: float) -> None:
        self._world, self._shift, self._turn = world, shift, turn

    def observe(self, live: bool = False) -> ArmObservation:
        seen = self._world.observe(live)
        x, y = seen.state.get(B1, "x", "y") + self._shift
        quat = spatial.quat_from_yaw(float(spatial.yaw_of(seen.state[B1][3:7])) + self._turn)
        pose = dict(zip(("qw", "qx", "qy", "qz"), quat, strict=True))
        return replace(seen, state=seen.state.with_features(B1, x=x, y=y, **pose))

    def perceive(self) -> State:
        return self.observe().state

    def act(self, target: JointTarget, duration: float) -> None:
        self._world.act(target, duration)

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        self._world.limit_effort(limit)


def worlds(count: int, seed: int, solver: Solver) -> Iterator[Task]:
    """Two free blocks; a few more worlds than are needed, for those in which they do not stand still or Pick fails."""
    for number in range(2 * count):
        rng = np.random.default_rng([seed, number])
        yield with_solver(sample_task(rng, seed + number, GOAL, Layout(free=("b0", "b1"))), solver)


def insert(task: Task, rig: Rig, offset: float, angle: float) -> tuple[bool, SkillEnd] | None:
    """Whether the block is seated, and how the skill ended; None where there is nothing to insert."""
    world, rng = SimWorld(task, rig), np.random.default_rng([task.seed, 7])
    pick, put = (next(s for s in scripted_skills(rig) if s.name == name) for name in ("Pick", "Insert"))
    if not world.settles() or not run_skill(world, pick.ground((R, B0))).done:
        return None
    direction, side = rng.uniform(-np.pi, np.pi), rng.choice([-1, 1])
    shift = offset * np.array([np.cos(direction), np.sin(direction)])
    outcome = run_skill(Mistaken(world, shift, side * angle), put.ground((R, B0, B1)))
    return on(world.perceive(), (B0, B1)) > 0.5, outcome.ending


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1100)
    parser.add_argument("--offsets", type=float, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--angles", type=float, nargs="+", default=[0, 2, 4])
    parser.add_argument("--reference", action="store_true")
    args = parser.parse_args()
    solver = REFERENCE if args.reference else SHIPPED
    tasks = list(worlds(args.worlds, args.seed, solver))
    for angle in args.angles:
        for offset in args.offsets:
            found: list[tuple[bool, SkillEnd]] = []
            for task in tasks:
                result = insert(task, RIG, offset / 1000, float(np.radians(angle)))
                found += [] if result is None else [result]
                if len(found) == args.worlds:
                    break
            good = sum(seated for seated, _ in found)
            low, high = wilson(good, len(found))
            blocked = sum(ending is not SkillEnd.DONE for _, ending in found)
            print(
                f"{offset:g} mm, {angle:g} deg: {good} of {len(found)} [{low:.2f}, {high:.2f}], {blocked} said blocked",
                flush=True,
            )


if __name__ == "__main__":
    main()
