"""Demonstrations in memory: what the simulation records and a camera policy learns from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8


@dataclass(frozen=True)
class Demonstrations:
    """n frames of recoveries, segment after segment.

    Attributes:
        pictures: (n, views, p, p, 3), RGB.
        state: (n, 21), as in `camera_view.STATE_NAMES`.
        action: (n, 3) m, the step that followed the one under way, in the hand's axes.
        recovered: (n,) was it time to stop? A margin beyond where the failed skill begins to succeed.
        free: (n,) would the failed skill succeed?
        block: (n, 7), as in `camera_view.BLOCK_NAMES`.
        acts: (n,) is the action known? A moment without motion has none.
        segment: (n,) which segment a frame belongs to.
        ends: (n,) does that segment end with the recovery, rather than in the middle of one?
    """

    pictures: UInt8[np.ndarray, "n v p p 3"]
    state: Float[np.ndarray, "n s"]
    action: Float[np.ndarray, "n 3"]
    recovered: Bool[np.ndarray, " n"]
    free: Bool[np.ndarray, " n"]
    block: Float[np.ndarray, "n 7"]
    acts: Bool[np.ndarray, " n"]
    segment: Int[np.ndarray, " n"]
    ends: Bool[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.state)
