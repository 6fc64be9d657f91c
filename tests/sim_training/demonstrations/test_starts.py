"""Where demonstrations begin: still moments between the corner and the middle."""

from __future__ import annotations

import numpy as np
import torch

from resync_robot.core.rig import load_rig
from resync_robot.learning.recovery_policy import BLOCK, BOX, COMMANDED, TIP, tip_above_stud, wall_gaps
from resync_robot.sim_training.demonstrations.starts import draw_still
from resync_robot.sim_training.failed_worlds import FailedWorlds
from tests import scenes
from tests.scenes import B0, CORNER


def test_still_states_lie_between_the_corner_and_the_middle_with_the_hand_over_the_block() -> None:
    tasks = [scenes.scene({"b0": (sx * CORNER, sy * CORNER)}) for sx in (1, -1) for sy in (1, -1)]
    worlds = FailedWorlds(tasks, B0, load_rig(), np, torch.device("cpu"))
    x = worlds.failures[torch.arange(2000) % 4]
    still = draw_still(x, torch.Generator().manual_seed(0))
    gaps = wall_gaps(still).min(-1).values
    assert gaps.min() >= 0 and 0.2 < (gaps > 0.04).float().mean() < 0.8, "some are free, some are not"
    assert tip_above_stud(still).min() >= 0 and 0.08 < tip_above_stud(still).max() <= 0.1 + 1e-6
    assert torch.equal(still[:, TIP], still[:, COMMANDED])
    assert (still[:, TIP][:, :2] - still[:, BLOCK][:, :2]).abs().max() <= 0.03 + 1e-6
    assert torch.equal(still[:, BOX], x[:, BOX])
    assert torch.equal(still, draw_still(x, torch.Generator().manual_seed(0)))
