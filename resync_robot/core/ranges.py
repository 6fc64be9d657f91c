"""The plausible range of every number in a rig file, and the unit that one outside of it was probably meant in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from resync_robot.core.errors import ConfigError
from resync_robot.core.tables import finite, shown

DEGREES = np.pi / 180
FAR = 2.0
"""How many times a bound a number has to be before another unit is suggested."""


@dataclass(frozen=True)
class Range:
    """What a number may be, ends included.

    Attributes:
        unit: as a message names it; '' for a plain count.
        count: how many such numbers the field is a list of; 1 for a number by itself.
        whole: no fractions.
    """

    low: float
    high: float
    unit: str = ""
    count: int = 1
    whole: bool = False

    def __str__(self) -> str:
        return f"{_short(self.low)} to {self.told(self.high)}"

    def told(self, number: float) -> str:
        """The number for a message."""
        return f"{_short(number)} {'' if self.unit == 'share' else self.unit}".strip()


MISTAKEN: Mapping[str, tuple[tuple[str, float], ...]] = {
    "m": (("mm", 1e-3),),
    "rad": (("degrees", DEGREES),),
    "rad/s": (("degrees/s", DEGREES),),
    "rad/s^2": (("degrees/s^2", DEGREES),),
    "rad/s^3": (("degrees/s^3", DEGREES),),
    "s": (("ms", 1e-3),),
    "kg": (("g", 1e-3),),
    "mm": (("m", 1e3), ("um", 1e-3)),
    "share": (("percent", 1e-2),),
    "turns": (("degrees", 1 / 360),),
}
"""By the right unit: those that are written in its place, and what one of them is in the right one."""

RANGES: Mapping[str, Range] = {
    # 'world_T_base' and 'pose' by their position; the quaternion is checked by its norm.
    "arm.world_T_base": Range(-5.0, 5.0, "m"),
    "arm.home": Range(-2 * np.pi, 2 * np.pi, "rad", 6),
    "arm.velocity_limit": Range(0.01, 2 * np.pi, "rad/s", 6),
    "arm.acceleration_limit": Range(0.1, 40.0, "rad/s^2", 6),
    "arm.jerk_limit": Range(1.0, 5000.0, "rad/s^3", 6),
    "controller.payload": Range(0.0, 20.0, "kg"),
    "controller.payload_centre": Range(-0.3, 0.3, "m", 3),
    "controller.lead": Range(0.004, 0.2, "s"),
    "controller.freshness": Range(0.02, 0.5, "s"),
    "controller.watchdog": Range(2.0, 100.0, "Hz"),
    "controller.gripper_table": Range(0.0, 0.2, "m"),
    "controller.gripper_force": Range(0.0, 1.0, "share"),
    "controller.force_limit": Range(10.0, 500.0, "N"),
    "controller.workspace_low": Range(-5.0, 5.0, "m", 3),
    "controller.workspace_high": Range(-5.0, 5.0, "m", 3),
    "gripper.tip_offset": Range(0.05, 0.5, "m"),
    "gripper.max_opening": Range(0.01, 0.2, "m"),
    "gripper.max_force": Range(1.0, 300.0, "N"),
    "gripper.finger_thickness": Range(0.001, 0.1, "m"),
    "gripper.finger_width": Range(0.001, 0.2, "m"),
    "cameras.pose": Range(-5.0, 5.0, "m"),
    "cameras.width": Range(16, 8192, "px", whole=True),
    "cameras.height": Range(16, 8192, "px", whole=True),
    "cameras.fx": Range(20.0, 20000.0, "px"),
    "cameras.fy": Range(20.0, 20000.0, "px"),
    "cameras.cx": Range(0.0, 8192.0, "px"),
    "cameras.cy": Range(0.0, 8192.0, "px"),
    "cameras.position_sigma": Range(0.0, 0.1, "m"),
    "cameras.rotation_sigma": Range(0.0, 0.175, "rad"),
    "cameras.calibration.views": Range(0, 10000, whole=True),
    "cameras.calibration.left_out": Range(0, 10000, whole=True),
    "cameras.calibration.held_out_mm": Range(0.0, 200.0, "mm"),
    "cameras.calibration.held_out_deg": Range(0.0, 45.0, "degrees"),
    "cameras.calibration.held_out_px": Range(0.0, 500.0, "px"),
    "cameras.noise.focal_at_848_px": Range(20.0, 20000.0, "px"),
    "cameras.noise.baseline": Range(0.005, 0.5, "m"),
    "cameras.noise.disparity_sigma_px": Range(0.0, 5.0, "px"),
    "cameras.noise.disparity_step_px": Range(1e-4, 2.0, "px"),
    "cameras.noise.ripple_px": Range(0.0, 5.0, "px"),
    "cameras.noise.least_depth_at_848": Range(0.0, 2.0, "m"),
    "cameras.noise.edge_step": Range(0.0, 0.5, "m"),
    "cameras.noise.flying_share": Range(0.0, 1.0, "share"),
    "cameras.noise.edge_hole_share": Range(0.0, 1.0, "share"),
    "cameras.noise.hole_share": Range(0.0, 1.0, "share"),
    "cameras.noise.exposure_sigma": Range(0.0, 1.0, "share"),
    "cameras.noise.white_balance_sigma": Range(0.0, 1.0, "share"),
    "cameras.noise.exposure_time": Range(0.0, 1.0, "s"),
    "cameras.noise.depth_exposure_time": Range(0.0, 1.0, "s"),
    "cameras.noise.colour_sigma": Range(0.0, 100.0, "of 255"),
    "calibration_limits.max_age_days": Range(0.0, 3650.0, "days"),
    "calibration_limits.max_mm": Range(0.05, 100.0, "mm"),
    "calibration_limits.max_deg": Range(0.01, 45.0, "degrees"),
    "calibration_limits.max_px": Range(0.05, 100.0, "px"),
    "hues": Range(0.0, 1.0, "turns"),
}
"""By table and field. Wide enough for every machine; what one arm or gripper allows is checked besides."""


def read_number(value: Any, allowed: Range, where: str) -> float:
    """The number of a file.

    Raises:
        ConfigError: it is none, or outside its range.
    """
    number = finite(value)
    if number is None or (allowed.whole and not number.is_integer()):
        raise ConfigError(f"{where} must be {'a whole number' if allowed.whole else 'a number'}, not {shown(value)}")
    require(number, allowed, where)
    return number


def read_numbers(value: Any, allowed: Range, where: str) -> np.ndarray:
    """The (count,) numbers of a list in a file. Raises ConfigError as `read_number` does."""
    numbers = [finite(v) for v in value] if isinstance(value, list) else []
    if len(numbers) != allowed.count or None in numbers:
        raise ConfigError(f"{where} must be {allowed.count} numbers, not {shown(value)}")
    vector = np.array(numbers, dtype=np.float64)
    require(vector, allowed, where)
    return vector


def require(values: float | np.ndarray, allowed: Range, where: str) -> None:
    """Raises ConfigError where a number is outside its range, with the unit that it was probably meant in."""
    numbers = np.atleast_1d(values).tolist()
    for place, number in enumerate(numbers, start=1):
        if not allowed.low <= number <= allowed.high:
            which = f", number {place} of {len(numbers)}," if len(numbers) > 1 else ""
            raise ConfigError(f"{where}{which} is {allowed.told(number)}; allowed: {allowed}", _likely(number, allowed))


def _likely(number: float, allowed: Range) -> str:
    """What it would be in another unit; nothing where it lies so near that the right unit is as likely."""
    if allowed.low / FAR <= abs(number) <= allowed.high * FAR:
        return ""
    for unit, factor in MISTAKEN.get(allowed.unit, ()):
        if allowed.low <= number * factor <= allowed.high:
            return f"{_short(number)} looks like {unit}: {allowed.told(float(f'{number * factor:.3g}'))}"
    return ""


def _short(number: float) -> str:
    return f"{number:.4g}" if abs(number) < 1e4 or abs(number) >= 1e15 else f"{number:.0f}"
