"""What a rig file says about its calibration is read strictly, and judged by its age and its errors."""

from __future__ import annotations

from dataclasses import asdict, replace
from datetime import date
from importlib.resources import files
from pathlib import Path

import pytest

from resync_robot.core.calibration_record import (
    CalibrationLimits,
    CalibrationRecord,
    complaints,
    read_limits,
    read_record,
)
from resync_robot.core.errors import ConfigError
from resync_robot.core.rig import load_rig

GOOD = CalibrationRecord(
    calibrated="2026-01-01", checked="2026-03-01", method="eye-in-hand", views=20, left_out=1,
    held_out_mm=0.5, held_out_deg=0.2, held_out_px=0.3,
)  # fmt: skip
BUILT_IN = files("resync_robot.core").joinpath("simulated_rig.toml").read_text()


def test_a_record_is_read_as_written() -> None:
    assert read_record(asdict(GOOD), "here") == GOOD
    assert read_limits({}, "here") == CalibrationLimits()
    assert read_limits({"max_mm": 1}, "here").max_mm == 1


@pytest.mark.parametrize("name", [*asdict(GOOD)])
def test_every_field_is_needed_and_checked(name: str) -> None:
    table = asdict(GOOD)
    missing = {k: v for k, v in table.items() if k != name}
    with pytest.raises(ConfigError, match=f"here has no field {name}"):
        read_record(missing, "here")
    for wrong in ([], True, float("nan")):
        with pytest.raises(ConfigError, match=f"here: {name} must be"):
            read_record({**table, name: wrong}, "here")
    with pytest.raises(ConfigError, match=f"here: {name} (must be|is -1)"):
        read_record({**table, name: -1}, "here")


def test_what_is_no_such_table_is_refused() -> None:
    with pytest.raises(ConfigError, match="unknown field colour"):
        read_record({**asdict(GOOD), "colour": 1}, "here")
    with pytest.raises(ConfigError, match="must be a table"):
        read_record(3, "here")
    with pytest.raises(ConfigError, match="unknown field max_furlongs"):
        read_limits({"max_furlongs": 1}, "here")
    with pytest.raises(ConfigError, match="max_mm must be a number"):
        read_limits({"max_mm": "1"}, "here")
    with pytest.raises(ConfigError, match=r"0\.003 looks like m: 3 mm"):
        read_limits({"max_mm": 0.003}, "here")


def said(record: CalibrationRecord | None, today: str = "2026-03-31", expected: bool = True) -> list[str]:
    return complaints({"wrist": record}, CalibrationLimits(), date.fromisoformat(today), expected)


def test_a_fresh_and_good_calibration_is_not_complained_of() -> None:
    assert said(GOOD) == []
    assert said(GOOD, "2026-05-30") == []


@pytest.mark.parametrize(
    ("change", "today", "word"),
    [
        ({}, "2026-05-31", "91 days ago"),
        ({}, "2026-02-28", "still to come"),
        ({"held_out_mm": 3.1}, "2026-03-31", "3.10 mm off"),
        ({"held_out_deg": 1.5}, "2026-03-31", "1.50 degrees off"),
        ({"held_out_px": 2.0}, "2026-03-31", "2.00 px off"),
    ],
)
def test_what_is_old_or_bad_is_complained_of(change: dict, today: str, word: str) -> None:
    (line,) = said(replace(GOOD, **change), today)
    assert word in line and "wrist" in line


def test_a_camera_without_a_record_is_complained_of_where_one_is_expected() -> None:
    assert "never been calibrated" in said(None)[0]
    assert said(None, expected=False) == []


def test_cameras_that_have_never_been_calibrated_are_told_together() -> None:
    none = dict.fromkeys(("front", "side", "wrist"))
    assert complaints(none, CalibrationLimits(), date(2026, 3, 31)) == [
        "cameras 'front', 'side' and 'wrist' have never been calibrated"
    ]


def test_a_rig_file_carries_records_and_limits(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    record = "\n".join(f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v}" for k, v in asdict(GOOD).items())
    path.write_text(f"{BUILT_IN}\n[cameras.calibration]\n{record}\n[calibration_limits]\nmax_age_days = 7\n")
    rig = load_rig(path)
    assert rig.camera("side").calibration == GOOD
    assert rig.camera("wrist").calibration is None
    assert rig.calibration_limits == CalibrationLimits(max_age_days=7)
    path.write_text(f"{BUILT_IN}\n[cameras.calibration]\nviews = 3\n")
    with pytest.raises(ConfigError, match=r"cameras\.2\.calibration\] has no fields calibrated"):
        load_rig(path)
