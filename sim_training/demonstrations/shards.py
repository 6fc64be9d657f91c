"""Demonstrations on disk: shards of a few dozen segments, read back in one go.

A shard is a folder of two files, arrays with pictures as JPEG, and how they came about. Writing it costs little beside
rendering what is in it. What other programs read is made of shards afterwards, by `dataset.py`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8
from safetensors.numpy import load, save

from resync_robot.core.damage import check_shape, reading
from resync_robot.core.errors import TrainingError
from resync_robot.core.files import read_text, whole_folder, write_text
from resync_robot.learning.camera_view import VIEWS
from resync_robot.learning.demonstrations import Demonstrations
from resync_robot.sim_training.demonstrations.rollouts import Segment

VERSION = 9
"""3 had h264 videos, which do not go into one dataset with others; 4 had no hashes of its files; 5 named no robot; 6
did not tell free from recovered; 7 how far a block was carried; 8 was a LeRobot dataset."""
FRAMES, STAMP = "frames.safetensors", "resync.json"
"""The files of a shard: what was seen and done; version, seeds, rig, and what the other file hashes to."""
QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 95, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
NOTHING = "there is no demonstration: the teacher succeeded in none of its worlds"
PER_FRAME = ("state", "action", "recovered", "free", "block", "acts")


def write_shard(folder: Path, segments: Sequence[Segment], task: str, robot: str, stamp: Mapping[str, Any]) -> None:
    """A shard of these segments; whole, or not there at all.

    Args:
        task: what LeRobot's datasets call the instruction.
        robot: what they call the robot type.
        stamp: how it came about: seeds, rig hash, commit.
    """
    with whole_folder(folder) as beside:
        beside.mkdir()
        if segments:
            (beside / FRAMES).write_bytes(save(_packed(segments)))
        counts = {"segments": len(segments), "frames": sum(len(s.state) for s in segments)}
        head = {"version": VERSION, "files": _hashes(beside), "task": task, "robot": robot, **counts}
        write_text(beside / STAMP, json.dumps({**head, **stamp}, indent=2, sort_keys=True) + "\n")


def _packed(segments: Sequence[Segment]) -> dict[str, np.ndarray]:
    """Arrays over all frames, and the pictures' JPEGs one behind the other."""
    jpegs = [_jpeg(picture) for s in segments for picture in s.pictures.reshape(-1, *s.pictures.shape[2:])]
    return {
        **{name: np.concatenate([getattr(s, name) for s in segments]) for name in PER_FRAME},
        "ends": np.array([s.ends for s in segments]),
        "lengths": np.array([len(s.state) for s in segments]),
        "jpegs": np.concatenate(jpegs),
        "jpeg_lengths": np.array([len(j) for j in jpegs]),
    }


def _jpeg(picture: UInt8[np.ndarray, "p p 3"]) -> UInt8[np.ndarray, " n"]:
    return cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), QUALITY)[1].reshape(-1)


def _pictures(arrays: Mapping[str, np.ndarray]) -> UInt8[np.ndarray, "n v p p 3"]:
    parts = np.split(arrays["jpegs"], np.cumsum(arrays["jpeg_lengths"])[:-1])
    pictures = np.stack([cv2.cvtColor(cv2.imdecode(p, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB) for p in parts])
    return pictures.reshape(-1, len(VIEWS), *pictures.shape[1:])


def _hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every file but the stamp, by its path in the folder."""
    paths = sorted(p for p in folder.rglob("*") if p.is_file() and p != folder / STAMP)
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in paths}


def count(shards: Sequence[Path]) -> dict[str, int]:
    """How many "segments" and "frames" these hold. Raises TrainingError as `read_shards` does."""
    stamps = [check_shard(shard) for shard in shards]
    return {name: sum(int(stamp[name]) for stamp in stamps) for name in ("segments", "frames")}


def read_shards(folders: Sequence[Path]) -> Demonstrations:
    """Every frame of the shards. Raises TrainingError where one is missing, broken or of another version."""
    segments = [s for folder in folders for s in read_shard(folder)]
    if not segments:
        raise TrainingError(NOTHING)
    lengths = [len(s.state) for s in segments]
    return Demonstrations(
        pictures=np.concatenate([s.pictures for s in segments]),
        segment=np.repeat(np.arange(len(segments)), lengths),
        ends=np.repeat([s.ends for s in segments], lengths),
        **{name: np.concatenate([getattr(s, name) for s in segments]) for name in PER_FRAME},
    )


def read_shard(folder: Path) -> tuple[Segment, ...]:
    """What `write_shard` was given, but for what JPEG loses. Raises TrainingError as `read_shards` does."""
    stamp = check_shard(folder)
    if not stamp["segments"]:
        return ()
    with reading(folder):
        arrays = load((folder / FRAMES).read_bytes())
        until = np.cumsum(arrays["lengths"])[:-1]
        pictures = np.split(_pictures(arrays), until)
        parts = {name: np.split(arrays[name], until) for name in PER_FRAME}
        return tuple(
            Segment(pictures=pictures[i], ends=bool(ends), **{name: part[i] for name, part in parts.items()})
            for i, ends in enumerate(arrays["ends"])
        )


def check_shard(folder: Path) -> dict[str, Any]:
    """Its stamp. Raises TrainingError where the shard is not, file by file, what `write_shard` left."""
    with reading(folder):
        stamp = json.loads(read_text(folder / STAMP))
        found = stamp.get("version") if isinstance(stamp, dict) else None
        if found != VERSION:
            raise ValueError(f"its demonstrations are of version {found}, this program reads {VERSION}")
        check_shape(stamp, {"files": {}, "segments": int, "frames": int, "task": str, "robot": str})
        here = _hashes(folder)
        for name, digest in stamp["files"].items():
            if name not in here:
                raise ValueError(f"{name} is missing")
            if here[name] != digest:
                raise ValueError(f"{name} was cut off or altered since it was written")
        return dict(stamp)


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
