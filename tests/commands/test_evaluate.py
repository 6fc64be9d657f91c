"""Evaluation: worlds of their own, episodes that are run and written, and bad input said clearly."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot import __version__, cli
from resync_robot.commands import evaluate
from resync_robot.commands.evaluated_episode import Job
from resync_robot.core.errors import ConfigError, RenderError, UnknownNameError
from resync_robot.core.intervals import wilson
from resync_robot.core.library import Library, save_library
from resync_robot.core.lock import sole_writer
from resync_robot.evaluation.report import EpisodeRow
from resync_robot.planning.execute import ExecuteSettings
from resync_robot.sim_training.domains import find_domain, world_task
from tests.libraries import DOMAIN, given_library, with_camera_policy

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


def test_unseen_worlds_lie_outside_the_edges_of_training() -> None:
    for episode in range(20):
        task = world_task(CORNERED, "s1", 3, episode, worlds="unseen")
        width = next(task.initial.get(o, "size_x")[0] for o in task.objects if o.type.name == "block")
        assert 0.041 < width < 0.0461 or 0.0699 < width < 0.0771
        friction = task.physics["friction_pad"]
        assert 0.9 <= friction <= 1.0 or 1.3 <= friction <= 1.43
        assert {v["kind"] for v in task.physics["surfaces"].values()} <= {"checks", "blotches"}
        again = world_task(CORNERED, "s1", 3, episode, worlds="unseen")
        assert again.initial == task.initial and again.physics == task.physics


def pretended(run: object, jobs: Sequence[Job], context: object, workers: int) -> Iterator[EpisodeRow]:
    """Rows of episodes that nobody ran; each says by its reason when it was made."""
    for number, job in enumerate(jobs):
        yield EpisodeRow(
            **vars(job), success=job.episode % 2 == 0, end="goal" if job.episode % 2 == 0 else "stuck",
            reason=f"the {number}th", skills=1, planning_s=0.1, seconds=1.0, skills_run=("Pick(r, b0)",),
        )  # fmt: skip


def interrupted_after(count: int) -> Callable[..., Iterator[EpisodeRow]]:
    def run(*args: Any) -> Iterator[EpisodeRow]:
        yield from islice(pretended(*args), count)
        raise KeyboardInterrupt

    return run


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
            extra = ("--workers", "1") if command == "evaluate" else ()
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
    assert cli.main(["evaluate", *args, "--workers", "1", "--json", str(file)]) == 0
    # The given model alone is stuck in the corner, by physics.
    assert "| initial | 0.00 [0.00, 0.66] of 2 |" in capsys.readouterr().out
    written = json.loads(file.read_text())
    assert set(written) == {"rows", "summary", "episodes", "provenance"}
    (row,) = written["rows"]
    assert (row["domain"], row["scenario"], row["split"], row["method"]) == (DOMAIN, "s0", "train", "initial")
    assert (row["episodes"], row["successes"], sum(row["failure_reasons"].values())) == (2, 0, 2)
    assert [(e["scenario"], e["seed"], e["episode"], e["success"]) for e in written["episodes"]] == [
        ("s0", 0, 0, False),
        ("s0", 0, 1, False),
    ]
    for episode in written["episodes"]:
        attempts = ExecuteSettings().max_failures
        assert episode["skills_run"] == ["Pick(r, b0)"] * attempts
        assert (episode["skills"], episode["end"]) == (attempts, "stuck")
    provenance = written["provenance"]
    assert provenance["version"] == __version__
    assert provenance["libraries"] == [row["library_hash"]] == [given_library().content_hash]


def test_an_episode_can_begin_with_a_block_in_the_hand(library: Path, tmp_path: Path) -> None:
    """The given model inserts at once what it holds, again and again: that is shorter than to put it down."""
    file = tmp_path / "rows.json"
    args = ["--library", str(library), "--methods", "initial", "--scenarios", "s7", "--episodes", "1"]
    assert cli.main(["evaluate", *args, "--workers", "1", "--json", str(file)]) == 0
    (episode,) = json.loads(file.read_text())["episodes"]
    assert episode["skills_run"] == ["Insert(r, b1, b0)"] * ExecuteSettings().max_failures
    assert (episode["success"], episode["end"]) == (False, "stuck")


def test_the_shipped_library_puts_the_block_down_frees_the_base_and_goes_on(tmp_path: Path) -> None:
    file = tmp_path / "rows.json"
    args = ["--methods", "resync", "--scenarios", "s7", "--seeds", "1000", "--episodes", "1"]
    assert cli.main(["evaluate", *args, "--workers", "1", "--json", str(file)]) == 0
    (episode,) = json.loads(file.read_text())["episodes"]
    assert episode["success"]
    assert episode["skills_run"] == ["Place(r, b1)", "Recover(r, b0, box)", "Pick(r, b1)", "Insert(r, b1, b0)"]


@pytest.mark.parametrize(
    ("scenario", "seed", "skills"),
    [
        ("s0", 2, ["Recover(r, b0, box)", "Pick(r, b0)", "Insert(r, b0, b1)"]),
        ("s1", 3, ["Recover(r, b0, box)", "Pick(r, b1)", "Insert(r, b1, b0)"]),
    ],
)
def test_with_the_right_sequence_given_the_shipped_skills_reach_the_goal(
    scenario: str, seed: int, skills: list[str], tmp_path: Path
) -> None:
    file = tmp_path / "rows.json"
    where = ["--methods", "human", "--scenarios", scenario, "--seeds", str(seed), "--episodes", "1", "--workers", "1"]
    assert cli.main(["evaluate", *where, "--perception", "oracle", "--skills", "state", "--json", str(file)]) == 0
    written = json.loads(file.read_text())
    assert [(e["success"], e["skills_run"]) for e in written["episodes"]] == [(True, skills)]
    assert {r["recoveries_per_episode"] for r in written["rows"]} == {1.0}


def test_the_table_is_lost_before_the_file_is(library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody_reads(text: str) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("resync_robot.console.say", nobody_reads)
    monkeypatch.setattr("resync_robot.sim_training.parallel.parallel_map", pretended)
    with pytest.raises(BrokenPipeError):
        evaluate.evaluate(evaluate.EvaluateConfig(library=(library,), json=tmp_path / "rows.json"))
    assert len(json.loads((tmp_path / "rows.json").read_text())["episodes"]) == 10 * len(CORNERED.scenarios)


# -- every world counts once ------------------------------------------------------------------------------------------


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, library: Path) -> Callable[..., int]:
    """`evaluate` with a library and episodes that cost nothing."""
    monkeypatch.setattr("resync_robot.sim_training.parallel.parallel_map", pretended)
    return lambda *args: cli.main(["evaluate", "--library", str(library), *map(str, args)])


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
    written = json.loads((tmp_path / "rows.json").read_text())
    assert len(written["episodes"]) == written["provenance"]["planned"] == 2
    assert [row["episodes"] for row in written["rows"]] == [2]
    assert len(written["provenance"]["libraries"]) == 1


def test_worlds_of_different_seeds_are_different_worlds() -> None:
    """So ranges of episodes never overlap, however many of one seed there are."""
    seen = [features(world_task(CORNERED, "s0", s, e)).tobytes() for s in range(4) for e in (0, 1, 2, 1_000_000)]
    assert len(set(seen)) == len(seen)


# -- an evaluation that is interrupted, and goes on -------------------------------------------------------------------


def without_times(file: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(file.read_text())
    for episode in content["episodes"]:
        episode.update(planning_s=0, seconds=0, reason="")
    for row in content["rows"]:
        row.update(failure_reasons={})
    return content


def test_what_was_finished_is_kept_named_and_gone_on_with(
    quick: Callable[..., int],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    args = ("--scenarios", "s0", "s1", "--seeds", "3", "4", "--episodes", "3", "--json")
    file = tmp_path / "rows.json"
    monkeypatch.setattr("resync_robot.sim_training.parallel.parallel_map", interrupted_after(5))
    assert quick(*args, file) == 130
    assert f"5 of 12 are finished and kept in {file}; go on with: --resume --json {file}" in caplog.text
    assert "| resync |" not in capsys.readouterr().out, "no table of some of them"
    assert len(json.loads(file.read_text())["episodes"]) == 5
    monkeypatch.setattr("resync_robot.sim_training.parallel.parallel_map", pretended)
    assert quick(*args, file) == 2
    assert "holds an unfinished evaluation (5 of 12)" in capsys.readouterr().err
    assert quick(*args, file, "--resume") == 0
    assert "of 6 |" in capsys.readouterr().out
    reasons = [e["reason"] for e in json.loads(file.read_text())["episodes"]]
    assert reasons == [f"the {i}th" for i in (*range(5), *range(7))], "the first five were not run again"
    assert quick(*args, tmp_path / "whole.json") == 0
    assert without_times(file) == without_times(tmp_path / "whole.json")


def test_a_finished_evaluation_is_shown_again_and_can_be_added_to(
    quick: Callable[..., int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    args = ("--scenarios", "s0", "--json", tmp_path / "rows.json", "--episodes")
    assert quick(*args, 2) == 0
    first = capsys.readouterr().out
    monkeypatch.setattr(
        "resync_robot.sim_training.parallel.parallel_map", lambda run, jobs, *_: pytest.fail() if jobs else ()
    )
    assert quick(*args, 2, "--resume") == 0
    assert capsys.readouterr().out == first
    monkeypatch.setattr("resync_robot.sim_training.parallel.parallel_map", pretended)
    assert quick(*args, 4, "--resume") == 0
    assert "of 4 |" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("library", "args", "words", "note"),
    [
        (given_library(), (), "poses by exact state, Recover by exact state", "the library holds no camera policy"),
        (with_camera_policy(8, 8), (), "poses by camera, Recover by camera", ""),
        (with_camera_policy(8, 8), ("--perception", "oracle"), "poses by exact state, Recover by exact state", ""),
        (with_camera_policy(8, 8), ("--skills", "state"), "poses by camera, Recover by exact state", ""),
        (with_camera_policy(0, 8), (), "poses by exact state, Recover by exact state", "only 0 of the 8 trials"),
        (
            with_camera_policy(0, 8),
            ("--perception", "camera"),
            "poses by camera, Recover by exact state",
            "0 of the 8 trials",
        ),
        (with_camera_policy(0, 8), ("--skills", "camera"), "poses by camera, Recover by camera", ""),
    ],
)
def test_poses_and_skills_come_from_cameras_where_the_library_can_and_the_table_says_so(
    library: Library,
    args: tuple[str, ...],
    words: str,
    note: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    save_library(library, tmp_path / "its")
    monkeypatch.setattr("resync_robot.sim_training.parallel.parallel_map", pretended)
    given = ("--library", str(tmp_path / "its"), "--scenarios", "s0", "--json", str(tmp_path / "rows.json"))
    with caplog.at_level("INFO"):
        assert cli.main(["evaluate", *given, *args]) == 0
    assert f"| method ({words}) | s0 |" in capsys.readouterr().out
    assert (note in caplog.text) if note else "the library" not in caplog.text
    assert ("--skills camera" in caplog.text) == ("trials" in note), "what to type, where there is something to use"
    made = json.loads((tmp_path / "rows.json").read_text("utf-8"))["provenance"]
    assert (made["perception"] == "camera", made["skills"] == "camera") == tuple(
        "camera" in part for part in words.split(",")
    )


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (("--worlds", "unseen"), "was made with worlds 'usual', this is 'unseen'"),
        (("--perception", "camera"), "was made with perception 'oracle', this is 'camera'"),
        (("--library", "{other}"), "was made with libraries"),
        (("--episodes", "1"), "holds what this command does not ask for: Job(library=0, method='resync'"),
        (("--methods", "rc"), "holds what this command does not ask for"),
        (("--seeds", "7"), "holds what this command does not ask for"),
    ],
)
def test_results_of_other_settings_are_never_mixed(
    args: tuple[str, ...], word: str, quick: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from dataclasses import replace

    save_library(replace(given_library(), execution={"variants": {}}), tmp_path / "other")
    file = tmp_path / "rows.json"
    assert quick("--scenarios", "s0", "--episodes", "2", "--json", file) == 0
    before = file.read_bytes()
    named = [a.format(other=tmp_path / "other") for a in args]
    usual = () if "--episodes" in args else ("--episodes", "2")
    assert quick("--scenarios", "s0", *usual, "--json", file, "--resume", *named) == 2
    error = capsys.readouterr().err
    assert word in error and "--json" in error
    assert file.read_bytes() == before


def test_where_nothing_can_render_it_says_how_to_go_on_without(
    quick: Callable[..., int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def blind(*_: object) -> Iterator[EpisodeRow]:
        raise RenderError("no Vulkan device can render", "mend it")
        yield

    monkeypatch.setattr("resync_robot.sim_training.parallel.parallel_map", blind)
    assert quick("--scenarios", "s0", "--perception", "camera") == 2
    assert "-> mend it; or do without pictures: --perception oracle" in capsys.readouterr().err


def test_results_of_another_commit_are_never_mixed(
    quick: Callable[..., int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    args = ("--scenarios", "s0", "--episodes", "2", "--json", tmp_path / "rows.json")
    monkeypatch.setattr("resync_robot.core.runs.git_hash", lambda: "aaaaaaaaaaaa")
    assert quick(*args) == 0
    monkeypatch.setattr("resync_robot.core.runs.git_hash", lambda: "bbbbbbbbbbbb")
    assert quick(*args, "--resume") == 2
    assert "was made with git 'aaaaaaaaaaaa', this is 'bbbbbbbbbbbb'" in capsys.readouterr().err


@pytest.mark.parametrize(
    "content", ["{}", "[]", "null", '{"torn": ', '{"provenance": {}, "episodes": [{}]}', '{"provenance": 3}', ""]
)
def test_a_file_that_is_no_evaluation_is_not_gone_on_with(
    content: str, quick: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "rows.json"
    file.write_text(content)
    assert quick("--scenarios", "s0", "--json", file, "--resume") == 2
    shown = capsys.readouterr().err
    assert str(file) in shown and "  -> " in shown and "Traceback" not in shown
    assert file.read_text() == content


def test_a_damaged_row_is_named(quick: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "rows.json"
    args = ("--scenarios", "s0", "--episodes", "2", "--json", file)
    assert quick(*args) == 0
    content = json.loads(file.read_text())
    content["episodes"][1]["seconds"] = "long"
    file.write_text(json.dumps(content))
    assert quick(*args, "--resume") == 2
    assert "'seconds' is 'long', and should be of type float" in capsys.readouterr().err


def test_a_file_is_written_by_one_evaluation_at_a_time(
    quick: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "rows.json"
    with sole_writer(tmp_path / ".rows.json.lock", file, ""):
        assert quick("--scenarios", "s0", "--json", file) == 2
        assert f"{file} is being written by process {os.getpid()}" in capsys.readouterr().err
        assert not file.exists()
    assert quick("--scenarios", "s0", "--json", file) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["library", "rows.json"]


def test_the_file_is_written_now_and_then(
    quick: Callable[..., int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "rows.json"
    counts: list[int] = []

    def watched(*args: Any) -> Iterator[EpisodeRow]:
        for row in pretended(*args):
            yield row
            counts.append(len(json.loads(file.read_text())["episodes"]) if file.exists() else 0)

    monkeypatch.setattr("resync_robot.evaluation.result_file.KEEP_EVERY_S", 0.0)
    monkeypatch.setattr("resync_robot.sim_training.parallel.parallel_map", watched)
    assert quick("--scenarios", "s0", "--episodes", "3", "--json", file) == 0
    assert counts == [1, 2, 3]


@pytest.mark.slow
def test_ctrl_c_keeps_what_was_finished(library: Path, tmp_path: Path) -> None:
    """With real worker processes, and the signal to all of them, as a terminal sends it."""
    file = tmp_path / "rows.json"
    command = [
        *(sys.executable, "-m", "resync_robot", "evaluate", "--library", str(library), "--methods", "initial"),
        *("--scenarios", "s0", "--episodes", "400", "--json", str(file)),
    ]
    run = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    assert run.stderr is not None
    for line in run.stderr:
        if line.startswith("evaluate:"):
            break
    time.sleep(10)
    os.killpg(run.pid, 2)
    shown = run.stderr.read()
    assert run.wait(60) == 130
    finished = json.loads(file.read_text())["episodes"]
    assert 0 < len(finished) < 400
    assert f"{len(finished)} of 400 are finished and kept in {file}" in shown and "Traceback" not in shown
