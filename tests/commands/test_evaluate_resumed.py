"""An evaluation that is interrupted, and goes on."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from resync_robot import cli
from resync_robot.core.errors import RenderError
from resync_robot.core.library import Library, save_library
from resync_robot.core.lock import sole_writer
from resync_robot.evaluation.report import EpisodeRow
from resync_robot.sim_training.domains import find_domain
from tests.commands.pretended_episodes import interrupted_after, pretended
from tests.libraries import DOMAIN, given_library, with_camera_policy

CORNERED = find_domain(DOMAIN)


def without_times(file: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(file.read_text("utf-8"))
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
    assert len(json.loads(file.read_text("utf-8"))["episodes"]) == 5
    monkeypatch.setattr("resync_robot.sim_training.parallel.parallel_map", pretended)
    assert quick(*args, file) == 2
    assert "holds an unfinished evaluation (5 of 12)" in capsys.readouterr().err
    assert quick(*args, file, "--resume") == 0
    assert "of 6 |" in capsys.readouterr().out
    reasons = [e["reason"] for e in json.loads(file.read_text("utf-8"))["episodes"]]
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
    file.write_text(content, "utf-8")
    assert quick("--scenarios", "s0", "--json", file, "--resume") == 2
    shown = capsys.readouterr().err
    assert str(file) in shown and "  -> " in shown and "Traceback" not in shown
    assert file.read_text("utf-8") == content


def test_a_damaged_row_is_named(quick: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "rows.json"
    args = ("--scenarios", "s0", "--episodes", "2", "--json", file)
    assert quick(*args) == 0
    content = json.loads(file.read_text("utf-8"))
    content["episodes"][1]["seconds"] = "long"
    file.write_text(json.dumps(content), "utf-8")
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
            counts.append(len(json.loads(file.read_text("utf-8"))["episodes"]) if file.exists() else 0)

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
    # A line comes with a finished episode, and not before.
    for line in run.stderr:
        if line.startswith("evaluate:"):
            break
    os.killpg(run.pid, 2)
    shown = run.stderr.read()
    assert run.wait(60) == 130
    finished = json.loads(file.read_text("utf-8"))["episodes"]
    assert 0 < len(finished) < 400
    assert f"{len(finished)} of 400 are finished and kept in {file}" in shown and "Traceback" not in shown
