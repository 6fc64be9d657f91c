"""How long the camera policy's training takes on this machine, by what takes it.

    python tests/benchmarks/distil_time.py RUN_FOLDER --out FOLDER [--plan quick] [--device cuda] [--workers 16]

RUN_FOLDER is one of `train-sim`; its recovery is the teacher. `--plan quick` is the whole camera stage of that preset;
`large` has the student and the pictures of `full` and a fraction of its worlds and steps, for the rates. Prints JSON:
seconds of demonstrations, training and trials, worlds and training steps a second, and how often each candidate
recovered.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

from resync_robot.core.library import load_library
from resync_robot.curriculum.distil import PLANS, distil
from resync_robot.curriculum.run_folder import RunFolder
from resync_robot.curriculum.stage_folder import StageFolder
from resync_robot.sim_training.domains import find_domain
from tests.libraries import gaussians_of

LARGE = replace(PLANS["full"], worlds=256, rounds=0, steps=1500, trials=32)


class _Clock:
    """Adds up the time between reports of progress by what is reported at its end."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._last = time.perf_counter()

    def __call__(self, share: float, words: str) -> None:
        now = time.perf_counter()
        kind = "demonstrations" if words.startswith("turn") else "training" if "frames" in words else "trials"
        self.seconds[kind] += now - self._last
        self._last = now
        print(f"{share:.2f} {words}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--plan", choices=["smoke", "quick", "large"], default="quick")
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    library = load_library(args.run / "library")
    domain = find_domain(library.domain)
    gaussians = gaussians_of(library)
    plan = LARGE if args.plan == "large" else PLANS[args.plan]
    folder, clock = StageFolder(RunFolder(args.out), 1, domain.recovery), _Clock()
    distil(domain, folder, plan, library.skills[domain.recovery], gaussians, 0, args.workers, args.device, clock)
    worlds, steps = plan.worlds + plan.rounds * plan.round_worlds, plan.steps + plan.rounds * plan.round_steps
    seconds = {kind: round(value, 1) for kind, value in clock.seconds.items()}
    rates = {
        "worlds/s": round(worlds / clock.seconds["demonstrations"], 2),
        "steps/s": round(steps / clock.seconds["training"], 2),
        "trials/s": round((plan.rounds + 1) * plan.trials / clock.seconds["trials"], 2),
    }
    points = json.loads((folder.path / "distil.json").read_text("utf-8"))
    print(json.dumps({"plan": args.plan, "device": args.device, "workers": args.workers, **seconds, **rates}))
    print(json.dumps(points))


if __name__ == "__main__":
    main()
