"""Control steps per second of the recovery's environment, and of ManiSkill's CPU environment of the same scene.

    OMP_NUM_THREADS=1 python tests/benchmarks/environment_throughput.py --json throughput.json

A control step is 0.1 s. Every configuration has worlds of the same kind, with the tip pressing on the block and
dragging it to and fro, so that nothing sleeps. Ours is what PPO steps: tip motions in; observation, reward and success
by the model out; no verdicts, which cost what the failed skill takes. ManiSkill's is `env.step`. Repetitions are
interleaved, so that a busy minute of the machine meets all alike; medians are reported. Leave the machine alone while
it runs.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np
import torch

from resync_robot.core.rig import load_rig
from resync_robot.core.vocabulary import BLOCK
from resync_robot.learning import recovery_policy as view
from resync_robot.learning.success_model import SuccessModel
from resync_robot.sim_training.domains.cornered_insertion_s.maniskill_env import CorneredInsertionEnv
from resync_robot.sim_training.recovery_env import JudgedSettings, RecoveryEnv
from resync_robot.sim_training.shared_env import SharedEnv
from tests.cornered import pose_cornered

SWING = 8
"""Control steps of pressing and dragging one way, then back."""
MANISKILL = "ManiSkill, 1 scene, CPU"
NEVER = JudgedSettings(worth_a_try=0.999999, judged_ends=0.0, between=0.0)
"""Nothing is claimed and nothing judged."""

Cycle = Callable[[], float]
"""Runs one cycle of motion from the start and gives its control steps per second."""


def doubtful() -> SuccessModel:
    """A model that was fitted, and believes in nothing."""
    model = SuccessModel(view.OBSERVATION_SIZE, 0)
    rng = np.random.default_rng(0)
    model.add(rng.normal(size=(64, view.OBSERVATION_SIZE)), np.arange(64) % 2 == 0)
    model.fit()
    weights = model.weights()
    model.load({k: (np.full_like(v, -20.0) if k == "sharp.4.bias" else v) for k, v in weights.items()})
    return model


def part(worlds: int, number: int, count: int) -> RecoveryEnv:
    """The scenes of one process."""
    return RecoveryEnv(pose_cornered(worlds), doubtful(), count=count, seed=number, settings=NEVER)


def actions(count: int) -> list[torch.Tensor]:
    """Press, drag away from the corner, and back."""
    signs = [-1.0] * SWING + [1.0] * SWING
    return [torch.tensor([[0.28 * s, 0.28 * s, -1.0]]).repeat(count, 1) for s in signs]


def ours(env: RecoveryEnv | SharedEnv) -> Cycle:
    def run() -> float:
        env.reset(torch.arange(env.count))
        begun = time.perf_counter()
        for action in actions(env.count):
            env.step(action)
            env.observe()
        return 2 * SWING * env.count / (time.perf_counter() - begun)

    return run


def theirs(env: CorneredInsertionEnv) -> Cycle:
    def run() -> float:
        env.reset(seed=0)
        begun = time.perf_counter()
        for action in actions(1):
            env.step(action)
        return 2 * SWING / (time.perf_counter() - begun)

    return run


def measure(counts: list[int], workers: list[int], repetitions: int, cycles: int) -> dict[str, list[float]]:
    """Configuration -> control steps per second of each repetition."""
    rates: dict[str, list[float]] = {}
    with ExitStack() as stack:
        runs: dict[str, tuple[Cycle, int]] = {}
        for processes in workers:
            for count in (c for c in counts if processes <= c):
                if processes:
                    make = partial(part, count)
                    env = stack.enter_context(SharedEnv(make, doubtful(), count, processes))
                    runs[f"{count} scenes, {processes} workers"] = (ours(env), count)
                else:
                    runs[f"{count} scenes, in process"] = (ours(part(count, 0, count)), count)
        tasks = [start.task for start in pose_cornered(1).starts]
        gym = CorneredInsertionEnv(num_envs=1, sim_backend="physx_cpu", tasks=tasks, block=BLOCK("b0"))
        stack.callback(gym.close)
        runs[MANISKILL] = (theirs(gym), 1)
        for repetition in range(repetitions + 1):
            for name, (run, count) in runs.items():
                # A similar time for each; a mean of rates would favour lucky cycles.
                rounds = max(1, round(cycles / count))
                rate = rounds / sum(1 / run() for _ in range(rounds))
                if repetition > 0:  # the first one warms up
                    rates.setdefault(name, []).append(rate)
    return rates


def table(rates: dict[str, list[float]]) -> str:
    """Markdown: medians with their range, and their ratio to ManiSkill's."""
    lines = ["| | steps/s | x ManiSkill |", "|---|---|---|"]
    for name, v in rates.items():
        ratio = np.median(v) / np.median(rates[MANISKILL])
        lines.append(f"| {name} | {np.median(v):.0f} ({min(v):.0f} - {max(v):.0f}) | {ratio:.1f} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, nargs="+", default=[1, 8, 32])
    parser.add_argument("--workers", type=int, nargs="+", default=[0, 1, 2], help="0 steps in this process")
    parser.add_argument("--repetitions", type=int, default=7)
    parser.add_argument(
        "--cycles", type=int, default=16, help="cycles of one scene in a repetition; many scenes do fewer"
    )
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    load_rig()
    load_before = os.getloadavg()[0]
    rates = measure(given.scenes, given.workers, given.repetitions, given.cycles)
    print(table(rates))
    load = (load_before, os.getloadavg()[0])
    print(f"{os.cpu_count()} cores, {platform.machine()}; load average before {load[0]:.1f}, after {load[1]:.1f}")
    if given.json:
        medians = {name: float(np.median(v)) for name, v in rates.items()}
        result = {
            "control_steps_per_second": medians,
            "ratio_to_maniskill": {name: m / medians[MANISKILL] for name, m in medians.items()},
            "repetitions": rates,
            "cores": os.cpu_count(),
            "load_average": load,
        }
        given.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
