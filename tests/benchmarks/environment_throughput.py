"""Control steps per second of the project's scenes and of ManiSkill's CPU environment of the same scene.

    OMP_NUM_THREADS=1 python tests/benchmarks/environment_throughput.py --json throughput.json

A control step is 0.1 s, ten physics steps. Every configuration has the same worlds, with the tip pressing on the block
and dragging it to and fro, so that nothing sleeps. Two things are measured: the environment, as PPO steps it (tip
motions in; observation, reward and success out; ManiSkill: `env.step`), and the scenes alone (joint targets in; joints
and block poses out). Repetitions are interleaved, so that a busy minute of the machine meets all alike; medians are
reported. Leave the machine alone while it runs.
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
from resync_robot.sim_training.block_recovery import Scenes
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.domains.cornered_insertion_s.maniskill_env import CorneredInsertionEnv, ManiSkillScenes
from resync_robot.sim_training.recovery import FailedWorlds, RecoverySettings, reward
from resync_robot.sim_training.vector_env import RecoveryScenes

B0 = BLOCK("b0")
SWING = 8
"""Control steps of pressing and dragging one way, then back."""
MANISKILL = "ManiSkill, 1 scene, CPU"

Cycle = Callable[[], float]
"""Runs one cycle of motion from the start poses and gives its control steps per second."""


def make_tasks(count: int) -> list[Task]:
    scenario = find_domain("cornered-insertion-s").scenario("s0")
    return [scenario.sample(np.random.default_rng(seed), seed) for seed in range(count)]


class Motion:
    """Press on the stud, drag away from the corner and back: as actions, and as joint targets computed beforehand."""

    def __init__(self, scenes: Scenes, xp: Any) -> None:
        self.scenes, self.settings = scenes, RecoverySettings()
        self.worlds = FailedWorlds(scenes.tasks, scenes.block, load_rig(), xp, torch.device("cpu"))
        self.task = torch.arange(scenes.count) % len(scenes.tasks)
        block, box = (self.worlds.failures[self.task][:, columns] for columns in (view.BLOCK, view.BOX))
        self.tip = block[:, :3].clone()
        self.tip[:, 2] += block[:, 9] / 2 + view.STUD + 0.002
        self.start = (self.worlds.array(block[:, :7]), self.worlds.joints_at(self.tip, self.task))
        self.resets = list(zip(range(scenes.count), self.task.tolist(), *self.start, strict=True))
        signs = [-1.0] * SWING + [1.0] * SWING
        self.actions = [torch.tensor([[0.28 * s, 0.28 * s, -1.0]]).repeat(scenes.count, 1) for s in signs]
        towards = box[:, :2] - self.tip[:, :2]
        towards = towards / towards.norm(dim=-1, keepdim=True)
        self.targets, tip = [], self.tip.clone()
        tip[:, 2] -= 0.02
        for sign in signs:
            tip[:, :2] -= 0.008 * sign * towards
            self.targets.append(self.worlds.joints_at(tip, self.task))

    def alone(self) -> float:
        self.scenes.reset(self.resets)
        begun = time.perf_counter()
        for q in self.targets:
            self.scenes.step(q)
        return self._rate(begun)

    def environment(self) -> float:
        """What `RecoveryEnv.step` does, from a start that is no draw."""
        scenes, commanded = self.scenes, self.tip
        scenes.reset(self.resets)
        x = self.worlds.states(scenes.joints, scenes.blocks, commanded, self.task)
        begun = time.perf_counter()
        for action in self.actions:
            previous, commanded = x, view.commanded_tip(x, action)
            scenes.step(self.worlds.joints_at(commanded, self.task))
            x = self.worlds.states(scenes.joints, scenes.blocks, commanded, self.task)
            reward(x, previous, 0.98, self.settings)
            view.observe(x)
        return self._rate(begun)

    def _rate(self, begun: float) -> float:
        return self.scenes.count * len(self.actions) / (time.perf_counter() - begun)


def gym_step(env: CorneredInsertionEnv, motion: Motion) -> Cycle:
    def run() -> float:
        env.reset(options={"start": motion.start})
        begun = time.perf_counter()
        for action in motion.actions:
            env.step(action)
        return len(motion.actions) / (time.perf_counter() - begun)

    return run


def measure(counts: list[int], workers: list[int], repetitions: int, cycles: int) -> dict[str, dict[str, list[float]]]:
    """Configuration -> "environment" or "alone" -> control steps per second of each repetition."""
    tasks, rig = make_tasks(max(counts)), load_rig()
    rates: dict[str, dict[str, list[float]]] = {}
    with ExitStack() as stack:
        runs: dict[tuple[str, str], tuple[Cycle, int]] = {}
        for processes in workers:
            for count in counts:
                if processes <= count:
                    scenes = stack.enter_context(RecoveryScenes(tasks[:count], B0, rig, count, processes))
                    motion = Motion(scenes, np)
                    name = f"{count} scenes, " + (f"{processes} workers" if processes else "in process")
                    runs[name, "environment"], runs[name, "alone"] = (motion.environment, count), (motion.alone, count)
        theirs = Motion(stack.enter_context(ManiSkillScenes(tasks[:1], B0, rig, 1, "cpu")), torch)
        env = CorneredInsertionEnv(num_envs=1, sim_backend="physx_cpu", tasks=tasks[:1], block=B0)
        stack.callback(env.close)
        runs[MANISKILL, "environment"], runs[MANISKILL, "alone"] = (gym_step(env, theirs), 1), (theirs.alone, 1)
        for repetition in range(repetitions + 1):
            for (name, what), (run, count) in runs.items():
                # A similar time for each; a mean of rates would favour lucky cycles.
                rounds = max(1, round(cycles / count))
                rate = rounds / sum(1 / run() for _ in range(rounds))
                if repetition > 0:  # the first one warms up
                    rates.setdefault(name, {}).setdefault(what, []).append(rate)
    return rates


def table(rates: dict[str, dict[str, list[float]]]) -> str:
    """Markdown: medians with their range, and their ratio to ManiSkill's."""
    lines = ["| | environment, steps/s | x ManiSkill | scenes alone, steps/s | x ManiSkill |", "|---|---|---|---|---|"]
    for name, found in rates.items():
        cells = [name]
        for what in ("environment", "alone"):
            v = found[what]
            cells += [
                f"{np.median(v):.0f} ({min(v):.0f} - {max(v):.0f})",
                f"{np.median(v) / np.median(rates[MANISKILL][what]):.1f}",
            ]
        lines.append("| " + " | ".join(cells) + " |")
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
        medians = {n: {what: float(np.median(v)) for what, v in found.items()} for n, found in rates.items()}
        result = {
            "control_steps_per_second": medians,
            "ratio_to_maniskill": {n: {w: m / medians[MANISKILL][w] for w, m in f.items()} for n, f in medians.items()},
            "repetitions": rates,
            "cores": os.cpu_count(),
            "load_average": load,
        }
        given.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
