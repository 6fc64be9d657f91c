"""The tables of the planar domains are those of the committed figures."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("planar_results", ROOT / "scripts" / "planar_results.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def evaluation(successes: int, library: str = "ab" * 32, horizon: int = 300) -> dict[str, object]:
    row = {
        "domain": "blocked-stacking",
        "method": "resync",
        "scenario": "1",
        "seed": 41,
        "successes": successes,
        "episodes": 50,
        "library_hash": library,
    }
    return {"provenance": {"horizon": horizon, "git": "0123456789ab"}, "rows": [row]}


def test_the_page_shows_what_was_measured(script: ModuleType) -> None:
    page = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    data = json.loads((ROOT / "docs" / "planar.json").read_text(encoding="utf-8"))
    assert script.written(page, script.tables(data)) == page, "run python scripts/planar_results.py"


def test_seeds_are_summed_and_measured_again_replaced(script: ModuleType) -> None:
    rows = script.merged([], script.rows_of(evaluation(30), 1, 0))
    rows = script.merged(rows, script.rows_of(evaluation(40), 1, 0))
    rows = script.merged(rows, script.rows_of(evaluation(48), 1, 1))
    rows = script.merged(rows, script.rows_of(evaluation(20, horizon=200), 1, 0))
    shown = script.tables({"rows": rows, "paper": {"blocked-stacking": {"1": {"1": "0.76"}}}})
    assert "| 1 | 0.88 [0.80, 0.93] of 100: 40, 48 | 0.76 |" in shown
    assert "after stage 1, 300 control steps; training seeds 0, 1 (0123456):" in shown
    assert "| 1 | 0.40 [0.28, 0.54] of 50 | 0.76 |" in shown


def test_successes_within_the_paper_s_horizon_are_of_the_same_episodes(script: ModuleType) -> None:
    counted = evaluation(48)
    about = {k: counted["rows"][0][k] for k in ("method", "scenario", "seed")}
    counted["episodes"] = [{**about, "success": i < 48, "steps": 100 + 4 * i} for i in range(50)]
    (row,) = script.rows_of(counted, 1, 0)
    assert row["sooner"] == 26
    shown = script.tables({"rows": [row], "paper": {"blocked-stacking": {"1": {"1": "0.76"}}}})
    assert "| scenario | this program | within 200 | paper |" in shown and "| 0.52 | 0.76 |" in shown
    counted["episodes"][0]["steps"] = None
    assert "sooner" not in script.rows_of(counted, 1, 0)[0], "an earlier version did not count"


def test_variants_have_tables_of_their_own_by_what_the_scenarios_are(script: ModuleType) -> None:
    rows = script.merged([], script.rows_of(evaluation(48), 2, 0))
    for seed, won in ((0, 10), (1, 20)):
        rows = script.merged(rows, script.rows_of(evaluation(won), 2, seed, "no-tuning"))
    shown = script.tables({"rows": rows, "paper": {}, "scenarios": {"blocked-stacking 2": {"2": "train", "1": "old"}}})
    assert "| 1 | 0.96 [0.87, 0.99] of 50 |  |" in shown, "not mixed with the whole"
    assert "| variant | train | old |" in shown and "| whole (0123456) |  | 0.96 [0.87, 0.99] of 50 |" in shown
    assert "| no-tuning (0123456) |  | 0.30 [0.22, 0.40] of 100: 10, 20 |" in shown


def test_a_page_without_marks_is_left_alone(script: ModuleType) -> None:
    with pytest.raises(SystemExit, match="has no line"):
        script.written("# Results\n", "")
