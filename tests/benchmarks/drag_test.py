"""How far a block follows a hand that presses on it and drags it, beside the same with a finely solved physics.

    OMP_NUM_THREADS=1 python tests/benchmarks/drag_test.py [--worlds 40] [--also iterations=100,inertia=1 ...]

In each world, drawn as training draws them, one block stands in the middle of the box. The hand is sent 10 to 30 mm
into its stud and 60 mm along the floor, in a drawn direction, with the torques of a learned skill: the same targets
whatever the solver. The error is that of the way the block went, relative to the reference's, or to a tenth of the
drag where it hardly moved. The price is CPU time of the physics alone, pressing and dragging: nothing sleeps.

"half" has half the step of the reference: how sure the yardstick is of itself.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import torch

from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK
from resync_robot.learning import recovery_policy as view
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.failed_worlds import CONTROL_PERIOD, RECOVERY_TORQUE, FailedWorlds
from resync_robot.sim_training.physics.scene import build_scene
from resync_robot.sim_training.physics.solver import REFERENCE, SHIPPED, Solver, with_solver

B0 = BLOCK("b0")
DRAG, DEEP = 0.060, (0.010, 0.030)
"""m along the floor; m into the stud, from and to."""
FIRST = 1000
"""Seed of the first world."""


def centred(seed: int) -> Task:
    """A world of s0 with nothing but b0, in the middle of the box."""
    task = find_domain("cornered-insertion-s").scenario("s0").sample(np.random.default_rng(seed), seed)
    objects = tuple(o for o in task.objects if o.type != BLOCK or o == B0)
    box = task.initial[next(o for o in objects if o.type.name == "box")]
    kept = State({o: task.initial[o] for o in objects})
    middle = dict(zip(("x", "y", "qw", "qx", "qy", "qz"), (*box[:2], *box[3:7]), strict=True))
    return replace(task, objects=objects, initial=kept.with_features(B0, **middle))


def drag(tasks: Sequence[Task], solver: Solver) -> tuple[np.ndarray, float]:
    """(n,) m by which each block followed, and CPU seconds of a control step."""
    worlds = FailedWorlds(tasks, B0, load_rig(), np, torch.device("cpu"))
    everyone, rng = torch.arange(len(tasks)), np.random.default_rng(FIRST)
    block = worlds.failures[:, view.BLOCK]
    depth = rng.uniform(*DEEP, len(tasks))
    heading = rng.uniform(-np.pi, np.pi, len(tasks))
    along = np.stack([np.cos(heading), np.sin(heading), np.zeros(len(tasks))], -1)
    start = block[:, :3].double().numpy().copy()
    start[:, 2] += block[:, 9].numpy() / 2 + view.STUD + 0.002
    down = start - depth[:, None] * [0.0, 0.0, 1.0]
    tips = [start + s * (down - start) for s in np.linspace(0, 1, 4)]
    tips += [down + s * DRAG * along for s in np.linspace(0, 1, 11)[1:]] + [down + DRAG * along] * 3
    ways = [worlds.joints_at(torch.as_tensor(tip, dtype=torch.float32), everyone) for tip in tips]
    followed, spent = np.zeros(len(tasks)), 0.0
    for i, task in enumerate(tasks):
        built = build_scene(with_solver(task, solver), load_rig(), rendered=False)
        built.set_torque_limits(RECOVERY_TORQUE)
        built.set_configuration(ways[0][i], 0.0)
        built.approach(ways[0][i], ways[0][i], 0.0, 0.02)
        before = built.rigid[B0].entity_pose.p.copy()
        begun = time.process_time()
        for here, there in pairwise(ways):
            built.approach(here[i], there[i], 0.0, CONTROL_PERIOD)
        spent += time.process_time() - begun
        followed[i] = (built.rigid[B0].entity_pose.p - before) @ along[i]
    return followed, spent / len(tasks) / (len(ways) - 1)


def read(text: str) -> Solver:
    """`text` such as "iterations=100,inertia=1", over what is shipped."""
    given = dict(pair.split("=") for pair in text.split(","))
    kinds = {field.name: type(getattr(SHIPPED, field.name)) for field in fields(Solver)}
    return replace(SHIPPED, **{name: kinds[name](value) for name, value in given.items()})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=40)
    parser.add_argument("--also", nargs="*", default=[], help="more solvers, as fields over the shipped one's")
    parser.add_argument("--half", action="store_true", help="the reference with half its step, too")
    args = parser.parse_args()
    tasks = [centred(FIRST + i) for i in range(args.worlds)]
    truth, price = drag(tasks, REFERENCE)
    print("| physics | mean way, mm | error, median | 90 % | CPU ms a control step | steps/s of one core |")
    print("|---|---|---|---|---|---|")
    print(f"| reference | {1e3 * truth.mean():.1f} | | | {1e3 * price:.2f} | {1 / price:.0f} |", flush=True)
    others = {"shipped": SHIPPED, **{text: read(text) for text in args.also}}
    if args.half:
        others["half"] = replace(REFERENCE, period=REFERENCE.period / 2)
    for name, solver in others.items():
        way, price = drag(tasks, solver)
        error = np.abs(way - truth) / np.maximum(np.abs(truth), DRAG / 10)
        figures = f"{np.median(error):.3f} | {np.quantile(error, 0.9):.3f} | {1e3 * price:.2f} | {1 / price:.0f}"
        print(f"| {name} | {1e3 * way.mean():.1f} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
