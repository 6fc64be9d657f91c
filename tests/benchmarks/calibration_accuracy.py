"""How well a camera is found from 20 poses, whether the error reported is the true one, and which bad views are found.

    python tests/benchmarks/calibration_accuracy.py --seeds 20

The poses are those that the calibration proposes for the built-in rig, whose camera and board are then moved a little.
Boards are projected into its 424 x 240 camera with 0.25 px of noise; the arm misreports its flange by 0.3 mm an axis.
About 8 s of one core for a seed and mount.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from resync_robot.calibration.hand_eye import Calibrator, difference
from resync_robot.calibration.judge import held_out, judge
from resync_robot.calibration.propose import Proposer, board_in_hand, board_on_table
from resync_robot.core.rig import load_rig
from tests.calibration import synthetic

POSES, ROUNDS = 20, 6


def proposed(arm_moves_board: bool, seed: int) -> list[np.ndarray]:
    """world_T_flange of some 30 poses."""
    rig = load_rig()
    camera = rig.camera("front" if arm_moves_board else "wrist")
    spec = synthetic.SPEC
    board = board_in_hand(spec, rig) if arm_moves_board else board_on_table(spec, (0.48, 0.0))
    configurations = Proposer(rig, camera, spec, board)(30, seed)
    order = np.random.default_rng(seed).permutation(len(configurations))
    return [rig.arm.world_T_base @ rig.arm.kinematics.forward(configurations[i]) for i in order]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, help="how many random set-ups of each mount")
    parser.add_argument("--turn-deg", type=float, default=0.0, help="how far the arm misreports the flange's axes")
    options = parser.parse_args()
    for name, arm_moves_board in (("eye-in-hand", False), ("eye-to-base", True)):
        rows, ratios, found, blamed = [], [], 0, 0
        for seed in range(options.seeds):
            rng = np.random.default_rng([seed, arm_moves_board])
            setup = synthetic.draw_setup(rng, arm_moves_board, arm_rotation=np.radians(options.turn_deg))
            calibrator = Calibrator(synthetic.SPEC, synthetic.INTRINSICS, arm_moves_board)
            poses = proposed(arm_moves_board, seed)
            views = synthetic.views_from(rng, setup, poses)[:POSES]
            result = calibrator.solve(views)
            closed = calibrator._closed_form(views)[0]
            rows.append(
                [
                    *difference(result.mount_T_cam, setup.mount_T_cam),
                    *difference(closed, setup.mount_T_cam),
                    1000 * result.position_sigma,
                    np.degrees(result.rotation_sigma),
                ]
            )
            # The truth: many views that nobody used, against the board where it really is. Few would make the ratio a
            # figure of their own luck.
            unseen = [v for _ in range(ROUNDS) for v in synthetic.views_from(rng, setup, poses)]
            fresh = judge(calibrator, unseen, result.mount_T_cam, setup.other_T_board)
            ratios.append(np.array(held_out(calibrator, views, result).rms) / fresh.rms)
            spoilt = synthetic.spoil(rng, setup, synthetic.views_from(rng, setup, poses)[:25])
            kept = calibrator.solve(spoilt).kept
            found, blamed = found + int((~kept[:5]).sum()), blamed + int((~kept[5:]).sum())
        mm, deg, park_mm, park_deg, sigma_mm, sigma_deg = np.array(rows).T
        print(f"{name}, {options.seeds} seeds, {POSES} poses")
        print(f"  error, median / p95     {np.median(mm):.2f} / {np.percentile(mm, 95):.2f} mm")
        print(f"                          {np.median(deg):.3f} / {np.percentile(deg, 95):.3f} degrees")
        print(f"  PARK alone, median      {np.median(park_mm):.2f} mm, {np.median(park_deg):.3f} degrees")
        print(f"  error / sigma reported  {rms(mm / sigma_mm):.2f} (mm), {rms(deg / sigma_deg):.2f} (degrees), rms")
        for unit, ratio in zip(("mm", "degrees", "px"), np.array(ratios).T, strict=True):
            inside = np.mean(np.abs(ratio - 1) <= 0.2)
            print(f"  held out / true, {unit:8s} median {np.median(ratio):.2f}, within 20 % in {inside:.0%} of seeds")
        print(f"  bad views of 25: {found} of {5 * options.seeds} found, {blamed} good ones blamed")


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    main()
