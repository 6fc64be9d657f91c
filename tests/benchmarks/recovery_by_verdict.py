"""The recovery of Cornered Insertion-S, learned by nothing but the real Pick's verdict, and then followed by it.

python tests/benchmarks/recovery_by_verdict.py [--seed 0] [--workers 2] [--shaping 3] [--worlds 200] [--out FOLDER]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from safetensors.numpy import save_file

from resync_robot.core.intervals import wilson
from resync_robot.core.rig import load_rig
from resync_robot.curriculum.arm_recovery import RECOVERY, learn_arm_recovery
from resync_robot.curriculum.run_folder import RunFolder
from resync_robot.curriculum.stages import PRESETS, check_recovery, mine
from resync_robot.sim_training.domains import find_domain

FRESH = 970_000_000
"""First world seed; training seeds stay far below it, and those of reported tables are others."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--worlds", type=int, default=200)
    parser.add_argument("--shaping", type=float, help="0: the verdict alone")
    parser.add_argument("--steps", type=int, help="budget in control steps")
    parser.add_argument("--out", type=Path, help="keep what was learned in this folder, and go on with it")
    args = parser.parse_args()
    with TemporaryDirectory() as temporary:
        print(json.dumps(_measured(args, args.out or Path(temporary))))


def _measured(args: argparse.Namespace, folder: Path) -> dict[str, object]:
    domain, rig, quiet = find_domain("cornered-insertion-s"), load_rig(), lambda share, figure: None
    run, preset, begun = RunFolder(folder), PRESETS["quick"], time.monotonic()
    mined = mine(domain, run, preset, args.seed, args.workers, quiet)
    mining, begun = time.monotonic() - begun, time.monotonic()
    s = RECOVERY
    if args.shaping is not None:
        s = replace(s, judged=replace(s.judged, shaping=args.shaping))
    if args.steps is not None:
        s = replace(s, ppo=replace(s.ppo, total_steps=args.steps, least_steps=min(args.steps, s.ppo.least_steps)))

    def progress(steps: int, budget: int, rate: float) -> None:
        print(f"{steps} {rate:.3f} {time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)

    checkpoint = folder / "ppo.safetensors"
    record, after, figures = learn_arm_recovery(
        domain.spec, rig, mined, args.seed, args.workers, checkpoint, progress, s
    )
    learning = time.monotonic() - begun
    save_file({k: np.ascontiguousarray(v) for k, v in record.tensors.items()}, folder / "recovery.safetensors")
    (folder / "recovery.json").write_text(json.dumps({**record.meta, "after": after.to_json()}), encoding="utf-8")
    found = check_recovery(domain, rig, mined, record, FRESH, args.worlds, args.workers, quiet)
    low, high = wilson(found["picked"], found["worlds"])
    return {
        "seed": args.seed,
        **{k: v for k, v in figures.items() if k != "curve"},
        "mining_minutes": round(mining / 60, 2),
        "minutes": round(learning / 60, 2),
        **found,
        "rate": [round(found["picked"] / found["worlds"], 4), round(low, 4), round(high, 4)],
        "after": after.mean.round(4).tolist(),
        "curve": figures["curve"],
    }


if __name__ == "__main__":
    main()
