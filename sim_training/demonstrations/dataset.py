"""Demonstrations on disk: a LeRobot dataset with AV1 videos, written in shards, read back in one go.

Training reads every frame many times, and decoding is slow, so all videos are decoded once into memory.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, suppress
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from resync_robot.core.damage import check_shape, reading
from resync_robot.core.errors import TrainingError
from resync_robot.core.files import read_text, whole_folder, write_text
from resync_robot.learning.camera_view import ACTION_NAMES, BLOCK_NAMES, RATE_HZ, STATE_NAMES, VIEWS
from resync_robot.learning.demonstrations import Demonstrations
from resync_robot.sim_training.demonstrations.rollouts import Segment

VERSION = 8
"""3 had h264 videos, which do not go into one dataset with others; 4 had no hashes of its files; 5 named no robot; 6
did not tell free from recovered; 7 how far a block was carried."""
CODEC = "libsvtav1"
"""The same pictures become the same video. x264, as LeRobot calls it, encodes one group of frames in a hundred another
way each time, and so the same seed led to another policy."""
QUEUE = 10_000
"""Frames that wait for their encoder. LeRobot drops those that find its queue full, on a busy machine every few."""
STAMP = "resync.json"
"""Beside LeRobot's own files: version, seeds, rig, and what the files of a shard hash to."""
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


def write_shard(folder: Path, segments: Sequence[Segment], task: str, robot: str, stamp: Mapping[str, Any]) -> None:
    """A LeRobot dataset with an episode for each segment; whole, or not there at all.

    Args:
        task: what LeRobot's datasets call the instruction.
        robot: what they call the robot type.
        stamp: how it came about: seeds, rig hash, commit.
    """
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    with whole_folder(folder) as beside:
        if segments:
            dataset = LeRobotDataset.create(
                repo_id="local/recoveries",
                fps=int(RATE_HZ),
                features=features(segments[0].pictures.shape[2]),
                robot_type=robot,
                root=beside,
                use_videos=True,
                vcodec=CODEC,
                streaming_encoding=True,
                encoder_queue_maxsize=QUEUE,
                video_backend="pyav",
            )
            with _quiet():
                try:
                    for segment in segments:
                        _add(dataset, segment, task)
                    dataset.finalize()
                except BaseException:
                    _abandon(dataset)
                    raise
        write_text(beside / STAMP, _json({"version": VERSION, "files": _hashes(beside), **stamp}))


def _json(data: Mapping[str, Any]) -> str:
    return json.dumps(data, indent=2, sort_keys=True) + "\n"


def _hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every file but the stamp, by its path in the folder."""
    paths = sorted(p for p in folder.rglob("*") if p.is_file() and p != folder / STAMP)
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in paths}


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


def merge_shards(shards: Sequence[Path], folder: Path) -> dict[str, int]:
    """One LeRobot dataset of all shards, for whoever wants to train or look elsewhere; whole, or not there at all.

    Returns:
        How many "segments" (LeRobot's episodes) and "frames" it holds.

    Raises:
        TrainingError: a shard is missing, damaged or of another version.
    """
    from lerobot.datasets.aggregate import aggregate_datasets

    for shard in shards:
        check_shard(shard)
    parts = [s for s in shards if (s / "meta" / "info.json").exists()]
    with whole_folder(folder) as beside:
        with _quiet():
            aggregate_datasets(["local/recoveries"] * len(parts), "local/recoveries", roots=parts, aggr_root=beside)
        stamps = [json.loads(read_text(s / STAMP)) for s in shards]
        write_text(beside / STAMP, _json({"version": VERSION, "shards": stamps}))
    info = json.loads(read_text(folder / "meta" / "info.json"))
    return {"segments": int(info["total_episodes"]), "frames": int(info["total_frames"])}


def moments(frames: Demonstrations, rows: int = 12, columns: int = 5) -> UInt8[np.ndarray, "r c v p p 3"]:
    """What the cameras saw: segments drawn evenly, a row each, at moments spread evenly from its begin to its end."""
    # Still moments and stubs show little.
    chosen = [
        s
        for s in np.unique(frames.segment)
        if (frames.segment == s).sum() >= columns and frames.acts[frames.segment == s].all()
    ]
    shown = []
    for segment in chosen[:: max(1, len(chosen) // rows)][:rows]:
        of = np.flatnonzero(frames.segment == segment)
        some = of[np.linspace(0, len(of) - 1, columns).astype(int)]
        shown.append(frames.pictures[some])
    return np.stack(shown) if shown else np.zeros((0, columns, *frames.pictures.shape[1:]), dtype=np.uint8)


def read_shards(folders: Sequence[Path]) -> Demonstrations:
    """Every frame of the shards, decoded. Raises TrainingError where one is missing, broken or of another version."""
    parts = [p for p in (_read_shard(folder) for folder in folders) if p is not None]
    if not parts:
        raise TrainingError("there is no demonstration: the teacher succeeded in none of its worlds")
    offsets = np.cumsum([0, *(int(p.segment.max()) + 1 for p in parts)])

    def joined(name: str) -> np.ndarray:
        return np.concatenate([getattr(p, name) for p in parts])

    return Demonstrations(
        pictures=joined("pictures"),
        state=joined("state"),
        action=joined("action"),
        recovered=joined("recovered"),
        free=joined("free"),
        block=joined("block"),
        acts=joined("acts"),
        segment=np.concatenate([p.segment + o for p, o in zip(parts, offsets, strict=False)]),
        ends=joined("ends"),
    )


def _read_shard(folder: Path) -> Demonstrations | None:
    import pyarrow.parquet as pq

    check_shard(folder)
    with reading(folder):
        tables = [pq.read_table(path).to_pydict() for path in sorted((folder / "data").rglob("*.parquet"))]
        if not tables:
            return None
        columns = {name: np.concatenate([np.asarray(t[name]) for t in tables]) for name in tables[0]}
        pictures = np.stack([_decode(folder, view, len(columns["index"])) for view in VIEWS], axis=1)
        return Demonstrations(
            pictures,
            columns["observation.state"].astype(np.float32),
            columns["action"].astype(np.float32),
            columns[RECOVERED].reshape(-1) > 0.5,
            columns[FREE].reshape(-1) > 0.5,
            columns[WHERE].astype(np.float32),
            columns[ACTS].reshape(-1) > 0.5,
            columns["episode_index"],
            columns[ENDS].reshape(-1) > 0.5,
        )


def check_shard(folder: Path) -> None:
    """Raises TrainingError where the shard is not, file by file, what `write_shard` left."""
    with reading(folder):
        stamp = json.loads(read_text(folder / STAMP))
        found = stamp.get("version") if isinstance(stamp, dict) else None
        if found != VERSION:
            raise ValueError(f"its demonstrations are of version {found}, this program reads {VERSION}")
        check_shape(stamp, {"files": {}})
        here = _hashes(folder)
        for name, digest in stamp["files"].items():
            if name not in here:
                raise ValueError(f"{name} is missing")
            if here[name] != digest:
                raise ValueError(f"{name} was cut off or altered since it was written")


def _decode(folder: Path, view: str, count: int) -> UInt8[np.ndarray, "n p p 3"]:
    import av

    frames: list[np.ndarray] = []
    for path in sorted((folder / "videos" / f"observation.images.{view}").rglob("*.mp4")):
        with av.open(str(path)) as container:
            frames += [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
    if len(frames) != count:
        raise ValueError(f"the videos of '{view}' hold {len(frames)} frames, the table {count}")
    return np.stack(frames)
