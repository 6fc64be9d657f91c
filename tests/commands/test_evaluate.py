"""Evaluation: worlds of their own, episodes that are run and written, and bad input said clearly."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from resync_robot import cli
from resync_robot.commands import evaluate
from resync_robot.core.errors import ConfigError, UnknownNameError
from resync_robot.core.intervals import wilson
from resync_robot.core.library import save_library
from resync_robot.sim_training.domains import find_domain
from tests.commands.pretended_episodes import pretended
from tests.libraries import DOMAIN, given_library

CORNERED = find_domain(DOMAIN)


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


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"episodes": 0}, "--episodes is 0; allowed: 1 to"),
        ({"episodes": 10**12}, "--episodes is 10"),
        ({"workers": 0}, "--workers is 0; allowed: 1 to 256"),
        ({"workers": -1}, "--workers is -1"),
        ({"workers": 10**6}, "--workers is 10"),
        ({"seeds": ()}, "--seeds names none"),
        ({"seeds": (0, -1)}, "--seeds is -1"),
        ({"seeds": (2**40,)}, "from 0 to 2147483647"),
        ({"perception_only": True, "scenes": 0}, "--scenes is 0"),
        ({"perception_only": True, "scenes": 10**12}, "--scenes is 10"),
        ({"perception_only": True, "workers": 0}, "--workers is 0"),
        ({"perception_only": True, "seeds": (-1,)}, "--seeds is -1"),
    ],
)
def test_numbers_out_of_range_are_refused_at_once(given: dict, word: str) -> None:
    with pytest.raises(ConfigError) as error:
        evaluate.evaluate(evaluate.EvaluateConfig(**given))
    assert word in str(error.value)


# -- the command ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (("--domain", "kitchen"), "unknown domain 'kitchen'"),
        (("--scenarios", "s9"), "'s9'"),
        (("--methods", "magic"), "unknown method 'magic'"),
        (("--episodes", "0"), "--episodes is 0"),
        (("--episodes", "1000001"), "--episodes is 1000001; allowed: 1 to 1000000"),
        (("--workers", "0"), "--workers is 0"),
        (("--workers", "-1"), "--workers is -1"),
        (("--methods", ","), "--methods names none"),
        (("--resume",), "--resume needs the file to go on with"),
        (("--resume", "--json", "nowhere.json"), "there is no nowhere.json to go on with"),
        (("--seeds", "0", "-3"), "--seeds is -3"),
        (("--library", "/nowhere"), "no library folder /nowhere"),
        (("--json", "/dev/null/rows.json"), "cannot write --json /dev/null/rows.json"),
        (("--skills", "camera", "--perception", "oracle"), "--skills camera needs cameras"),
        (("--skills", "camera", "--workers", "1"), "no camera policy for 'Recover'"),
    ],
)
def test_bad_input_is_one_error_with_code_2(
    args: tuple[str, ...],
    word: str,
    library: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    given = () if "--library" in args else ("--library", str(library))
    assert cli.main(["evaluate", *given, *args]) == 2
    shown = capsys.readouterr()
    assert shown.err.startswith("error: ") and word in shown.err
    assert "Traceback" not in shown.err
    assert shown.out == ""


def test_a_file_that_is_no_report_is_not_replaced(library: Path, capsys: pytest.CaptureFixture[str]) -> None:
    manifest, before = library / "library.json", (library / "library.json").read_bytes()
    assert cli.main(["evaluate", "--library", str(library), "--json", str(manifest)]) == 2
    assert "exists and is not a report" in capsys.readouterr().err
    assert manifest.read_bytes() == before


def damage(library: Path, how: str) -> str:
    """Spoils a library; returns a word that the error must hold."""
    manifest = json.loads((library / "library.json").read_text("utf-8"))
    weights = library / "skills" / "Recover.safetensors"
    if how == "another version":
        (library / "library.json").write_text(json.dumps({**manifest, "version": 99}), "utf-8")
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
        (library / "library.json").write_text("{}", "utf-8")
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
            extra = ("--workers", "1") if command == "evaluate" else ()
            assert cli.main([command, "--library", str(tmp_path / name), *extra]) == 2
            assert f"error: the library {'was' if name == 'other' else 'holds'}" in (
                shown := capsys.readouterr().err.splitlines()[-2]
            ), shown
            assert word in shown


def test_the_table_is_lost_before_the_file_is(library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody_reads(text: str) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("resync_robot.console.say", nobody_reads)
    monkeypatch.setattr("resync_robot.sim_training.parallel.parallel_map", pretended)
    with pytest.raises(BrokenPipeError):
        evaluate.evaluate(evaluate.EvaluateConfig(library=(library,), json=tmp_path / "rows.json"))
    assert len(json.loads((tmp_path / "rows.json").read_text("utf-8"))["episodes"]) == 10 * len(CORNERED.scenarios)


# -- every world counts once ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("args", "note"),
    [
        (("--seeds", "5", "5", "5"), "seed 5 was given 3 times and counts once"),
        (("--methods", "resync", "resync"), "method resync was given 2 times"),
        (("--methods", "resync,resync"), "method resync was given 2 times"),
        (("--scenarios", "s0", "s0"), "scenario s0 was given 2 times"),
        (("--library", "{again}"), "was given 2 times"),
        (("--library", "{copy}"), "was given 2 times"),
    ],
)
def test_what_is_named_twice_counts_once(
    args: tuple[str, ...],
    note: str,
    quick: Callable[..., int],
    library: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    shutil.copytree(library, tmp_path / "copy")
    named = [a.format(again=library, copy=tmp_path / "copy") for a in args]
    scenarios = () if "--scenarios" in named else ("--scenarios", "s0")
    assert quick("--episodes", "2", *scenarios, *named, "--json", tmp_path / "rows.json") == 0
    low, high = wilson(1, 2)
    assert f"| resync | 0.50 [{low:.2f}, {high:.2f}] of 2 |" in (shown := capsys.readouterr().out)
    assert shown.count("| resync |") == 1
    assert note in caplog.text
    written = json.loads((tmp_path / "rows.json").read_text("utf-8"))
    assert len(written["episodes"]) == written["provenance"]["planned"] == 2
    assert [row["episodes"] for row in written["rows"]] == [2]
    assert len(written["provenance"]["libraries"]) == 1
