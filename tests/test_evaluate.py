"""Evaluation: intervals that are known, tables that add up, worlds of their own, and bad input said clearly."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot import cli, evaluate
from resync_robot.core.errors import UnknownNameError
from resync_robot.core.library import save_library
from resync_robot.evaluate import Row, table, wilson
from sim_training.domains import find_domain, world_task
from tests.libraries import DOMAIN, given_library

CORNERED = find_domain(DOMAIN)


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


def row(method: str, scenario: str, success: bool, episode: int = 0) -> Row:
    return Row(0, method, scenario, 0, episode, success, "goal" if success else "stuck", "", 2, 0.01, 1.0)


def test_the_table_has_a_line_for_each_method_and_a_column_for_each_scenario() -> None:
    rows = [row("resync", "s0", i < 9) for i in range(10)] + [row("rc", "s0", False), row("rc", "s1", True)]
    rows += [row("resync", "s1", True)]
    lines = table(rows, ("resync", "rc"), ("s0", "s1")).splitlines()
    assert lines[0] == "| method | s0 | s1 |"
    assert lines[1].replace("-", "") == "||||"
    assert lines[2] == "| resync | 0.90 [0.60, 0.98] of 10 | 1.00 [0.21, 1.00] of 1 |"
    assert lines[3] == "| rc | 0.00 [0.00, 0.79] of 1 | 1.00 [0.21, 1.00] of 1 |"


def test_groups_of_scenarios_and_lists_are_spelled_out_once() -> None:
    names = tuple(CORNERED.scenarios)
    train = tuple(s.name for s in CORNERED.scenarios.values() if s.training)
    test = tuple(n for n in names if n not in train)
    assert evaluate._scenarios(("all",), CORNERED) == names
    assert evaluate._scenarios(("train",), CORNERED) == train
    assert evaluate._scenarios(("test",), CORNERED) == test
    assert evaluate._scenarios(("s1,s0", "s1"), CORNERED) == ("s1", "s0")
    assert evaluate._methods(("resync,rc", "initial")) == ("resync", "rc", "initial")


def test_unknown_names_list_the_valid_ones() -> None:
    with pytest.raises(UnknownNameError, match="unknown method 'magic'") as caught:
        evaluate._methods(("resync", "magic"))
    assert "initial" in caught.value.fix
    with pytest.raises(UnknownNameError, match="s9"):
        evaluate._scenarios(("s9",), CORNERED)


def features(task) -> np.ndarray:
    return np.concatenate([task.initial[o] for o in task.objects])


@given(st.integers(0, 10_000), st.integers(0, 10_000), st.sampled_from(sorted(CORNERED.scenarios)))
def test_a_world_is_a_pure_function_of_its_names(seed: int, episode: int, scenario: str) -> None:
    first, again = (world_task(CORNERED, scenario, seed, episode) for _ in range(2))
    assert first.initial == again.initial
    assert (first.physics, first.goal, first.seed) == (again.physics, again.goal, again.seed)
    for others in ((seed + 1, episode), (seed, episode + 1)):
        assert not np.array_equal(features(world_task(CORNERED, scenario, *others)), features(first))


def test_no_world_of_evaluation_is_one_of_training() -> None:
    def trained(seed: int) -> np.ndarray:
        return features(CORNERED.scenario("s0").sample(np.random.default_rng(seed), seed))

    seen = {features(world_task(CORNERED, "s0", s, e)).tobytes() for s in range(5) for e in range(20)}
    assert len(seen) == 100
    assert not seen & {trained(seed).tobytes() for seed in range(200)}
    assert not seen & {trained(1_000_000 + seed).tobytes() for seed in range(200)}


# -- the command ------------------------------------------------------------------------------------------------------


@pytest.fixture
def library(tmp_path: Path) -> Path:
    save_library(given_library(), tmp_path / "library")
    return tmp_path / "library"


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (("--domain", "kitchen"), "unknown domain 'kitchen'"),
        (("--scenarios", "s9"), "'s9'"),
        (("--methods", "magic"), "unknown method 'magic'"),
        (("--episodes", "0"), "--episodes is 0"),
        (("--seeds", "0", "-3"), "--seeds is (0, -3)"),
        (("--library", "/nowhere"), "no library folder /nowhere"),
        (("--json", "/dev/null/rows.json"), "cannot write /dev/null/rows.json"),
    ],
)
def test_bad_input_is_one_error_with_code_2(
    args: tuple[str, ...], word: str, library: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = () if "--library" in args else ("--library", str(library))
    assert cli.main(["evaluate", *given, *args]) == 2
    shown = capsys.readouterr()
    assert shown.err.startswith("error: ") and word in shown.err
    assert "Traceback" not in shown.err
    assert shown.out == ""


def damage(library: Path, how: str) -> str:
    """Spoils a library; returns a word that the error must hold."""
    manifest = json.loads((library / "library.json").read_text())
    weights = library / "skills" / "Recover.safetensors"
    if how == "another version":
        (library / "library.json").write_text(json.dumps({**manifest, "version": 99}))
        return "version 99"
    if how == "truncated":
        weights.write_bytes(weights.read_bytes()[:-7])
    elif how == "altered":
        raw = bytearray(weights.read_bytes())
        raw[-1] ^= 1
        weights.write_bytes(raw)
    elif how == "missing":
        weights.unlink()
    elif how == "no manifest":
        (library / "library.json").write_text("{}")
        return "version None"
    return "Recover.safetensors"


@pytest.mark.parametrize("command", ["evaluate", "deploy"])
@pytest.mark.parametrize("how", ["another version", "truncated", "altered", "missing", "no manifest"])
def test_a_spoiled_library_is_one_error_with_code_2(
    command: str, how: str, library: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    word = damage(library, how)
    assert cli.main([command, "--library", str(library)]) == 2
    shown = capsys.readouterr()
    assert shown.err.startswith("error: ") and word in shown.err
    assert shown.err.count("\n") <= 2
    assert shown.out == ""


def test_a_library_of_another_domain_or_without_recovery_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from dataclasses import replace

    save_library(replace(given_library(), domain="kitchen"), tmp_path / "other")
    save_library(replace(given_library(), skills={}), tmp_path / "lacking")
    for name, word in (("other", "learned in 'kitchen'"), ("lacking", "no skill 'Recover'")):
        for command in ("evaluate", "deploy"):
            extra = ("--workers", "0") if command == "evaluate" else ()
            assert cli.main([command, "--library", str(tmp_path / name), *extra]) == 2
            assert f"error: the library {'was' if name == 'other' else 'holds'}" in (
                shown := capsys.readouterr().err.splitlines()[-2]
            ), shown
            assert word in shown


def test_episodes_are_run_counted_and_written(
    library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "deep" / "rows.json"
    args = ["--library", str(library), "--methods", "initial", "--scenarios", "s0", "--episodes", "2"]
    assert cli.main(["evaluate", *args, "--workers", "0", "--json", str(file)]) == 0
    written = json.loads(file.read_text())
    rows = written["rows"]
    assert [(r["scenario"], r["method"], r["seed"]) for r in rows][:1] == [("s0", "initial", 0)]
    # The given model alone is stuck in the corner, by physics.
    assert "| initial | 0.00 [0.00, 0.66] of 2 |" in capsys.readouterr().out
    assert written["provenance"]["libraries"] == [given_library().content_hash]
