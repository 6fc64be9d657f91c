"""The demonstrations of a run as a dataset that stock LeRobot opens."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from resync_robot.given import Given


@dataclass(frozen=True, kw_only=True)
class ExportDatasetConfig:
    """Write what a training showed its camera policy as a LeRobot dataset (docs/lerobot.md)."""

    run: tyro.conf.Positional[Path]
    """The folder of a run of train-sim that has demonstrated in pictures."""

    out: Given[Path] = None
    """The folder of the dataset. Default: dataset, in that of the run."""

    workers: int = 2
    """How many processes write it. Each writes the pictures of about twenty moments a second."""


def export_dataset(config: ExportDatasetConfig) -> None:
    """Write it, and say what it holds.

    Raises:
        ConfigError: the run holds no demonstrations, or there is a folder already where the dataset is to be.
        TrainingError: what it holds is damaged.
        DiskError: there is no room.
    """
    from resync_robot.console import Stages, say
    from resync_robot.core.errors import ConfigError
    from resync_robot.core.files import check_folder
    from resync_robot.core.options import MOST_WORKERS, check_range
    from resync_robot.sim_training.demonstrations.dataset import write_dataset
    from resync_robot.sim_training.demonstrations.shards import count

    shards = sorted(p for p in config.run.glob("stages/*/demonstrations/turn-*") if p.suffix not in (".part", ".old"))
    if not shards:
        raise ConfigError(
            f"{config.run} holds no demonstrations",
            "name the folder of a run with --skills camera, which `resync-robot train-sim` prints at its end",
        )
    check_range("--workers", config.workers, 1, MOST_WORKERS)
    out = config.out or config.run / "dataset"
    if out.exists():
        raise ConfigError(f"{out} exists; it is left as it is", "remove it, or give another folder with --out")
    check_folder(out.parent)
    held = count(shards)
    with Stages(["export"]) as stages, stages.stage("export") as progress:
        for written in write_dataset(shards, out, config.workers):
            progress(written / len(shards), f"{written} of {len(shards)} parts")
    say(f"{out}: {held['segments']} episodes, {held['frames']} frames. How to train on it: docs/lerobot.md")
