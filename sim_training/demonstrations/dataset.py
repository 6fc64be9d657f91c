"""Demonstrations as a LeRobot dataset with AV1 videos, for whoever wants to train or look elsewhere.

LeRobot takes longer to write an episode than the simulation to make it, so training writes shards, and whoever wants a
dataset has it made of them.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, suppress
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from resync_robot.core.errors import TrainingError
from resync_robot.core.files import whole_folder
from resync_robot.learning.camera_view import ACTION_NAMES, BLOCK_NAMES, RATE_HZ, STATE_NAMES, VIEWS
from resync_robot.sim_training.demonstrations.rollouts import Segment
from resync_robot.sim_training.demonstrations.shards import NOTHING, check_shard, read_shard
from resync_robot.sim_training.parallel import parallel_map

NAME = "local/recoveries"
"""What LeRobot calls the dataset. It lies on this disk and on no hub."""
CODEC = "libsvtav1"
"""The same pictures become the same video. x264, as LeRobot calls it, encodes one group of frames in a hundred another
way each time."""
QUEUE = 10_000
"""Frames that wait for their encoder. LeRobot drops those that find its queue full, on a busy machine every few."""
RECOVERED, FREE, WHERE = "privileged.recovered", "privileged.free", "privileged.block"
ACTS, ENDS = "segment.acts", "segment.ends_recovered"


def features(side: int) -> dict[str, dict[str, Any]]:
    """LeRobot's description of a frame whose pictures have sides of so many pixels."""
    picture = {"dtype": "video", "shape": (side, side, 3), "names": ["height", "width", "channels"]}
    return {
        **{f"observation.images.{view}": dict(picture) for view in VIEWS},
        "observation.state": {"dtype": "float32", "shape": (len(STATE_NAMES),), "names": list(STATE_NAMES)},
        "action": {"dtype": "float32", "shape": (len(ACTION_NAMES),), "names": list(ACTION_NAMES)},
        RECOVERED: {"dtype": "float32", "shape": (1,), "names": ["recovered"]},
        FREE: {"dtype": "float32", "shape": (1,), "names": ["free"]},
        WHERE: {"dtype": "float32", "shape": (len(BLOCK_NAMES),), "names": list(BLOCK_NAMES)},
        ACTS: {"dtype": "float32", "shape": (1,), "names": ["acts"]},
        ENDS: {"dtype": "float32", "shape": (1,), "names": ["ends"]},
    }


def write_dataset(shards: Sequence[Path], folder: Path, workers: int = 1) -> Iterator[int]:
    """One LeRobot dataset with an episode for each segment of the shards; whole, or not there at all.

    Yields:
        How many shards are in it so far.

    Raises:
        TrainingError: a shard is missing, damaged or of another version, or none holds anything.
    """
    from lerobot.datasets.aggregate import aggregate_datasets

    held = [shard for shard in shards if check_shard(shard)["segments"]]
    if not held:
        raise TrainingError(NOTHING)
    parts = folder.with_name(f"{folder.name}.parts")
    shutil.rmtree(parts, ignore_errors=True)
    try:
        jobs = [(shard, parts / f"{i:05d}") for i, shard in enumerate(held)]
        yield from (i for i, _ in enumerate(parallel_map(_part, jobs, _nothing, workers), start=1))
        with whole_folder(folder) as beside, _quiet():
            aggregate_datasets([NAME] * len(jobs), NAME, roots=[part for _, part in jobs], aggr_root=beside)
    finally:
        shutil.rmtree(parts, ignore_errors=True)


def _nothing() -> None:
    """What a process needs beforehand."""


def _part(_: None, job: tuple[Path, Path]) -> None:
    """The dataset of one shard."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    shard, folder = job
    stamp, segments = check_shard(shard), read_shard(shard)
    with whole_folder(folder) as beside, _quiet():
        dataset = LeRobotDataset.create(
            repo_id=NAME,
            fps=int(RATE_HZ),
            features=features(segments[0].pictures.shape[2]),
            robot_type=stamp["robot"],
            root=beside,
            use_videos=True,
            vcodec=CODEC,
            streaming_encoding=True,
            encoder_queue_maxsize=QUEUE,
            video_backend="pyav",
        )
        try:
            for segment in segments:
                _add(dataset, segment, stamp["task"])
            dataset.finalize()
        except BaseException:
            _abandon(dataset)
            raise


@contextmanager
def _quiet() -> Iterator[None]:
    """The encoder writes dozens of lines for every video, LeRobot a progress bar for each: nothing for a person."""
    import av.logging

    av.logging.set_libav_level(av.logging.ERROR)
    os.environ["SVT_LOG"] = "1"
    with redirect_stderr(StringIO()):
        yield


def _add(dataset: Any, segment: Segment, task: str) -> None:
    for i in range(len(segment.state)):
        pictures = {f"observation.images.{v}": segment.pictures[i, k] for k, v in enumerate(VIEWS)}
        dataset.add_frame(
            {
                **pictures,
                "observation.state": segment.state[i],
                "action": segment.action[i],
                RECOVERED: np.array([segment.recovered[i]], dtype=np.float32),
                FREE: np.array([segment.free[i]], dtype=np.float32),
                WHERE: segment.block[i],
                ACTS: np.array([segment.acts[i]], dtype=np.float32),
                ENDS: np.array([segment.ends], dtype=np.float32),
                "task": task,
            }
        )
    dataset.save_episode()


def _abandon(dataset: Any) -> None:
    """After a failure: LeRobot's destructors would try again, later, make the folder anew, and complain."""
    with suppress(Exception):
        dataset.clear_episode_buffer()
    dataset.meta.metadata_buffer.clear()
    for owner in (dataset, dataset.meta):
        if owner.writer is not None:
            with suppress(Exception):
                owner.writer.close()
            owner.writer.is_open = False
