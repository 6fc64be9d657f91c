"""How often the learned recovery, followed by the real skill that had failed, succeeds in fresh randomised worlds.

python tests/benchmarks/recovery_success.py RUN_FOLDER [--worlds 200] [--workers 2] [--physics reference]
"""

from __future__ import annotations

import argparse
from pathlib import Path

from resync_robot.core.intervals import wilson
from resync_robot.core.library import load_library
from resync_robot.core.rig import load_rig
from resync_robot.curriculum.run_folder import RunFolder
from resync_robot.curriculum.stages import PRESETS, check_recovery, mine
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.physics.solver import REFERENCE

FRESH = 900_000_000
"""First world seed; training seeds stay far below it."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--worlds", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--physics", choices=["shipped", "reference"], default="shipped")
    args = parser.parse_args()
    solver = REFERENCE if args.physics == "reference" else None
    library = load_library(args.run / "library")
    domain = find_domain(library.domain)
    quiet = lambda share, figure: None  # noqa: E731
    mined = mine(domain, RunFolder(args.run), PRESETS["quick"], 0, 1, quiet)
    found = check_recovery(
        domain, load_rig(), mined, library.skills[domain.recovery], FRESH, args.worlds, args.workers, quiet, solver
    )
    low, high = wilson(found["picked"], found["worlds"])
    rate = f"{found['picked']} of {found['worlds']} recovered and then picked"
    print(f"{rate} [{low:.3f}, {high:.3f}]; beta fired in {found['beta']}")


if __name__ == "__main__":
    main()
