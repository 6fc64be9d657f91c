"""Demonstrations on disk: they come back as they went, whole or not at all."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from resync_robot.core.damage import AGAIN
from resync_robot.core.errors import TrainingError
from resync_robot.core.files import disk_fault
from resync_robot.learning.camera_view import PICTURE
from resync_robot.sim_training.demonstrations import shards
from tests.run_folders import DAMAGES
from tests.sim_training.demonstrations.segments import ROBOT, TASK, segment


@pytest.fixture(scope="module")
def shard(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demos") / "shard"
    shards.write_shard(folder, [segment(5), segment(7, ends=False)], TASK, ROBOT, {"first_seed": 3})
    return folder


def test_a_shard_comes_back_as_it_went(shard: Path) -> None:
    found = shards.read_shards([shard])
    written = [segment(5), segment(7, ends=False)]
    assert len(found) == 12 and found.segment.tolist() == [0] * 5 + [1] * 7
    assert found.ends.tolist() == [True] * 5 + [False] * 7
    for name in ("state", "action", "recovered", "free", "block", "acts"):
        np.testing.assert_array_equal(getattr(found, name), np.concatenate([getattr(s, name) for s in written]))
    pictures = np.concatenate([s.pictures for s in written]).astype(int)
    assert np.abs(found.pictures - pictures).mean() < 4, "JPEG loses little"
    assert shards.count([shard, shard]) == {"segments": 4, "frames": 24}
    twice = shards.read_shards([shard, shard])
    assert np.unique(twice.segment).tolist() == [0, 1, 2, 3]


def test_a_full_disk_leaves_no_shard(tmp_path: Path, full_disk) -> None:
    for room in (500, 9000):
        with pytest.raises(OSError) as caught, full_disk(room):
            shards.write_shard(tmp_path / "shard", [segment(5), segment(30)], TASK, ROBOT, {})
        assert disk_fault(caught.value).what == f"cannot write {tmp_path / 'shard'}: File too large"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("damage", ["version", "stamp", "frames"])
def test_a_broken_shard_is_named(shard: Path, tmp_path: Path, damage: str) -> None:
    folder = tmp_path / "broken"
    shutil.copytree(shard, folder)
    if damage == "version":
        (folder / shards.STAMP).write_text('{"version": 0}', encoding="utf-8")
    elif damage == "stamp":
        (folder / shards.STAMP).unlink()
    else:
        (folder / shards.FRAMES).unlink()
    with pytest.raises(TrainingError, match="broken"):
        shards.read_shards([folder])


def test_any_damage_to_any_file_of_a_shard_is_named(shard: Path, tmp_path: Path) -> None:
    names = sorted(p.relative_to(shard) for p in shard.rglob("*") if p.is_file())
    assert names == [Path(shards.FRAMES), Path(shards.STAMP)]
    for name in names:
        for how, spoil in DAMAGES.items():
            folder = tmp_path / "broken"
            shutil.copytree(shard, folder)
            spoil(folder / name)
            same = (folder / name).is_file() and (folder / name).read_bytes() == (shard / name).read_bytes()
            for read in (shards.read_shards, shards.count):
                if not same:
                    with pytest.raises(TrainingError, match=str(folder)) as caught:
                        read([folder])
                    assert caught.value.fix.endswith(AGAIN), (name, how)
            shutil.rmtree(folder)


def test_no_success_at_all_is_an_error_that_says_so(tmp_path: Path) -> None:
    shards.write_shard(tmp_path / "empty", [], TASK, ROBOT, {})
    with pytest.raises(TrainingError, match="none of its worlds"):
        shards.read_shards([tmp_path / "empty"])


def test_moments_of_a_segment_go_from_its_begin_to_its_end(shard: Path) -> None:
    frames = shards.read_shards([shard])
    shown = shards.moments(frames, rows=2, columns=4)
    assert shown.shape == (2, 4, 3, PICTURE, PICTURE, 3)
    first = np.flatnonzero(frames.segment == 0)
    np.testing.assert_array_equal(shown[0, [0, -1]], frames.pictures[first[[0, -1]]])
