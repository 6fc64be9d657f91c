"""Demonstrations as stock LeRobot reads them: all of them, or nothing at all."""

from __future__ import annotations

import gc
from pathlib import Path

import numpy as np
import pytest

from resync_robot.core.errors import TrainingError
from resync_robot.core.files import disk_fault
from resync_robot.learning.camera_view import PICTURE
from resync_robot.sim_training.demonstrations.dataset import NAME, write_dataset
from resync_robot.sim_training.demonstrations.shards import STAMP, write_shard
from tests.sim_training.demonstrations.segments import ROBOT, TASK, segment


@pytest.fixture(scope="module")
def shards(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two with segments, and one between them in whose worlds nothing succeeded."""
    folder = tmp_path_factory.mktemp("demos")
    held = ([segment(5), segment(7, ends=False)], [], [segment(6)])
    for i, segments in enumerate(held):
        write_shard(folder / f"turn-0-{i:04d}", segments, TASK, ROBOT, {"first_seed": i})
    return sorted(folder.iterdir())


def test_stock_lerobot_opens_it(shards: list[Path], tmp_path: Path) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    assert list(write_dataset(shards, tmp_path / "whole")) == [1, 2]
    whole = LeRobotDataset(NAME, root=tmp_path / "whole", video_backend="pyav")
    assert len(whole) == 18 and whole.num_episodes == 3 and whole.meta.robot_type == ROBOT
    frame = whole[6]
    assert frame["task"] == TASK and frame["observation.images.front"].shape == (3, PICTURE, PICTURE)
    np.testing.assert_allclose(frame["action"].numpy(), segment(7).action[1], rtol=1e-6)
    seen = frame["observation.images.side"].permute(1, 2, 0).numpy()
    assert np.abs(255 * seen - segment(7).pictures[1, 1].astype(float)).mean() < 14, "video loses little"
    assert [p.name for p in tmp_path.iterdir()] == ["whole"]


def test_a_full_disk_leaves_nothing(
    shards: list[Path], tmp_path: Path, full_disk, capfd: pytest.CaptureFixture[str]
) -> None:
    for room in (500, 9000):
        with pytest.raises(Exception) as caught, full_disk(room):
            list(write_dataset(shards, tmp_path / "whole"))
        assert "File too large" in disk_fault(caught.value).what
    del caught
    gc.collect()
    assert not list(tmp_path.iterdir())
    assert "Exception ignored" not in capfd.readouterr().err


def test_a_damaged_shard_is_named_before_anything_is_written(shards: list[Path], tmp_path: Path) -> None:
    write_shard(tmp_path / "broken", [segment(5)], TASK, ROBOT, {})
    (tmp_path / "broken" / STAMP).unlink()
    with pytest.raises(TrainingError, match="broken"):
        list(write_dataset([*shards, tmp_path / "broken"], tmp_path / "whole"))
    assert [p.name for p in tmp_path.iterdir()] == ["broken"]


def test_shards_without_a_segment_make_no_dataset(shards: list[Path], tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="none of its worlds"):
        list(write_dataset([shards[1]], tmp_path / "whole"))
    assert not list(tmp_path.iterdir())
