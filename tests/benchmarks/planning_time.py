"""How long grounding all atoms and planning take with a learned library, over the scenes of every scenario.

python tests/benchmarks/planning_time.py [--library FOLDER] [--scenes 20]
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch

from resync_robot.core.errors import PlanningError
from resync_robot.core.library import load_library
from resync_robot.core.rig import load_rig
from resync_robot.knowledge import learned_model, shipped_library
from resync_robot.planning.search import plan
from sim_training.domains import find_domain, world_task


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--library", type=Path)
    parser.add_argument("--scenes", type=int, default=20)
    args = parser.parse_args()
    torch.set_num_threads(1)
    domain = find_domain("cornered-insertion-s")
    model = learned_model(domain, load_rig(), load_library(args.library or shipped_library(domain.name)))
    print("| scenario | objects | grounding ms, median / p95 | planning ms, median / p95 | steps |")
    print("|---|---|---|---|---|")
    for scenario in domain.scenarios:
        grounding, planning, steps = [], [], []
        for episode in range(args.scenes):
            task = world_task(domain, scenario, 0, episode)
            begin = time.perf_counter()
            atoms = model.abstraction.true_atoms(task.initial)
            grounding.append(1000 * (time.perf_counter() - begin))
            try:
                found = plan(model.operators, task.objects, atoms, task.goal)
            except PlanningError:
                continue
            planning.append(1000 * found.seconds)
            steps.append(len(found.steps))
        cells = [f"{np.median(v):.1f} / {np.percentile(v, 95):.1f}" for v in (grounding, planning)]
        print(f"| {scenario} | {len(task.objects)} | {cells[0]} | {cells[1]} | {np.median(steps):.0f} |")


if __name__ == "__main__":
    main()
