"""How one field of a rig file is read: its kind by name, its range by `core.ranges`."""

from __future__ import annotations

import ipaddress
from typing import Any

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.errors import ConfigError
from resync_robot.core.machines import ARMS, GRIPPERS
from resync_robot.core.ranges import RANGES, Range, read_number, read_numbers, require
from resync_robot.core.tables import finite, shown

_POSES = ("arm.world_T_base", "cameras.pose")
_FLAGS = ("controller.full_speed", "controller.emulated")
_KNOWN = {
    "arm.model": tuple(ARMS),
    "gripper.model": tuple(GRIPPERS),
    "cameras.mount": ("flange", "world"),
}
"""Fields that name one of a few things."""


def read_field(value: Any, field: str, where: str) -> Any:
    """The value of a field, such as 'arm.home', as the dataclasses of a rig hold it.

    Args:
        where: file, table and field, for a message.

    Raises:
        ConfigError: it is of another kind, unknown, or outside its range.
    """
    if field in _POSES:
        return _pose(value, RANGES[field], where)
    if field == "controller.gripper_table":
        return _gripper_table(value, RANGES[field], where)
    if field in _FLAGS:
        if not isinstance(value, bool):
            raise ConfigError(f"{where} must be true or false, not {shown(value)}")
        return value
    allowed = RANGES.get(field)
    if allowed is None:
        return _text(value, field, where)
    if allowed.count > 1:
        return read_numbers(value, allowed, where)
    number = read_number(value, allowed, where)
    return int(number) if allowed.whole else number


def _text(value: Any, field: str, where: str) -> str:
    if not isinstance(value, str):
        raise ConfigError(f"{where} must be text, not {shown(value)}")
    if field == "controller.address":
        try:
            return str(ipaddress.IPv4Address(value))
        except ValueError:
            raise ConfigError(f"{where} is '{value}'", "give an IPv4 address such as 192.168.1.10") from None
    known = _KNOWN.get(field)
    if known is not None and value not in known:
        raise ConfigError(f"{where} is '{value}'", f"allowed: {', '.join(known)}")
    return value


def _pose(value: Any, allowed: Range, where: str) -> Float[np.ndarray, "4 4"]:
    numbers = [finite(v) for v in value] if isinstance(value, list) else []
    if len(numbers) != 7 or None in numbers:
        raise ConfigError(f"{where} must be 7 numbers, not {shown(value)}", "write it as x y z (m) and w x y z")
    vector = np.array(numbers, dtype=np.float64)
    require(vector[:3], allowed, where)
    norm = float(np.linalg.norm(vector[3:]))
    if not abs(norm - 1.0) <= 1e-3:
        raise ConfigError(f"{where}: the quaternion has norm {norm:.3f}, it must be 1 (w x y z)")
    return spatial.pose_from_features(vector)


def _gripper_table(value: Any, allowed: Range, where: str) -> Float[np.ndarray, "n 2"]:
    try:
        table = np.array(value, dtype=np.float64).reshape(-1, 2)
    except (OverflowError, TypeError, ValueError):
        table = np.empty((0, 2))
    counts, openings = table[:, 0], table[:, 1]
    rising, falling = bool(np.all(np.diff(counts) > 0)), bool(np.all(np.diff(openings) < 0))
    if len(table) < 2 or not (rising and falling and counts[0] >= 0 and counts[-1] <= 255 and openings[-1] >= 0):
        raise ConfigError(
            f"{where} must be pairs of counts that rise to 255 at most and openings in m that fall, not {shown(value)}",
            "measure them: gripper_table = [[3, 0.14], [230, 0.0]]",
        )
    require(openings, allowed, where)
    return table
