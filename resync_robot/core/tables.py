"""Tables of a rig file, read into dataclasses: fields that are missing, unknown or of the wrong kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from resync_robot.core.errors import ConfigError


def check_names(table: Any, kind: type, where: str, whole: bool) -> None:
    """Raises ConfigError where a table of a file has fields that the dataclass `kind` has not, or lacks some.

    Args:
        whole: every field must be there.
    """
    if not isinstance(table, Mapping):
        raise ConfigError(f"{where} must be a table, not {table!r}")
    known = [f.name for f in fields(kind)]
    extra = sorted(set(table) - set(known))
    missing = sorted(set(known) - set(table)) if whole else []
    if extra or missing:
        parts = [f"{what} {', '.join(names)}" for what, names in (("unknown", extra), ("no", missing)) if names]
        raise ConfigError(f"{where} has {' and '.join(parts)}", f"its fields are {', '.join(known)}")


def check_number(value: Any, where: str) -> None:
    """Raises ConfigError unless it is a finite number from 0 on."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value) or value < 0:
        raise ConfigError(f"{where} must be a number from 0 on, not {value!r}")
