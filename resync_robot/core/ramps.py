"""How a way is divided into steps: at full speed, but for a smooth ramp at either end."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def ramped(cruise: float, ramp: float, period: float) -> Float[np.ndarray, "n"]:
    """Shares of a way after each period, from rest to rest at 1; at least one of them.

    The speed rises as a cosine from 0 to full. A way that is too short for full speed keeps the ramps' acceleration,
    and so is slower: full speed times pi / 2 over `ramp`.

    Args:
        cruise: s that the whole way takes at full speed.
        ramp: s from rest to full speed.
        period: s between two steps.
    """
    if cruise < ramp:
        cruise = ramp = float(np.sqrt(cruise * ramp))
    steps = max(1, int(np.ceil((cruise + ramp) / period)))
    # Of a whole number of periods, which is a little longer.
    t = np.arange(1, steps + 1) / steps * (cruise + ramp)
    if ramp == 0.0:
        return t / cruise if cruise else np.ones(1)

    def risen(t: np.ndarray) -> np.ndarray:
        return t / 2 - ramp / (2 * np.pi) * np.sin(np.pi * t / ramp)

    gone = np.where(t < ramp, risen(t), t - ramp / 2)
    gone = np.where(t > cruise, cruise - risen(cruise + ramp - t), gone)
    gone[-1] = cruise
    return np.asarray(gone / cruise)
