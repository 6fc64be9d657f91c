"""A run's folder: whole writes, figures that add up, and clear words where it cannot be used."""

from __future__ import annotations

import json
import os
from importlib.resources import files
from pathlib import Path

import pytest

from resync_robot.core import runs
from resync_robot.core.errors import ConfigError, TrainingError
from resync_robot.core.files import read_json, write_json
from resync_robot.core.rig import load_rig
from resync_robot.core.runs import default_folder, latest_folder
from resync_robot.curriculum import run_folder
from resync_robot.curriculum.run_folder import RunFolder


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_figures_of_a_stage_are_added_to_those_it_has(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run")
    assert folder.metrics == {}
    folder.record("look", {"failed": 3})
    folder.record("look", {"kept": 2})
    folder.record("dream", {"solved": 1})
    assert RunFolder(tmp_path / "run").metrics == {"look": {"failed": 3, "kept": 2}, "dream": {"solved": 1}}


def test_a_stage_of_which_only_the_seconds_are_known_left_no_figures(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    assert not folder.has_figures("mine")
    folder.record("mine", {"seconds": 3.0})
    assert not folder.has_figures("mine")
    folder.record("mine", {"tasks": 10, "failed": 3, "kept": 16})
    assert folder.has_figures("mine")
    write_json(tmp_path / "metrics.json", {"mine": {"tasks": "ten", "failed": 3, "kept": 16}})
    with pytest.raises(TrainingError, match=r"'mine.tasks' is 'ten'"):
        folder.has_figures("mine")


def test_seconds_add_up_over_resumed_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([10.0, 12.5, 100.0, 101.0])
    monkeypatch.setattr(run_folder.time, "monotonic", lambda: next(clock))
    for _ in range(2):
        with RunFolder(tmp_path).timed("mine"):
            pass
    assert RunFolder(tmp_path).metrics == {"mine": {"seconds": 3.5}}


def test_json_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_json(path, {"old": 1})
    with pytest.raises(TypeError):
        write_json(path, {"new": object()})
    assert read_json(path) == {"old": 1}
    write_json(path, {"new": 2})
    assert read_json(path) == {"new": 2}
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_no_file_is_nothing_and_a_torn_one_an_error(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    assert read_json(path) is None
    path.write_bytes(b'\xef\xbb\xbf{"marked": "gr\xc3\xb6\xc3\x9fe"}')
    assert read_json(path) == {"marked": "größe"}
    path.write_text('{"torn": ')
    with pytest.raises(ConfigError, match=r"a\.json is no valid JSON"):
        read_json(path)


def test_a_folder_that_cannot_be_written_is_a_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"cannot write to .*file/run") as caught:
        RunFolder(tmp_path / "file" / "run")
    assert "--out" in caught.value.fix


def test_default_folders_are_dated_and_never_taken(here: Path) -> None:
    first = default_folder("toy")
    first.mkdir(parents=True)
    second = default_folder("toy")
    assert first.parent == Path("runs") and first.name.endswith("-toy")
    assert second.name == first.name + "-2"


def test_the_latest_run_of_a_name_is_found(here: Path) -> None:
    with pytest.raises(ConfigError, match="no run of 'toy'"):
        latest_folder("toy")
    for age, name in ((20, "2026-01-02-toy"), (10, "2026-01-01-toy-2"), (0, "2026-01-03-other")):
        path = here / "runs" / name / "config.json"
        path.parent.mkdir(parents=True)
        path.write_text("{}")
        os.utime(path, (1000 - age, 1000 - age))
    assert latest_folder("toy") == Path("runs/2026-01-01-toy-2")


def test_the_commit_is_known_or_said_to_be_unknown(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(runs, "__file__", str(tmp_path / "module.py"))
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path))
    assert runs.git_hash() == "unknown"
    monkeypatch.setenv("PATH", "")
    assert runs.git_hash() == "unknown"


def test_metrics_are_plain_json(tmp_path: Path) -> None:
    RunFolder(tmp_path).record("mine", {"rate": 0.5})
    assert json.loads((tmp_path / "metrics.json").read_text()) == {"mine": {"rate": 0.5}}


def other_rig(tmp_path: Path) -> Path:
    path = tmp_path / "mine.toml"
    text = files("resync_robot.core").joinpath("simulated_rig.toml").read_text()
    path.write_text(text.replace("name = ", "name = 'mine'  # ", 1))
    return path


def test_a_run_keeps_the_rig_that_it_began_with(tmp_path: Path) -> None:
    mine = other_rig(tmp_path)
    folder = RunFolder(tmp_path / "run")
    assert folder.rig.hash == load_rig().hash
    folder.keep_rig(mine)
    assert folder.rig.name == "mine"
    mine.unlink()
    assert RunFolder(tmp_path / "run").rig.name == "mine"


def test_a_rig_file_that_lies_there_is_not_replaced(tmp_path: Path) -> None:
    mine, there = other_rig(tmp_path), tmp_path / "run" / "rig.toml"
    folder = RunFolder(tmp_path / "run")
    there.write_text("# somebody's own")
    with pytest.raises(ConfigError, match=r"rig.toml exists, and is another"):
        folder.keep_rig(mine)
    assert there.read_text() == "# somebody's own"
    there.write_bytes(mine.read_bytes())
    folder.keep_rig(mine)
    assert folder.rig.name == "mine"


def test_a_run_is_not_resumed_with_another_rig(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run")
    write_json(folder.path / "config.json", {})
    folder.keep_rig(None)
    with pytest.raises(ConfigError, match=r"not for .*mine.toml"):
        folder.keep_rig(other_rig(tmp_path))
    assert folder.rig.hash == load_rig().hash


def test_a_file_that_is_no_rig_does_not_enter_a_run(tmp_path: Path) -> None:
    (tmp_path / "broken.toml").write_text("name = 3")
    folder = RunFolder(tmp_path / "run")
    with pytest.raises(ConfigError):
        folder.keep_rig(tmp_path / "broken.toml")
    assert not list(folder.path.glob("rig.toml*"))
