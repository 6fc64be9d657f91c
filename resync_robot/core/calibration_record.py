"""What a rig file says about how its cameras were calibrated, and whether that is still good enough to deploy with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any

from resync_robot.core.errors import ConfigError
from resync_robot.core.ranges import RANGES, read_number
from resync_robot.core.tables import check_names, shown


@dataclass(frozen=True, kw_only=True)
class CalibrationRecord:
    """The `[cameras.calibration]` table of one camera.

    Attributes:
        calibrated, checked: ISO dates (YYYY-MM-DD) of the calibration and of the last check of it.
        method: how the pose was found.
        views, left_out: pictures used, and pictures found to disagree with the others and left out.
        held_out_mm, held_out_deg, held_out_px: root mean square error on views that the calibration did not see:
            where the board is located, how it is turned, and where its corners appear.
    """

    calibrated: str
    checked: str
    method: str
    views: int
    left_out: int
    held_out_mm: float
    held_out_deg: float
    held_out_px: float


@dataclass(frozen=True, kw_only=True)
class CalibrationLimits:
    """The `[calibration_limits]` table: from which age or error on a deployment warns. Every field may be left out."""

    max_age_days: float = 90.0
    """Days since the last check."""
    max_mm: float = 3.0
    """Of the position at which the board is located; blocks have 1.5 mm of clearance, and a scan averages views."""
    max_deg: float = 1.0
    max_px: float = 1.0
    """Of the board's corners; a camera that was knocked shows here first."""


def read_record(table: Any, where: str) -> CalibrationRecord:
    """The record of a `[cameras.calibration]` table.

    Raises:
        ConfigError: a missing, extra, mistyped or implausible field.
    """
    check_names(table, CalibrationRecord, where, whole=True)
    for name in ("calibrated", "checked"):
        try:
            date.fromisoformat(table[name])
        except (TypeError, ValueError):
            raise ConfigError(
                f'{where}: {name} must be a date such as "2026-01-31", not {shown(table[name])}'
            ) from None
    if not isinstance(table["method"], str):
        raise ConfigError(f"{where}: method must be text, not {shown(table['method'])}")
    read: dict[str, Any] = dict(table)
    for name in ("views", "left_out", "held_out_mm", "held_out_deg", "held_out_px"):
        allowed = RANGES[f"cameras.calibration.{name}"]
        number = read_number(table[name], allowed, f"{where}: {name}")
        read[name] = int(number) if allowed.whole else number
    return CalibrationRecord(**read)


def read_limits(table: Any, where: str) -> CalibrationLimits:
    """The limits of a `[calibration_limits]` table. Raises ConfigError as `read_record` does."""
    check_names(table, CalibrationLimits, where, whole=False)
    return CalibrationLimits(
        **{n: read_number(v, RANGES[f"calibration_limits.{n}"], f"{where}: {n}") for n, v in table.items()}
    )


def complaints(
    records: Mapping[str, CalibrationRecord | None], limits: CalibrationLimits, today: date, expected: bool = True
) -> list[str]:
    """What a deployment should not trust without a word, a line each.

    Args:
        records: by camera name.
        expected: complain of a camera without a record too.
    """
    found = []
    never = [f"'{name}'" for name, record in records.items() if record is None]
    if never and expected:
        found.append(
            f"camera {never[0]} has never been calibrated"
            if len(never) == 1
            else f"cameras {', '.join(never[:-1])} and {never[-1]} have never been calibrated"
        )
    for name, record in records.items():
        if record is None:
            continue
        age = (today - date.fromisoformat(record.checked)).days
        if age > limits.max_age_days:
            found.append(
                f"the calibration of camera '{name}' was last checked {age} days ago, on {record.checked}; "
                f"allowed: {limits.max_age_days:g} days"
            )
        if age < 0:
            found.append(f"the calibration of camera '{name}' was checked on {record.checked}, which is still to come")
        for value, limit, unit in (
            (record.held_out_mm, limits.max_mm, "mm"),
            (record.held_out_deg, limits.max_deg, "degrees"),
            (record.held_out_px, limits.max_px, "px"),
        ):
            if value > limit:
                found.append(f"camera '{name}' was {value:.2f} {unit} off on views held out; allowed: {limit:g} {unit}")
    return found
