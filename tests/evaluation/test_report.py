"""What an evaluation reports: intervals that are known, counts that add up, causes that count together."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core.intervals import wilson
from resync_robot.evaluation.report import EpisodeRow, failure_reason, report, table
from resync_robot.sim_training.domains import find_domain
from tests.libraries import DOMAIN

CORNERED = find_domain(DOMAIN)
HASHES = ("aa", "bb")


# Agresti & Coull (1998) and statsmodels' proportion_confint(method="wilson") to four digits.
@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [(0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (5, 10, 0.2366, 0.7634), (1, 50, 0.0035, 0.1050), (0, 0, 0.0, 1.0)],
)
def test_wilson_gives_published_values(successes: int, trials: int, low: float, high: float) -> None:
    assert wilson(successes, trials) == pytest.approx((low, high), abs=1e-4)


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_brackets_the_rate_and_mirrors(counts: tuple[int, int]) -> None:
    successes, trials = counts
    low, high = wilson(successes, trials)
    assert -1e-12 <= low <= successes / trials + 1e-12
    assert successes / trials - 1e-12 <= high <= 1
    # It is the set of rates p for which the observation is within z standard errors of p.
    for p in (low, high):
        assert trials * (successes / trials - p) ** 2 == pytest.approx(1.96**2 * p * (1 - p), abs=1e-9)
    mirrored = wilson(trials - successes, trials)
    assert mirrored == pytest.approx((1 - high, 1 - low), abs=1e-12)


def row(method: str, scenario: str, success: bool, skills: Sequence[str] = ()) -> EpisodeRow:
    end = "goal" if success else "stuck"
    return EpisodeRow(0, method, scenario, 0, 0, success, end, "", len(skills), 0.01, 1.0, tuple(skills))


def test_the_table_has_a_line_for_each_method_and_a_column_for_each_scenario() -> None:
    rows = [row("resync", "s0", i < 9) for i in range(10)] + [row("rc", "s0", False), row("rc", "s1", True)]
    rows += [row("resync", "s1", True)]
    lines = table(rows, ("resync", "rc"), ("s0", "s1"), "poses by camera").splitlines()
    assert lines[0] == "| method (poses by camera) | s0 | s1 |"
    assert lines[1].replace("-", "") == "||||"
    assert lines[2] == "| resync | 0.90 [0.60, 0.98] of 10 | 1.00 [0.21, 1.00] of 1 |"
    assert lines[3] == "| rc | 0.00 [0.00, 0.79] of 1 | 1.00 [0.21, 1.00] of 1 |"


episode_rows = st.builds(
    EpisodeRow,
    library=st.integers(0, 1),
    method=st.sampled_from(["resync", "initial"]),
    scenario=st.sampled_from(["s0", "s1", "s2"]),
    seed=st.integers(0, 1),
    episode=st.integers(0, 9),
    success=st.booleans(),
    end=st.sampled_from(["goal", "stuck", "no plan", "fault"]),
    reason=st.sampled_from(["", "Pick(r, b0) did not do what it should (blocked: 3 N)", "16 skills were run"]),
    skills=st.just(2),
    planning_s=st.just(0.1),
    seconds=st.just(1.0),
    skills_run=st.lists(st.sampled_from(["Recover(r, b0, box)", "Pick(r, b0)", "Recovery(r)"])).map(tuple),
)


@given(st.lists(episode_rows, min_size=1, max_size=40))
def test_the_counts_add_up(episodes: list[EpisodeRow]) -> None:
    written = json.loads(json.dumps(report(episodes, CORNERED, HASHES)))
    assert [tuple(e["skills_run"]) for e in written["episodes"]] == [e.skills_run for e in episodes]
    rows = written["rows"]
    assert len({(r["scenario"], r["method"], r["library"], r["seed"]) for r in rows}) == len(rows)
    for r in rows:
        assert r["successes"] + sum(r["failure_reasons"].values()) == r["episodes"]
        assert r["split"] == ("train" if CORNERED.scenario(r["scenario"]).training else "test")
        assert (r["domain"], r["library_hash"]) == (DOMAIN, HASHES[r["library"]])
    runs = sum(s.startswith("Recover(") for e in episodes for s in e.skills_run)
    for lines in (
        [s for s in written["summary"] if s["scenario"]],
        [s for s in written["summary"] if not s["scenario"]],
    ):
        assert sum(s["n"] for s in lines) == sum(r["episodes"] for r in rows) == len(episodes)
        assert sum(s["n"] * s["recoveries_per_episode"] for s in lines) == pytest.approx(runs)
    assert sum(r["episodes"] * r["recoveries_per_episode"] for r in rows) == pytest.approx(runs)
    for s in written["summary"]:
        mine = [r for r in rows if (r["split"], r["method"]) == (s["split"], s["method"])]
        mine = [r for r in mine if s["scenario"] in (None, r["scenario"])]
        wins = sum(r["successes"] for r in mine)
        assert s["n"] == sum(r["episodes"] for r in mine)
        assert s["success_rate"] == wins / s["n"]
        assert tuple(s["ci95"]) == wilson(wins, s["n"])


def test_a_summary_has_the_splits_and_then_the_scenarios() -> None:
    episodes = [row(m, s, True) for s in ("s0", "s1", "s2") for m in ("resync", "initial")]
    seen = [(s["split"], s["scenario"], s["method"], s["n"]) for s in report(episodes, CORNERED, HASHES)["summary"]]
    assert seen == [
        ("train", None, "resync", 1),
        ("train", None, "initial", 1),
        ("test", None, "resync", 2),
        ("test", None, "initial", 2),
        *(
            (split, s, m, 1)
            for split, s in (("train", "s0"), ("test", "s1"), ("test", "s2"))
            for m in ("resync", "initial")
        ),
    ]


def test_needless_recoveries_count_in_success_and_failure() -> None:
    recover, pick = "Recover(r, b0, box)", "Pick(r, b0)"
    episodes = [row("rc", "s0", True, (recover, pick)), row("rc", "s0", False, (pick, recover, recover))]
    episodes.append(replace(episodes[0], skills_run=(pick,)))
    written = report(episodes, CORNERED, HASHES)
    assert written["rows"][0]["recoveries_per_episode"] == pytest.approx(1.0)
    assert [s["recoveries_per_episode"] for s in written["summary"]] == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize(
    ("end", "reasons", "counted"),
    [
        (
            "stuck",
            (
                "Insert(r, b1, b0) did not do what it should (blocked: over b0: 61 N against the hand)",
                "Insert(r, b2, b10) did not do what it should (blocked: over b10: 245 N against the hand)",
            ),
            "stuck: Insert: blocked: over b#: # N against the hand",
        ),
        (
            "stuck",
            ("Pick(r, b0) did not do what it should (unreachable: the flange at (0.412, -0.1, 1e-05) m, beyond it)",),
            "stuck: Pick: unreachable: the flange at (#) m, beyond it",
        ),
        (
            "no plan",
            (
                "no plan reaches On(b1, b0): nothing achieves On(b1, b0)",
                "no plan reaches On(b1, b0), On(b2, b1): nothing achieves On(b1, b0)",
            ),
            "no plan: no plan reaches On: nothing achieves On",
        ),
        (
            "fault",
            ("the scan did not find b0; it found b1, b2", "the scan did not find b0, b2; it found b1"),
            "fault: the scan did not find b#; it found b#",
        ),
        ("exhausted", ("16 skills were run",), "exhausted: # skills were run"),
        ("stuck", ("",), "stuck"),
        ("goal", ("",), "goal: believed to be reached, in truth it is not"),
    ],
)
def test_failures_of_one_kind_count_together(end: str, reasons: tuple[str, ...], counted: str) -> None:
    assert {failure_reason(end, reason) for reason in reasons} == {counted}
