"""How long grounding all atoms and planning take with a learned library, over the scenes of every scenario.

Grounding once for exact poses, as in training, and once for estimated ones, as after each look of a deployment by
camera, which judges samples of what the poses may be.

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
from resync_robot.core.state import State
from resync_robot.core.vocabulary import BLOCK
from resync_robot.deployment.uncertain_atoms import with_sampled_atoms
from resync_robot.library_models import learned_model, shipped_library
from resync_robot.perception.pose import upright_covariance
from resync_robot.planning.search import plan
from resync_robot.sim_training.domains import find_domain, world_task


def estimated(state: State) -> State:
    """The same poses, of blocks known to 1 mm and a quarter of a degree."""
    covariance = {}
    for block in state.of_type(BLOCK):
        covariance[block] = np.eye(10) * 0.0006**2
        covariance[block][:7, :7] = upright_covariance(np.full(3, 0.001**2), 0.004**2, state[block][3:7])
    return State({o: state[o] for o in state.objects}, covariance)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--library", type=Path)
    parser.add_argument("--scenes", type=int, default=20)
    args = parser.parse_args()
    torch.set_num_threads(1)
    library = load_library(args.library or shipped_library("cornered-insertion-s"))
    domain = find_domain(library.domain)
    model = learned_model(domain, load_rig(), library)
    look = with_sampled_atoms(model).abstraction
    print(
        "| scenario | objects | grounding ms, median / p95 | by camera, each look | planning ms, median / p95 | steps |"
    )
    print("|---|---|---|---|---|---|")
    for scenario in domain.scenarios:
        grounding, sampling, planning, steps = [], [], [], []
        for episode in range(args.scenes):
            task = world_task(domain, scenario, 0, episode)
            begin = time.perf_counter()
            atoms = model.abstraction.true_atoms(task.initial)
            grounding.append(1000 * (time.perf_counter() - begin))
            begin = time.perf_counter()
            look.true_atoms(estimated(task.initial))
            sampling.append(1000 * (time.perf_counter() - begin))
            try:
                found = plan(model.operators, task.objects, atoms, task.goal, costs=model.costs)
            except PlanningError:
                continue
            planning.append(1000 * found.seconds)
            steps.append(len(found.steps))
        cells = [f"{np.median(v):.1f} / {np.percentile(v, 95):.1f}" for v in (grounding, sampling, planning)]
        print(f"| {scenario} | {len(task.objects)} | {' | '.join(cells)} | {np.median(steps):.0f} |")


if __name__ == "__main__":
    main()
