"""Runs that go on: damaged files are named with their mend, removed ones are made again, settings stay."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import pytest

from resync_robot import cli
from resync_robot.core.damage import AGAIN
from resync_robot.core.rig import load_rig
from resync_robot.curriculum import dream, learn_stages, mine, recover
from resync_robot.sim_training import learn_recovery
from tests.curriculum.test_run_folder import other_rig
from tests.run_folders import DAMAGES, copy_of, files_of, make_run


class ReachedError(Exception):
    """Training has read what it needed, and would now begin to work."""


def work(*_: object, **__: object) -> None:
    raise ReachedError


def work_on(function: object, items: Sequence[object], *_: object) -> Iterator[None]:
    for _item in items:
        raise ReachedError
    yield from ()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_run(tmp_path_factory.mktemp("runs") / "run").path


@pytest.fixture
def idle(monkeypatch: pytest.MonkeyPatch) -> None:
    """All that takes long raises instead."""
    for step in (mine, recover, dream):
        monkeypatch.setattr(step, "parallel_map", work_on)
    monkeypatch.setattr(learn_recovery, "_opened", work)
    monkeypatch.setattr(learn_stages, "learn_concepts", work)


def resume(folder: Path, *more: str) -> int:
    return cli.main(["train-sim", "--resume", "--out", str(folder), *more])


STAGE = "stages/1-Recover"
STAGE_FILES = (
    "metrics.json",
    f"{STAGE}/attempts.safetensors",
    f"{STAGE}/dreams-000.jsonl",
    f"{STAGE}/failures.json",
    f"{STAGE}/ppo.safetensors",
    f"{STAGE}/recovered.json",
    f"{STAGE}/recovery.json",
    f"{STAGE}/recovery.safetensors",
)
MORE_DREAMS = tuple(f"{STAGE}/dreams-{i:03d}.jsonl" for i in range(1, 5))
"""As the first file of them."""
LEARNING = (f"{STAGE}/attempts.safetensors", f"{STAGE}/ppo.safetensors")
"""What is read only where the recovery is not finished."""


def test_these_are_all_files_of_a_run(run: Path) -> None:
    assert {str(p) for p in files_of(run)} == {"config.json", *STAGE_FILES, *MORE_DREAMS}


@pytest.mark.usefixtures("idle")
def test_a_whole_run_goes_on(run: Path, tmp_path: Path) -> None:
    with pytest.raises(ReachedError):
        resume(copy_of(run, tmp_path / "copy"))
    assert set(files_of(tmp_path / "copy")) == set(files_of(run)), "nothing is left behind, no lock either"


def check_damage(folder: Path, name: str, how: str, again: Callable[[], object], capsys: pytest.CaptureFixture[str]):
    """Spoil one file of the run; `again` must say so in one message, and go on where the file is removed."""
    path = folder / name
    before = path.read_bytes()
    DAMAGES[how](path)
    if path.is_file() and how != "unreadable" and path.read_bytes() == before:
        return  # Nothing was lost.
    assert again() == 2
    shown = capsys.readouterr().err
    error = shown[shown.index("error: ") :]
    assert str(path) in error or (path.parent.name in error and path.name in error), error
    assert AGAIN in error and error.count("\n") == 2, error
    assert "Traceback" not in shown
    if how == "a Git LFS pointer" and str(path) in error:
        assert "git lfs pull" in error
    # The advice holds.
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(ReachedError):
        again()


@pytest.mark.usefixtures("idle")
@pytest.mark.parametrize("how", DAMAGES)
@pytest.mark.parametrize("name", STAGE_FILES)
def test_a_damaged_stage_file_is_one_message_and_can_be_removed(
    run: Path, tmp_path: Path, name: str, how: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if how == "unreadable" and os.geteuid() == 0:
        pytest.skip("root reads everything")
    folder = copy_of(run, tmp_path / "copy")
    if name in LEARNING:
        (folder / STAGE / "recovery.json").unlink()
    if name == "metrics.json" and how in ("an empty object",):
        pytest.skip("a run without figures, as after its removal")
    check_damage(folder, name, how, lambda: resume(folder), capsys)


@pytest.mark.slow
@pytest.mark.usefixtures("idle")
def test_the_files_of_a_real_run_are_these_and_so_is_their_damage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    real = tmp_path / "real"
    command = ["train-sim", "--preset", "smoke", "--skills", "state", "--out", str(real)]
    assert subprocess.run([sys.executable, "-m", "resync_robot", *command], stderr=subprocess.DEVNULL).returncode == 0
    names = {str(n) for n in files_of(real) if n.parts[0] != "library"}
    assert names == {"config.json", f"{STAGE}/model.png", f"{STAGE}/recovery.png", *STAGE_FILES, *MORE_DREAMS}
    # Made anew whatever becomes of them.
    (real / STAGE / "recovery.png").write_bytes(b"")
    (real / "library" / "library.json").unlink()
    for name in STAGE_FILES:
        for how in DAMAGES:
            if (how == "unreadable" and os.geteuid() == 0) or (name, how) == ("metrics.json", "an empty object"):
                continue
            folder = copy_of(real, tmp_path / "copy")
            if name in LEARNING:
                (folder / STAGE / "recovery.json").unlink()
            check_damage(folder, name, how, partial(resume, folder), capsys)
            shutil.rmtree(folder)


@pytest.mark.usefixtures("idle")
@pytest.mark.parametrize("name", ["distil.png", "demonstrations.png"])
def test_a_folder_in_place_of_a_picture_is_said_before_the_work(
    run: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy_of(run, tmp_path / "copy")
    (folder / name).mkdir()
    assert resume(folder) == 2
    assert f"{name} is a folder" in capsys.readouterr().err


@pytest.mark.usefixtures("idle")
@pytest.mark.parametrize("name", ["stages", "library", "dataset"])
def test_a_file_in_place_of_a_folder_is_said_before_the_work(
    run: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy_of(run, tmp_path / "copy")
    shutil.rmtree(folder / name, ignore_errors=True)
    (folder / name).touch()
    assert resume(folder) == 2
    error = capsys.readouterr().err
    assert f"{folder / name} cannot be used: it should be a folder" in error and AGAIN in error


# -- settings ---------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("idle")
@pytest.mark.parametrize(
    ("field", "value", "allowed"),
    [
        ("preset", "huge", "smoke, quick, full"),
        ("preset", ["smoke"], "smoke, quick, full"),
        ("seed", "three", "whole numbers from 0 on"),
        ("seed", -1, "whole numbers from 0 on"),
        ("seed", 1.5, "whole numbers from 0 on"),
        ("seed", True, "whole numbers from 0 on"),
        ("seed", None, "whole numbers from 0 on"),
        ("device", "tpu", "cpu, cuda"),
        ("skills", "sound", "camera, state"),
        ("skills", 3, "camera, state"),
        ("concepts", {}, "default, paper"),
        ("domain", "kitchen", "cornered-insertion-s"),
        ("domain", [], "cornered-insertion-s"),
        ("rig", 7, "the hash of a rig"),
    ],
)
def test_a_setting_that_no_run_has_is_refused(
    run: Path, tmp_path: Path, field: str, value: object, allowed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy_of(run, tmp_path / "copy")
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps({**config, field: value}))
    assert resume(folder) == 2
    error = capsys.readouterr().err
    assert f"{folder / 'config.json'}: '{field}' is {value!r}" in error
    # What a domain may be is told by what looks for it.
    assert ("valid: " if field == "domain" else f"; allowed: {allowed}") in error and allowed in error
    assert error.count("\n") == 2 and "  -> " in error


@pytest.mark.usefixtures("idle")
@pytest.mark.parametrize("how", [h for h in DAMAGES if h != "unreadable"])
def test_a_damaged_config_is_one_message(
    run: Path, tmp_path: Path, how: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy_of(run, tmp_path / "copy")
    DAMAGES[how](folder / "config.json")
    assert resume(folder) == 2
    error = capsys.readouterr().err
    assert str(folder / "config.json") in error and error.count("\n") == 2


@pytest.mark.usefixtures("idle")
@pytest.mark.parametrize(
    ("given", "word"),
    [
        (("--seed", "3"), "began with --seed 0, not 3"),
        (("--preset", "full"), "began with --preset smoke, not full"),
        (("--preset", "quick"), "began with --preset smoke, not quick"),
        (("--skills", "camera"), "began with --skills state, not camera"),
        (("--concepts", "paper"), "began with --concepts default, not paper"),
        (("--device", "cuda"), "began with --device cpu, not cuda"),
    ],
)
def test_a_run_goes_on_with_its_own_settings_or_not_at_all(
    run: Path, given: tuple[str, ...], word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert resume(run, *given) == 2
    error = capsys.readouterr().err
    assert word in error and f"leave {given[0]} out" in error


@pytest.mark.usefixtures("idle")
def test_settings_that_are_those_of_the_run_are_fine(run: Path, tmp_path: Path) -> None:
    with pytest.raises(ReachedError):
        resume(copy_of(run, tmp_path / "copy"), "--seed", "0", "--preset", "smoke", "--skills", "state")


@pytest.mark.usefixtures("idle")
def test_stages_without_their_settings_do_not_enter_a_new_run(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy_of(run, tmp_path / "copy")
    (folder / "config.json").unlink()
    assert cli.main(["train-sim", "--seed", "9", "--out", str(folder)]) == 2
    assert "left of a run whose config.json is gone" in capsys.readouterr().err


@pytest.mark.usefixtures("idle")
@pytest.mark.parametrize("how", ["lost", "cut in the middle", "no bytes"])
def test_a_run_whose_rig_was_lost_asks_for_it_and_goes_on_with_it(
    run: Path, tmp_path: Path, how: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, mine = copy_of(run, tmp_path / "copy"), other_rig(tmp_path)
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps({**config, "rig": load_rig(mine).hash}))
    shutil.copy(mine, folder / "rig.toml")
    with pytest.raises(ReachedError):
        resume(folder)
    if how == "lost":
        (folder / "rig.toml").unlink()
    else:
        DAMAGES[how](folder / "rig.toml")
    assert resume(folder) == 2
    error = capsys.readouterr().err
    assert f"{folder / 'rig.toml'} is " in error and "--resume --rig FILE" in error
    with pytest.raises(ReachedError):
        resume(folder, "--rig", str(mine))
    assert (folder / "rig.toml").read_bytes() == mine.read_bytes()


def test_what_a_killed_run_was_writing_is_swept_away(run: Path, tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run")
    for name in (".config.json.0123abcd.part", "stages/.failures.json.0123abcd.part", "mine.part", ".part"):
        (folder.path / name).touch()
    folder.sweep()
    assert sorted(p.name for p in folder.path.rglob("*.part")) == [".part", "mine.part"]
