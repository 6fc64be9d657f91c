"""What the makers say of the arms and grippers that a rig may have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

DEGREES = np.pi / 180


@dataclass(frozen=True, kw_only=True)
class ArmModel:
    """Attributes: `title` as its maker writes it; `speed` (6,) rad/s of each joint; `payload` kg; `reach` m."""

    title: str
    speed: tuple[float, ...]
    payload: float
    reach: float
    joint_limit: tuple[float, ...] = tuple(DEGREES * d for d in (360.0, 360.0, 180.0, 360.0, 360.0, 360.0))
    """rad to either side. The elbow turns further, but into the upper arm."""


@dataclass(frozen=True, kw_only=True)
class GripperModel:
    """Attributes: `stroke` m between the pads; `force` N; `speed` m/s of opening, least and most."""

    title: str
    stroke: float
    force: tuple[float, float]
    speed: tuple[float, float]


ARMS: Mapping[str, ArmModel] = {
    "ur7e": ArmModel(title="UR7e", speed=(DEGREES * 180,) * 6, payload=7.5, reach=0.85),
}
GRIPPERS: Mapping[str, GripperModel] = {
    "2f-140": GripperModel(title="2F-140", stroke=0.140, force=(10.0, 125.0), speed=(0.030, 0.250)),
}
