"""How often the monitor takes cameras for exchanged that are not, and how often it finds those that are.

    python tests/benchmarks/camera_monitor.py [--worlds 200] [--looks usual unseen hard] [--workers 2]

For every world one look as at the start of a recovery, the hand over a block that is stuck, with the errors that scans
and calibrations have; then the same pictures in each of the other five orders of the three cameras. An alarm in the
right order is a false one, an exchange that is not named is missed. Prints JSON, a line for each kind of looks and one
for all.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from itertools import permutations

import numpy as np

from resync_robot.core.intervals import wilson
from resync_robot.core.library import load_library
from resync_robot.core.rig import load_rig
from resync_robot.core.vocabulary import BLOCK
from resync_robot.learning.camera_view import VIEWS
from resync_robot.learning.failures import PairGaussian
from resync_robot.library_models import shipped_library
from resync_robot.perception.catalogue import Catalogue
from resync_robot.policies.camera_order import SIZE, exchanged, foretell, support
from resync_robot.sim_training.demonstrations.recoveries import RenderedRecovery
from resync_robot.sim_training.demonstrations.starts import draw_start
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.parallel import parallel_map
from resync_robot.sim_training.physics.randomise import LOOKS
from tests.libraries import gaussians_of

FRESH = 960_000_000
"""First world seed; training seeds stay far below it."""
BATCH = 10
BELIEVED = 0.002
"""m; sigma of where the scan has a block, along each axis: twice what is measured."""
ORDERS = list(permutations(range(len(VIEWS))))


def _context() -> Mapping[str, PairGaussian]:
    library = load_library(shipped_library("cornered-insertion-s"))
    return gaussians_of(library)


def _judge(gaussians: Mapping[str, PairGaussian], job: tuple[str, int]) -> list[tuple[bool, int]]:
    """For each world of a batch: was there a false alarm, and how many of the five exchanges were named."""
    looks, first = job
    domain, rig, found = find_domain("cornered-insertion-s"), load_rig(), []
    for seed in range(first, first + BATCH):
        start = draw_start(domain, gaussians, seed, LOOKS[looks], failed_only=True)
        scene = RenderedRecovery(start, rig, 0.5, seed, SIZE)
        if not scene.stands:
            continue
        rng, believed = np.random.default_rng([seed, 71]), start.task.initial
        for block in believed.of_type(BLOCK):
            x, y = np.array(believed.get(block, "x", "y")) + rng.normal(0, BELIEVED, 2)
            believed = believed.with_features(block, x=x, y=y)
        seen = scene.overview()
        cameras = [rig.camera(view) for view in VIEWS]
        foretold = [foretell(c, rig.camera_pose(c, seen.q), believed, Catalogue().hues) for c in cameras]
        said = [exchanged(support(seen.pictures[list(order)], foretold)) for order in ORDERS]
        found.append((said[0] is not None, sum(s == order for s, order in zip(said[1:], ORDERS[1:], strict=True))))
    return found


def _summary(looks: str, rows: list[tuple[bool, int]]) -> dict[str, object]:
    alarms, named = sum(a for a, _ in rows), sum(n for _, n in rows)
    exchanges = len(rows) * (len(ORDERS) - 1)
    return {
        "looks": looks,
        "starts": len(rows),
        "false_alarms": alarms,
        "false_alarms_ci95": [round(v, 4) for v in wilson(alarms, len(rows))],
        "exchanges": exchanges,
        "named": named,
        "named_share": round(named / exchanges, 4),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=200)
    parser.add_argument("--looks", nargs="+", default=list(LOOKS), choices=list(LOOKS))
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    everything = []
    for looks in args.looks:
        jobs = [(looks, FRESH + i) for i in range(0, args.worlds, BATCH)]
        rows = [row for batch in parallel_map(_judge, jobs, _context, args.workers) for row in batch]
        everything += rows
        print(json.dumps(_summary(looks, rows)), flush=True)
    print(json.dumps(_summary("all", everything)), flush=True)


if __name__ == "__main__":
    main()
