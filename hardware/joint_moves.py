"""Moves between places where nothing is touched: straight in joint space, gentle at both ends, still at the end."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from resync_robot.core.joints import JointTarget
from resync_robot.core.ramps import ramped
from resync_robot.hardware.base import Motions

TRAVEL_SPEED = 1.0
"""rad/s of the fastest joint."""
RAMP_S = 0.4
"""s from rest to that speed, and back: 4 rad/s^2."""
SETTLE_S = 0.15
"""Stillness before a picture is taken."""
TARGET_PERIOD = 0.02
"""s between two targets."""


def travel(stream: Motions, q: Float[np.ndarray, "6"], speed: float = TRAVEL_SPEED) -> None:
    """Bring the arm to (6,) joint positions in rad at `speed` rad/s of the fastest joint, and let it come to rest.

    Raises:
        SafetyError: the way breaks a limit; the arm has then been braked.
    """
    opening, begin = stream.target.opening, stream.target.arm
    for s in ramped(float(np.abs(q - begin).max()) / speed, RAMP_S, TARGET_PERIOD):
        stream.run(JointTarget(begin + s * (q - begin), opening), TARGET_PERIOD)
    stream.settle(timeout=1.0)
    stream.run(JointTarget(q, opening), SETTLE_S)
