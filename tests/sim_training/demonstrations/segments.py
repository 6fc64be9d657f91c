"""Segments of demonstrations with anything in them."""

from __future__ import annotations

import numpy as np

from resync_robot.learning.camera_view import BLOCK_NAMES, STATE_NAMES
from resync_robot.sim_training.demonstrations.rollouts import Segment

TASK, ROBOT = "Recover", "ur7e_2f-140"


def segment(n: int = 5, ends: bool = True) -> Segment:
    """n frames; the pictures are coarse squares."""
    rng = np.random.default_rng(n)
    pictures = np.kron(rng.integers(0, 255, (n, 3, 8, 8, 3)), np.ones((1, 1, 8, 8, 1))).astype(np.uint8)
    rows = [rng.normal(size=(n, k)).astype(np.float32) for k in (len(STATE_NAMES), 3, len(BLOCK_NAMES))]
    recovered = rng.random(n) > 0.5
    free = recovered | (rng.random(n) > 0.5)
    return Segment(pictures, rows[0], rows[1], recovered, free, rows[2], np.ones(n, dtype=bool), ends)
