"""Demonstrations on disk: a dataset that comes back as it went, whole or not at all."""

from __future__ import annotations

import gc
import shutil
from pathlib import Path

import numpy as np
import pytest

from resync_robot.core.damage import AGAIN
from resync_robot.core.errors import TrainingError
from resync_robot.core.files import disk_fault
from resync_robot.learning.camera_view import BLOCK_NAMES, PICTURE, STATE_NAMES
from resync_robot.sim_training.demonstrations import dataset
from resync_robot.sim_training.demonstrations.rollouts import Segment
from tests.run_folders import DAMAGES


def segment(n: int = 5, ends: bool = True) -> Segment:
    rng = np.random.default_rng(n)
    pictures = np.kron(rng.integers(0, 255, (n, 3, 8, 8, 3)), np.ones((1, 1, 8, 8, 1))).astype(np.uint8)
    rows = [rng.normal(size=(n, k)).astype(np.float32) for k in (len(STATE_NAMES), 3, len(BLOCK_NAMES))]
    recovered = rng.random(n) > 0.5
    free = recovered | (rng.random(n) > 0.5)
    return Segment(pictures, rows[0], rows[1], recovered, free, rows[2], np.ones(n, dtype=bool), ends)


@pytest.fixture(scope="module")
def shard(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demos") / "shard"
    dataset.write_shard(folder, [segment(5), segment(7, ends=False)], "Recover", "ur7e_2f-140", {"first_seed": 3})
    return folder


def test_a_shard_comes_back_as_it_went(shard: Path) -> None:
    found = dataset.read_shards([shard])
    written = [segment(5), segment(7, ends=False)]
    assert len(found) == 12 and found.segment.tolist() == [0] * 5 + [1] * 7
    assert found.ends.tolist() == [True] * 5 + [False] * 7
    for name in ("state", "action", "recovered", "free", "block", "acts"):
        np.testing.assert_array_equal(getattr(found, name), np.concatenate([getattr(s, name) for s in written]))
    pictures = np.concatenate([s.pictures for s in written]).astype(int)
    assert np.abs(found.pictures - pictures).mean() < 12, "video loses little"
    twice = dataset.read_shards([shard, shard])
    assert np.unique(twice.segment).tolist() == [0, 1, 2, 3]


def test_a_full_disk_leaves_no_shard(shard: Path, tmp_path: Path, full_disk, capfd: pytest.CaptureFixture[str]) -> None:
    for room in (500, 9000):
        with pytest.raises(OSError) as caught, full_disk(room):
            dataset.write_shard(tmp_path / "shard", [segment(5), segment(30)], "Recover", "ur7e_2f-140", {})
        assert disk_fault(caught.value).what == f"cannot write {tmp_path / 'shard'}: File too large"
        with pytest.raises(Exception) as caught, full_disk(room):
            dataset.merge_shards([shard, shard], tmp_path / "whole")
        assert "File too large" in disk_fault(caught.value).what
    del caught
    gc.collect()
    assert not list(tmp_path.iterdir())
    assert "Exception ignored" not in capfd.readouterr().err


def test_a_shard_opens_in_stock_lerobot_and_shards_merge_into_one(shard: Path, tmp_path: Path) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    one = LeRobotDataset("local/recoveries", root=shard, video_backend="pyav")
    assert len(one) == 12 and one.num_episodes == 2
    frame = one[6]
    assert one.meta.robot_type == "ur7e_2f-140" and frame["task"] == "Recover"
    assert frame["observation.images.front"].shape == (3, PICTURE, PICTURE)
    np.testing.assert_allclose(frame["action"].numpy(), segment(7).action[1], rtol=1e-6)
    assert dataset.merge_shards([shard, shard], tmp_path / "whole") == {"segments": 4, "frames": 24}
    whole = LeRobotDataset("local/recoveries", root=tmp_path / "whole", video_backend="pyav")
    assert len(whole) == 24 and whole.num_episodes == 4 and whole.meta.robot_type == "ur7e_2f-140"


@pytest.mark.parametrize("damage", ["version", "stamp", "video"])
def test_a_broken_shard_is_named(shard: Path, tmp_path: Path, damage: str) -> None:
    folder = tmp_path / "broken"
    shutil.copytree(shard, folder)
    if damage == "version":
        (folder / dataset.STAMP).write_text('{"version": 0}', encoding="utf-8")
    elif damage == "stamp":
        (folder / dataset.STAMP).unlink()
    else:
        next((folder / "videos").rglob("*.mp4")).unlink()
    with pytest.raises(TrainingError, match="broken"):
        dataset.read_shards([folder])


def test_any_damage_to_any_file_of_a_shard_is_named(shard: Path, tmp_path: Path) -> None:
    names = sorted(p.relative_to(shard) for p in shard.rglob("*") if p.is_file())
    assert len(names) > 8
    for name in names:
        for how, spoil in DAMAGES.items():
            folder = tmp_path / "broken"
            shutil.copytree(shard, folder)
            spoil(folder / name)
            same = (folder / name).is_file() and (folder / name).read_bytes() == (shard / name).read_bytes()
            for read in (dataset.read_shards, lambda shards: dataset.merge_shards(shards, tmp_path / "whole")):
                if not same:
                    with pytest.raises(TrainingError, match=str(folder)) as caught:
                        read([folder])
                    assert caught.value.fix.endswith(AGAIN), (name, how)
            shutil.rmtree(folder)


def test_no_success_at_all_is_an_error_that_says_so(tmp_path: Path) -> None:
    dataset.write_shard(tmp_path / "empty", [], "Recover", "ur7e_2f-140", {})
    with pytest.raises(TrainingError, match="none of its worlds"):
        dataset.read_shards([tmp_path / "empty"])


def test_moments_of_a_segment_go_from_its_begin_to_its_end(shard: Path) -> None:
    frames = dataset.read_shards([shard])
    shown = dataset.moments(frames, rows=2, columns=4)
    assert shown.shape == (2, 4, 3, PICTURE, PICTURE, 3)
    first = np.flatnonzero(frames.segment == 0)
    np.testing.assert_array_equal(shown[0, [0, -1]], frames.pictures[first[[0, -1]]])
