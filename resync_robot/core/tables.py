"""Tables of a rig file, read into dataclasses: fields that are missing, unknown or of the wrong kind."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from resync_robot.core.errors import ConfigError


def check_names(table: Any, kind: type, where: str, whole: bool, besides: Sequence[str] = ()) -> None:
    """Raises ConfigError where a table of a file has fields that the dataclass `kind` has not, or lacks some.

    Args:
        whole: every field must be there.
        besides: fields of the dataclass that such a table does not state.
    """
    if not isinstance(table, Mapping):
        raise ConfigError(f"{where} must be a table, not {shown(table)}")
    known = [f.name for f in fields(kind) if f.name not in besides]
    extra = sorted(set(table) - set(known))
    missing = sorted(set(known) - set(table)) if whole else []
    if extra or missing:
        parts = [
            f"{what} field{'s' * (len(names) > 1)} {', '.join(names)}"
            for what, names in (("unknown", extra), ("no", missing))
            if names
        ]
        raise ConfigError(f"{where} has {' and '.join(parts)}", f"its fields are {', '.join(known)}")


def finite(value: Any) -> float | None:
    """The value of a file as a finite number, or None where it is none; an integer may be too long for one."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def shown(value: Any) -> str:
    """The value of a file for a message. Python refuses to write out an integer of thousands of digits."""
    try:
        return repr(value)
    except ValueError:
        return "one with a number of thousands of digits"
