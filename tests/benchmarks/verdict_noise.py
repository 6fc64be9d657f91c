"""How often verdicts about a block that is free are wrong: judged as the recovery ends, and with the hand still on it.

    python tests/benchmarks/verdict_noise.py RUN_FOLDER [--episodes 60] [--seed 5]

RUN_FOLDER is one of `train-sim` in Cornered Insertion-S. Its policy, with the noise that PPO explores with, drags the
block of a failure until a gap that is drawn (12 to 50 mm) is left to both walls. There `Pick` is judged twice: at once,
and after the hand has let go and another look was taken. Prints JSON: how often each says that the failure is mended.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from resync_robot.core.library import load_library
from resync_robot.core.rig import load_rig
from resync_robot.curriculum.context import Known
from resync_robot.curriculum.mine import FAILURES
from resync_robot.curriculum.recover import _pose
from resync_robot.policies.state_recovery import recovery_nets
from resync_robot.sim_training.recovery_episodes import Episodes, Scene

NOISE = 0.35
"""Standard deviation of an action, of [-1, 1]: about the middle of training."""
GAP = (0.012, 0.050)
"""m."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--episodes", type=int, default=60)
    parser.add_argument("--seed", type=int, default=5)
    args = parser.parse_args()
    torch.set_num_threads(1)
    library = load_library(args.run / "library")
    stage = library.stages[0].recovery
    problem = _pose(Known(domain=library.domain, rig=load_rig()), stage, args.run / f"stages/1-{stage}" / FAILURES)
    net, _ = recovery_nets(library.skills[stage])
    rng = np.random.default_rng(args.seed)
    episodes = Episodes(problem, problem.starts, rng, 0.0, 8)
    at_once = replace(problem.judge, leave=None)

    def drag(scene: Scene, gap: float) -> bool:
        """Whether the block came free."""
        while scene.steps < problem.stage.horizon:
            seen = episodes.see([scene])
            if seen[0, :2].min() / 10 >= gap:
                return True
            with torch.no_grad():
                mean = net.act(torch.as_tensor(seen, dtype=torch.float32)).double().numpy()
            episodes.move([scene], mean + NOISE * rng.standard_normal(mean.shape))
        return False

    said = []
    for _ in range(args.episodes):
        scene = episodes.begin()
        if drag(scene, rng.uniform(*GAP)):
            said.append([judge(scene.simulator, scene.task.initial) for judge in (at_once, problem.judge)])
        episodes.end(scene)
    pressed, left = np.sum(said, axis=0).tolist()
    print(json.dumps({"free": len(said), "mended, judged at once": pressed, "mended, judged as it ends": left}))


if __name__ == "__main__":
    main()
