"""The last stage of training, whole and small: what it leaves, and that it goes on where it was cut off."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from resync_robot.core.damage import AGAIN
from resync_robot.core.errors import TrainingError
from resync_robot.core.files import write_bytes
from resync_robot.core.library import load_library
from resync_robot.core.rig import load_rig
from resync_robot.curriculum.distil import DistilPlan, _check_candidate, distil, to_keep
from resync_robot.curriculum.run_folder import RunFolder
from resync_robot.curriculum.stage_folder import StageFolder
from resync_robot.learning.camera_view import GAPS, state_seen
from resync_robot.library_models import shipped_library
from resync_robot.sim_training.demonstrations.recoveries import RenderedRecovery
from resync_robot.sim_training.demonstrations.shards import STAMP, count
from resync_robot.sim_training.demonstrations.starts import draw_start
from resync_robot.sim_training.domains import find_domain
from tests.curriculum.test_resume import ReachedError
from tests.libraries import gaussians_of
from tests.run_folders import DAMAGES, copy_of, files_of

STAGE = "stages/1-Recover"
TINY = DistilPlan(worlds=16, rounds=1, round_worlds=16, steps=6, round_steps=3, trials=4, batch=8)


HARMLESS = {"distil.csv": ("no bytes", "last line gone"), "distil.json": ("an empty list",)}
"""Losses are only drawn; without a candidate in the list, all are tried again."""


def run(folder: Path) -> dict[str, bytes]:
    domain = find_domain("cornered-insertion-s")
    library = load_library(shipped_library(domain.name))
    gaussians = gaussians_of(library)
    record = library.skills[domain.recovery]
    stage = StageFolder(RunFolder(folder), 1, domain.recovery)
    return distil(domain, stage, TINY, record, gaussians, 0, 1, "cpu", lambda share, words: None)


@pytest.mark.slow
def test_it_leaves_a_policy_and_pictures_and_does_nothing_twice(tmp_path: Path) -> None:
    from resync_robot.policies.diffusion import load_student

    files = run(tmp_path)
    with TemporaryDirectory() as folder:
        for name, data in files.items():
            (Path(folder) / name).write_bytes(data)
        assert load_student(Path(folder), load_rig()).horizon > 0
    assert count(sorted(tmp_path.glob("stages/*/demonstrations/*")))["segments"] > 10
    assert all((tmp_path / name).stat().st_size > 1000 for name in ("demonstrations.png", "distil.png"))
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "stages").rglob("*") if p.is_file()}
    assert run(tmp_path) == files
    assert {p: p.stat().st_mtime_ns for p in before} == before


@pytest.mark.slow
def test_a_damaged_file_of_this_stage_is_one_message_and_can_be_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(tmp_path / "run")
    students = [f"student-{step:06d}" for step in (TINY.steps, TINY.steps + TINY.round_steps)]
    names = {n for n in files_of(tmp_path / "run") if n.parts[0] == "stages"}
    files = [Path(STAGE, n) for n in ("distil.csv", "distil.json", "distil.safetensors")]
    shards = [Path(STAGE, "demonstrations", f"turn-{i}-0000", STAMP) for i in range(2)]
    # Every file of a shard, and of a student, has a test of its own.
    inside = {n for n in names if n.parts[2] in students or n.parent in {s.parent for s in shards} or len(n.parts) > 5}
    assert names - inside == set(files)
    assert set(shards) < names

    def begin(*_: object, **__: object) -> None:
        raise ReachedError

    def work_on(function: object, items: Sequence[object], *_: object) -> Iterator[None]:
        for _item in items:
            raise ReachedError
        yield from ()

    monkeypatch.setattr("resync_robot.curriculum.distil.parallel_map", work_on)
    monkeypatch.setattr("resync_robot.curriculum.distil._check_candidate", lambda *_: None)
    monkeypatch.setattr("resync_robot.policies.training.Trainer.run", begin)
    for name in (*files, shards[0]):
        for how, spoil in DAMAGES.items():
            if (how == "unreadable" and os.geteuid() == 0) or how in HARMLESS.get(name.name, ()):
                continue
            folder = copy_of(tmp_path / "run", tmp_path / "copy")
            if name.suffix != ".csv" and name.name != "distil.json":
                # It is read where the training is not finished.
                shutil.rmtree(folder / STAGE / students[-1])
            before = (folder / name).read_bytes()
            spoil(folder / name)
            if not (folder / name).is_file() or (folder / name).read_bytes() != before:
                with pytest.raises(TrainingError) as caught:
                    run(folder)
                assert caught.value.fix.endswith(AGAIN), (name, how)
                path = folder / (name if name in files else name.parent)
                assert str(path) in caught.value.what, (name, how)
                # The advice holds.
                shutil.rmtree(path) if path.is_dir() else path.unlink()
                with suppress(ReachedError):
                    run(folder)
            shutil.rmtree(folder)


@pytest.mark.slow
def test_any_damage_to_any_file_of_a_student_is_named(tmp_path: Path) -> None:
    domain = find_domain("cornered-insertion-s")
    for name, data in load_library(shipped_library(domain.name)).policies[domain.recovery].items():
        # The model card is for people, and a run has none.
        if name != "README.md":
            write_bytes(tmp_path / "student" / name, data)
    _check_candidate(tmp_path / "student", load_rig())
    passed = []
    for name in files_of(tmp_path / "student"):
        for how, spoil in DAMAGES.items():
            if how == "unreadable" and os.geteuid() == 0:
                continue
            folder = copy_of(tmp_path / "student", tmp_path / "copy")
            before = (folder / name).read_bytes()
            spoil(folder / name)
            if not (folder / name).is_file() or (folder / name).read_bytes() != before:
                try:
                    _check_candidate(folder, load_rig())
                    passed.append((str(name), how))
                except TrainingError as error:
                    assert str(folder) in error.what and error.fix.endswith(AGAIN), (name, how)
            shutil.rmtree(folder)
    assert passed == []


@pytest.mark.parametrize(
    ("successes", "step"),
    [((92, 91, 91), 4800), ((92, 91, 85), 3300), ((92, 60, 85), 1800), ((69, 87, 88), 4800), ((96, 95, 96), 4800)],
)
def test_of_candidates_that_trials_cannot_tell_apart_the_one_trained_longest_is_kept(
    successes: tuple[int, ...], step: int
) -> None:
    steps = (1800, 3300, 4800)
    assert to_keep([{"step": s, "worlds": 96, "success": k} for s, k in zip(steps, successes, strict=True)]) == step


def test_the_shipped_policy_sees_its_block_and_whether_it_is_stuck(tmp_path: Path) -> None:
    from resync_robot.policies.diffusion import load_student

    domain, rig = find_domain("cornered-insertion-s"), load_rig()
    library = load_library(shipped_library(domain.name))
    for name, data in library.policies[domain.recovery].items():
        (tmp_path / name).write_bytes(data)
    student = load_student(tmp_path, rig)
    gaussians = gaussians_of(library)
    scenes = [RenderedRecovery(draw_start(domain, gaussians, 980_000_000 + i), rig, 0.0, i) for i in range(8)]
    seen = [scene.see() for scene in scenes]
    pictures = np.stack([o.pictures for o in seen])
    states = np.stack(
        [state_seen(o.q, o.tip, o.tip, s.yaw, s.scanned, o.carried) for o, s in zip(seen, scenes, strict=True)]
    )
    found = student(pictures, states)
    truth = np.stack([scene.block() for scene in scenes])
    assert np.median(np.abs(found.block[:, :2] - truth[:, :2])) < 0.008
    # In a corner nothing is done yet, whatever the hand has been through.
    stuck = truth[:, GAPS].max(1) < 0.02
    assert stuck.any() and (found.done[stuck] < 0.5).all()
