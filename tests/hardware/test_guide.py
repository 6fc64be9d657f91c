"""The guide names tests and commands that exist."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
GUIDE = (ROOT / "hardware" / "README.md").read_text()


def test_every_test_that_the_guide_names_exists() -> None:
    named = re.findall(r"`(test_\w+\.py)::(test_\w+)`", GUIDE)
    assert len(named) > 30
    files = {path.name: path.read_text() for path in (ROOT / "tests").rglob("test_*.py")}
    assert [f"{file}::{test}" for file, test in named if f"def {test}(" not in files.get(file, "")] == []


def test_every_row_of_faults_names_a_test() -> None:
    table = GUIDE.split("## What happens when something goes wrong")[1]
    rows = [line for line in table.splitlines() if line.startswith("|")][2:]
    assert len(rows) > 20
    assert [row for row in rows if "::test_" not in row] == []


def test_every_knob_of_the_controller_is_explained() -> None:
    from dataclasses import fields

    from resync_robot.core.rig import ControllerRig

    told = set(re.findall(r"`(\w+)`", GUIDE))
    assert {f.name for f in fields(ControllerRig)} - told <= {"address", "emulated"}
