"""Names of the actuated joints and the target a skill asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

ARM_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
"""UR arm joints, base to flange. Vectors of six follow this order; drivers map them by name."""


@dataclass(frozen=True, slots=True)
class JointTarget:
    """Where the robot should be at the end of one control period.

    Attributes:
        arm: (6,) joint positions in rad, in the order of ARM_JOINTS.
        opening: free distance between the finger pads in m.
    """

    arm: Float[np.ndarray, "6"]
    opening: float

    @property
    def by_name(self) -> dict[str, float]:
        return dict(zip(ARM_JOINTS, map(float, self.arm), strict=True))
