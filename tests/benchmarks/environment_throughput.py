"""Control steps per second of the project's scenes and of ManiSkill's CPU environment of the same scene.

    OMP_NUM_THREADS=1 python tests/benchmarks/environment_throughput.py --json throughput.json

A control step is 0.1 s: drive targets in, ten physics steps, joints and block poses out. Every measurement takes the
same worlds, with the tip pressing on the block and dragging it to and fro, so that nothing sleeps. ManiSkill is
measured twice: as its users step it (`env.step`, with observation, reward and success), and its scene alone, driven
like ours. Repetitions are interleaved, so that a busy minute of the machine meets all alike; medians are reported.
Leave the machine alone while it runs.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import torch

from resync_robot.core.rig import load_rig
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK
from resync_robot.learning import recovery_policy as view
from sim_training.domains import find_domain
from sim_training.maniskill_env import CorneredInsertionEnv, ManiSkillScenes
from sim_training.ppo import Scenes
from sim_training.recovery import FailedWorlds
from sim_training.vector_env import RecoveryScenes

B0 = BLOCK("b0")
SWING = 8
"""Control steps of pressing and dragging one way, then back."""
GYM, SCENE = "ManiSkill CPU, env.step", "ManiSkill CPU, scene alone"

Cycle = Callable[[], float]
"""Runs one cycle of motion from the start poses and gives its control steps per second."""


def make_tasks(count: int) -> list[Task]:
    scenario = find_domain("cornered-insertion-s").scenario("s0")
    return [scenario.sample(np.random.default_rng(seed), seed) for seed in range(count)]


def plan(scenes: Scenes, xp: Any) -> tuple[list[tuple[int, int, Any, Any]], list[Any]]:
    """Resets with the tip over the stud, and (count, 6) joint targets that press and drag, computed beforehand."""
    worlds = FailedWorlds(scenes.tasks, scenes.block, load_rig(), xp, torch.device("cpu"))
    task = torch.arange(scenes.count) % len(scenes.tasks)
    block = worlds.failures[task][:, view.BLOCK]
    tip = block[:, :3].clone()
    tip[:, 2] += block[:, 9] / 2 + view.STUD + 0.002
    poses, q = worlds.array(block[:, :7]), worlds.joints_at(tip, task)
    resets = list(zip(range(scenes.count), task.tolist(), poses, q, strict=True))
    to_centre = worlds.failures[task][:, view.BOX][:, :2] - tip[:, :2]
    to_centre /= to_centre.norm(dim=-1, keepdim=True)
    targets = []
    for step in range(2 * SWING):
        tip = tip.clone()
        tip[:, :2] += (0.008 if step < SWING else -0.008) * to_centre
        tip[:, 2] = block[:, 2] + block[:, 9] / 2 + view.STUD - 0.02
        targets.append(worlds.joints_at(tip, task))
    return resets, targets


def scenes_cycle(scenes: Scenes, xp: Any) -> Cycle:
    resets, targets = plan(scenes, xp)

    def run() -> float:
        scenes.reset(resets)
        begun = time.perf_counter()
        for q in targets:
            scenes.step(q)
        return scenes.count * len(targets) / (time.perf_counter() - begun)

    return run


def gym_cycle(env: CorneredInsertionEnv) -> Cycle:
    """The same motion as actions: down on the stud, away from the corner and back."""
    worlds = FailedWorlds(env.tasks, env.block, load_rig(), torch, torch.device("cpu"))
    block = worlds.failures[:1, view.BLOCK]
    tip = block[:, :3].clone()
    tip[:, 2] += block[:, 9] / 2 + view.STUD + 0.002
    start = (block[:, :7].double(), worlds.joints_at(tip, torch.zeros(1, dtype=torch.long)))
    actions = [torch.tensor([[-sign * 0.28, -sign * 0.28, -1.0]]) for sign in [1] * SWING + [-1] * SWING]

    def run() -> float:
        env.reset(options={"start": start})
        begun = time.perf_counter()
        for action in actions:
            env.step(action)
        return len(actions) / (time.perf_counter() - begun)

    return run


def measure(counts: list[int], workers: list[int], repetitions: int, cycles: int) -> dict[str, list[float]]:
    """Configuration -> control steps per second of each repetition, the mean over a repetition's cycles."""
    tasks, rig = make_tasks(max(counts)), load_rig()
    rates: dict[str, list[float]] = {}
    with ExitStack() as stack:
        runs: dict[str, tuple[Cycle, int]] = {}
        for processes in workers:
            for count in counts:
                if processes <= count:
                    # Created before ManiSkill: worker processes must not inherit its objects.
                    scenes = stack.enter_context(RecoveryScenes(tasks[:count], B0, rig, count, processes))
                    runs[f"ours, {count} scenes, {processes} workers"] = (scenes_cycle(scenes, np), count)
        alone = stack.enter_context(ManiSkillScenes(tasks[:1], B0, rig, 1, "cpu"))
        runs[SCENE] = (scenes_cycle(alone, torch), 1)
        env = CorneredInsertionEnv(num_envs=1, sim_backend="physx_cpu", tasks=tasks[:1], block=B0)
        stack.callback(env.close)
        runs[GYM] = (gym_cycle(env), 1)
        for repetition in range(repetitions + 1):
            for name, (run, count) in runs.items():
                # A similar time for each; a mean of rates would favour lucky cycles.
                rounds = max(1, round(cycles / count))
                rate = rounds / sum(1 / run() for _ in range(rounds))
                if repetition > 0:  # the first round warms up
                    rates.setdefault(name, []).append(rate)
    return rates


def table(rates: dict[str, list[float]]) -> str:
    """Markdown: median, range, and the ratio of medians to ManiSkill's `env.step`."""
    lines = ["| environment | control steps/s | least - most | x ManiSkill |", "|---|---|---|---|"]
    base = float(np.median(rates[GYM]))
    for name, values in rates.items():
        median = float(np.median(values))
        lines.append(f"| {name} | {median:.0f} | {min(values):.0f} - {max(values):.0f} | {median / base:.1f} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, nargs="+", default=[1, 8, 64])
    parser.add_argument("--workers", type=int, nargs="+", default=[0, 1, 2], help="0 steps in this process")
    parser.add_argument("--repetitions", type=int, default=7)
    parser.add_argument(
        "--cycles", type=int, default=16, help="cycles of one scene in a repetition; many scenes do fewer"
    )
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    load_before = os.getloadavg()[0]
    rates = measure(given.scenes, given.workers, given.repetitions, given.cycles)
    print(table(rates))
    load = (load_before, os.getloadavg()[0])
    print(f"{os.cpu_count()} cores, {platform.machine()}; load average before {load[0]:.1f}, after {load[1]:.1f}")
    if given.json:
        base = float(np.median(rates[GYM]))
        medians = {name: float(np.median(values)) for name, values in rates.items()}
        result = {
            "control_steps_per_second": medians,
            "ratio_to_maniskill": {name: median / base for name, median in medians.items()},
            "repetitions": rates,
            "cores": os.cpu_count(),
            "load_average": load,
        }
        given.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
