"""The chart of the README is drawn from its data, and takes the data from evaluations."""

from __future__ import annotations

import importlib.util
import json
import shutil
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def chart() -> ModuleType:
    spec = importlib.util.spec_from_file_location("draw_results", ROOT / "scripts" / "draw_results.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def docs(tmp_path: Path) -> Path:
    shutil.copy(ROOT / "docs" / "results.json", tmp_path)
    return tmp_path


def _evaluation(path: Path, git: str = "abcdef012345", **changes: Any) -> Path:
    """A file as `evaluate --json` writes it, of two scenarios."""
    rows = [
        {"scenario": scenario, "method": method, "episodes": 10, "successes": successes}
        for scenario, method, successes in (("s1", "resync", 9), ("s1", "rc", 1), ("s7", "resync", 8), ("s7", "rc", 0))
    ]
    provenance = {"perception": "camera", "skills": "camera", "worlds": "unseen", "git": git, "planned": 40, **changes}
    path.write_text(json.dumps({"rows": rows, "provenance": provenance}))
    return path


def test_the_shipped_chart_is_that_of_the_shipped_figures(chart: ModuleType, docs: Path) -> None:
    chart.main(["--docs", str(docs)])
    drawn, shipped = (cv2.imread(str(folder / "results.png")).astype(int) for folder in (docs, ROOT / "docs"))
    assert drawn.shape == shipped.shape
    # A bar is 27 pixels wide; what fonts and rounding change is less than a row of one.
    changed = int((np.abs(drawn - shipped).max(-1) > 60).sum())
    assert changed < 20


def test_figures_come_from_evaluations(chart: ModuleType, docs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = json.loads((docs / "results.json").read_text("utf-8"))
    files = [_evaluation(docs / "a.json"), _evaluation(docs / "b.json", git="1234567890ab")]
    chart.main([*(f"camera={file}" for file in files), "--docs", str(docs)])
    after = json.loads((docs / "results.json").read_text("utf-8"))
    camera = after["series"].pop("camera")
    assert camera["reached"] == {"s1": "18 of 20", "s7": "16 of 20"}
    assert camera["git"] == ["abcdef0", "1234567"]
    del before["series"]["camera"]
    assert after == before
    assert "ReSYNC: 34 of 40, abcdef0, 1234567" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"perception": "oracle"}, "perception is oracle; 'ReSYNC' needs camera"),
        ({"skills": "state"}, "skills is state; 'ReSYNC' needs camera"),
        ({"planned": 41}, "unfinished"),
    ],
)
def test_figures_of_another_kind_are_refused(
    chart: ModuleType, docs: Path, changes: dict[str, Any], words: str
) -> None:
    before = (docs / "results.json").read_text("utf-8")
    with pytest.raises(SystemExit, match=words):
        chart.main([f"camera={_evaluation(docs / 'a.json', **changes)}", "--docs", str(docs)])
    assert (docs / "results.json").read_text("utf-8") == before


def test_other_worlds_are_not_added_up(chart: ModuleType, docs: Path) -> None:
    files = [_evaluation(docs / "a.json"), _evaluation(docs / "b.json", worlds="usual")]
    with pytest.raises(SystemExit, match="unseen and usual worlds"):
        chart.main([*(f"camera={file}" for file in files), "--docs", str(docs)])


def test_an_unknown_series_is_named(chart: ModuleType, docs: Path) -> None:
    with pytest.raises(SystemExit, match=r"cameras=.* a series of camera, rc, initial"):
        chart.main(["cameras=a.json", "--docs", str(docs)])
