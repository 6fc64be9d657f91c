"""The recovery by camera beside its teacher, which knows the exact state, in the same fresh rendered worlds.

    python tests/benchmarks/camera_recovery.py LIBRARY... [--worlds 200] [--looks usual unseen hard] [--workers 2]
        [--physics reference]

Every world begins with a block that is stuck. "usual" worlds are drawn as in training, "unseen" ones have friction,
masses and sizes beyond its edges, and surfaces and lights that it never had, "hard" ones a lamp that casts dark
shadows. Prints JSON, a line for each library.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from resync_robot.core.intervals import wilson
from resync_robot.core.library import Library, Record, load_library
from resync_robot.core.rig import load_rig
from resync_robot.curriculum.distil import teacher_of
from resync_robot.learning.camera_view import STATE_NAMES, VIEWS, CameraPolicy
from resync_robot.learning.failures import PairGaussian
from resync_robot.sim_training.demonstrations.rollouts import RolloutSettings, Teacher, demonstrate, try_student
from resync_robot.sim_training.demonstrations.starts import draw_start
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.parallel import parallel_map
from resync_robot.sim_training.physics.randomise import LOOKS
from resync_robot.sim_training.physics.solver import REFERENCE, with_solver
from tests.libraries import gaussians_of

FRESH = 950_000_000
"""First world seed; training seeds stay far below it."""
BATCH = 8
ALONE = RolloutSettings(burst_probability=0.0)


def _context(path: Path) -> tuple[Library, Teacher, CameraPolicy, dict[str, PairGaussian]]:
    from resync_robot.policies.diffusion import load_student

    library = load_library(path)
    domain = find_domain(library.domain)
    record: Record = library.skills[domain.recovery]
    with tempfile.TemporaryDirectory() as folder:
        for name, data in library.policies[domain.recovery].items():
            (Path(folder) / name).write_bytes(data)
        student = load_student(Path(folder))
    gaussians = gaussians_of(library)
    return library, teacher_of(record), student, gaussians


def _both(context, job: tuple[str, int, bool]) -> list[tuple[bool, bool, bool]]:  # type: ignore[no-untyped-def]
    """For each world of a batch: the teacher recovered, the student recovered, the student said that it was done."""
    library, teacher, student, gaussians = context
    looks, first, reference = job
    domain, rig = find_domain(library.domain), load_rig()
    starts = [draw_start(domain, gaussians, first + i, LOOKS[looks], failed_only=True) for i in range(BATCH)]
    if reference:
        starts = [replace(start, task=with_solver(start.task, REFERENCE)) for start in starts]
    taught = demonstrate(starts, rig, teacher, first, settings=ALONE)
    trials = try_student(starts, rig, student, teacher, first)
    return [(bool(s), t.success, t.stopped) for s, t in zip(taught, trials, strict=True) if t is not None]


def _inference_ms(path: Path) -> list[float]:
    """Milliseconds a chunk on one core: median and worst of thirty."""
    import torch

    torch.set_num_threads(1)
    student = _context(path)[2]
    rng, spent = np.random.default_rng(0), []
    for _ in range(33):
        pictures = rng.integers(0, 255, (1, len(VIEWS), student.picture, student.picture, 3)).astype(np.uint8)
        begun = time.perf_counter()
        student(pictures, np.zeros((1, len(STATE_NAMES))))
        spent.append(1000 * (time.perf_counter() - begun))
    return [round(float(np.median(spent[3:])), 1), round(max(spent[3:]), 1)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("library", type=Path, nargs="+")
    parser.add_argument("--worlds", type=int, default=200)
    parser.add_argument("--looks", nargs="+", default=list(LOOKS), choices=list(LOOKS))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--physics", choices=["shipped", "reference"], default="shipped")
    args = parser.parse_args()
    reference = args.physics == "reference"
    for path in args.library:
        result: dict[str, object] = {"library": load_library(path).content_hash[:12]}
        for looks in args.looks:
            jobs = [(looks, FRESH + i, reference) for i in range(0, args.worlds, BATCH)]
            found = [row for rows in parallel_map(_both, jobs, partial(_context, path), args.workers) for row in rows]
            taught, learned, said = (sum(column) for column in zip(*found, strict=True))
            low, high = wilson(learned, len(found))
            result[looks] = {
                "worlds": len(found),
                "teacher": taught,
                "student": learned,
                "said_done": said,
                "student_ci95": [round(low, 3), round(high, 3)],
                "share_of_teacher": round(learned / max(1, taught), 3),
            }
        result["inference_ms_median_and_worst"] = _inference_ms(path)
        print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main()
