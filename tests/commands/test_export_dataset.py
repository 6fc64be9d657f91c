"""A run's demonstrations as a LeRobot dataset, from the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from resync_robot.cli import BAD_INPUT, main
from resync_robot.sim_training.demonstrations.shards import write_shard
from tests.sim_training.demonstrations.segments import ROBOT, TASK, segment


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """As much of a run as the command reads; a kill left a part of a shard."""
    for i, n in enumerate((5, 6)):
        folder = tmp_path / "run" / "stages" / "1-Recover" / "demonstrations" / f"turn-0-{i:04d}"
        write_shard(folder, [segment(n)], TASK, ROBOT, {})
    folder.with_name("turn-0-0002.part").mkdir()
    return tmp_path / "run"


def test_it_writes_what_a_run_demonstrated(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    assert main(["export-dataset", str(run), "--workers", "1"]) == 0
    assert "dataset: 2 episodes, 11 frames" in capsys.readouterr().out
    assert len(LeRobotDataset("local/recoveries", root=run / "dataset", video_backend="pyav")) == 11
    # A second time it would take the place of something.
    assert main(["export-dataset", str(run)]) == BAD_INPUT
    assert f"{run / 'dataset'} exists; it is left as it is" in capsys.readouterr().err


def test_what_holds_no_demonstrations_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export-dataset", str(tmp_path / "none")]) == BAD_INPUT
    assert f"{tmp_path / 'none'} holds no demonstrations" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_number_of_processes_that_cannot_be_is_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export-dataset", str(run), "--workers", "0"]) == BAD_INPUT
    assert "--workers" in capsys.readouterr().err and not (run / "dataset").exists()
