"""What Icy Transport is like: how fast its steps are, how long its episodes, and whether recovery is possible at all.

The recovery that is tried is written by hand: full ahead, against the push, straight on.

python tests/benchmarks/icy_transport.py [--worlds 60]
"""

from __future__ import annotations

import argparse
import math
import time
from collections import Counter

import numpy as np

from resync_robot.core.embodiment import Stage
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.execute import ExecuteSettings, Listener, Model, plan_and_execute
from resync_robot.sim_training.domains.icy_transport import ICY_TRANSPORT
from resync_robot.sim_training.failure_mining import explain, mine_stage
from resync_robot.sim_training.recovery_problem import Start, pose_problem

BODY = ICY_TRANSPORT.embodiment
assert BODY is not None
MODEL = Model(
    {s.name: s for s in BODY.skills()},
    Abstraction(ICY_TRANSPORT.predicates, ICY_TRANSPORT.classifiers),
    ICY_TRANSPORT.operators,
)


class Counted(Listener):
    """Counts the actions of an episode."""

    def __init__(self) -> None:
        self.steps = 0

    def on_control(self, observation: object, action: object) -> None:
        self.steps += 1


def scripted(state: State, car: Object, region: Object) -> np.ndarray:
    """Full ahead, held on the line on which the car came, and straight."""
    x, y, theta, _, _, _, sideways, turning = state[car].tolist()
    rx, ry, turned = state[region][:3].tolist()
    across = -(x - rx) * math.sin(turned) + (y - ry) * math.cos(turned)
    off = math.remainder(turned + math.pi - theta, 2 * math.pi)
    # Seen from the car, which drives against the x axis of the region, its left is the region's right.
    aside = np.clip(8.0 * across - 3.0 * sideways, -2.0, 2.0)
    return np.array([2.0, aside, np.clip(4.0 * off - 0.8 * turning, -1.0, 1.0)])


def recoveries(stage: Stage, worlds: int) -> None:
    failures = mine_stage(ICY_TRANSPORT, BODY, stage, MODEL, 0, worlds)
    found = explain(ICY_TRANSPORT, failures)
    problem = pose_problem(ICY_TRANSPORT, BODY, stage, MODEL, found, [Start(f.task, f.state) for f in failures])
    print(f"{stage.recovery}: {found.skill}({', '.join(map(str, found.objects))}) fails on {found.culprits[0]}")
    speeds = [float(f.state[found.objects[0]][5]) for f in failures]
    print(f"  speed where it fails: {min(speeds):.2f} to {max(speeds):.2f} m/s")
    actions: list[int] = []
    for start in problem.starts:
        simulator = BODY.simulate(start.task)
        simulator.reset(start.state)
        for step in range(1, stage.horizon + 1):
            simulator.act(scripted(simulator.perceive(), found.objects[0], found.culprits[0]), 1 / BODY.rate_hz)
            if problem.judge(simulator, start.task.initial):
                actions.append(step)
                break
    most = f", after {min(actions)} to {max(actions)} actions" if actions else ""
    print(f"  by hand {len(actions)} of {len(failures)} recovered within {stage.horizon} actions{most}")


def given_model(worlds: int) -> None:
    free = [ICY_TRANSPORT.free(np.random.default_rng(s), s, {}) for s in range(worlds)]
    steps = _given("unobstructed", free)
    print(f"  actions of an episode: {min(steps)} to {max(steps)}, median {int(np.median(steps))}")
    for name, scenario in ICY_TRANSPORT.scenarios.items():
        _given(name, [scenario.sample(np.random.default_rng(s), s) for s in range(worlds)])


def _given(name: str, tasks: list[Task]) -> list[int]:
    won, steps, reasons = 0, [], Counter[str]()
    for task in tasks:
        counted = Counted()
        result = plan_and_execute(BODY.simulate(task), MODEL, task.goal, ExecuteSettings(max_failures=1), counted)
        won += result.success
        steps.append(counted.steps)
        reasons[result.reason] += 1
    print(f"given model, {name}: {won} of {len(tasks)}; {reasons.most_common(1)[0][0]}")
    return steps


def speed(worlds: int) -> None:
    action = np.array([1.0, 0.3, 0.2])
    for name in ("0", "6"):
        world = BODY.simulate(ICY_TRANSPORT.scenario(name).sample(np.random.default_rng(0), 0))
        for what, look in (("act", lambda w: None), ("act and observe", lambda w: w.observe(True))):
            begun = time.perf_counter()
            for _ in range(100 * worlds):
                world.act(action, 0.02)
                look(world)
            spent = (time.perf_counter() - begun) / (100 * worlds)
            print(f"scenario {name}, {what}: {1e6 * spent:.0f} us, {1 / spent:.0f} steps a second")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=60)
    args = parser.parse_args()
    speed(args.worlds)
    given_model(args.worlds)
    for stage in ICY_TRANSPORT.stages:
        recoveries(stage, args.worlds)


if __name__ == "__main__":
    main()
