"""One episode as one append-only MCAP file: what was measured, believed, planned, asked, sent, and what happened.

| channel | message |
|---|---|
| /meta | EpisodeMeta: rig, library, domain, scenario, goal, seed, versions, types, date; first, and again at the end |
| /joints | measured, commanded (sent) and requested joints and openings |
| /tip_force | force on the hand, N, world frame |
| /state | the belief about the objects, `State.to_json` |
| /truth | the same from a simulator that knows; never in a recording of a real robot |
| /atoms | text of each atom -> probability |
| /plan | steps, index of the one under way, why it was planned |
| /event | scan, skill start and end, replan, give-up, goal, stop, and what is known of a real robot at the end |
| /answer | what the executive was told of the world, in the order in which it asked: what a replay answers with |
| /timing | of each target: exposure of what was looked at before it, asked, first setpoint due, seconds of computing |
| /camera/NAME/info | intrinsics and pose of a picture that was asked for |
| /camera/NAME/{colour,depth} | sensor_msgs/CompressedImage: PNG, and 16-bit PNG (unit 1e-4 m, 0 = nothing) |
| /camera/NAME/window | the same as PNG: the parts that a skill looked at while it moved |
| /camera/NAME/film | the same as JPEG: what the camera saw while nobody asked, for people |
| /points | sensor_msgs/PointCloud2: fused cloud in the world, x y z in m, rgb |

All are messages of ROS 2, so that rosbag2 and its relatives open the file as it is: all but the last four a
std_msgs/String of JSON, whose schema stands in the channel's `json_schema`. For Foxglove, RViz and Rerun the same once
more as they draw it: /robot_description and /tf_static (both latched), /joint_states, /joint_commands, /tf, /wrench,
/belief_markers, /truth_markers, /camera/NAME/{camera_info,depth_mm}, /plan_text, /atoms_text, /rosout, /latency.
`core.robot_description` has the tree of their frames. Of a domain with a robot of its own there is no rig: neither
joints nor their frames are told, and /camera/scene/film has the pictures of its simulator.

Times are seconds from the beginning of the episode. The file has them as ns of the wall clock, so that recordings lie
beside other logs of that day; the date of the beginning is in /meta and nowhere else. `core.episode_writer` writes such
a file; `read_episode` returns what is whole of a damaged one.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Float
from mcap.records import Channel, Message

from resync_robot.core import ros_messages
from resync_robot.core.episode_records import (
    Answer,
    Ask,
    EpisodeMeta,
    Event,
    EventKind,
    Joints,
    Picture,
    Plan,
    Points,
    Timing,
)
from resync_robot.core.errors import EpisodeError, ResyncError
from resync_robot.core.files import unwritable
from resync_robot.core.joints import JointTarget
from resync_robot.core.mcap_file import WholeRecords, read_whole, write_whole
from resync_robot.core.state import State
from resync_robot.core.symbols import Type
from resync_robot.core.vocabulary import TYPES

FORMAT = 6
"""1 had pictures as plain JPEG, and nothing of ROS 2; in 2 no date was told, and times in the file began at 0; up to 3
JSON stood in the file as such, and each camera and joint had a frame in the world; up to 4 the types of objects were
not told, up to 5 not the model that was planned with."""
READABLE = (2, 3, 4, 5, 6)
MOST = 8
"""Spans of missing seconds that a message tells one by one."""


def read_episode(path: Path, unbroken: bool = False) -> Episode:
    """Read a recording; of a damaged one, everything that is whole.

    Args:
        unbroken: give only what comes before the first thing that is missing.

    Raises:
        EpisodeError: no such file, no MCAP, no recording of this program, or of another format version.
    """
    whole = _records_of(path)
    return _episode_of(path, whole, whole.unbroken if unbroken else len(whole.records))


def mend_episode(path: Path, out: Path) -> Episode:
    """Copy what is whole of a recording to `out`, which every reader takes, of ROS 2 too.

    Returns:
        The recording as it was found: `damage` and `missing` are what the copy is without.

    Raises:
        EpisodeError: as `read_episode`, or `out` exists or cannot be written.
    """
    whole = _records_of(path)
    found = _episode_of(path, whole, len(whole.records))
    try:
        write_whole(whole.records, out)
    except OSError as error:
        raise unwritable(out, error, "give another file with --mend", EpisodeError) from None
    return found


def _records_of(path: Path) -> WholeRecords:
    try:
        return read_whole(path)
    except OSError as error:
        raise EpisodeError(f"cannot read the recording {path}: {error.strerror}", "give a file *.mcap") from None


def _episode_of(path: Path, whole: WholeRecords, count: int) -> Episode:
    """The first `count` of the records, and what is said about them anywhere."""
    raw: dict[str, list[tuple[int, bytes]]] = {}
    topics: dict[int, str] = {}
    about = b""
    for i, record in enumerate(whole.records):
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message) and record.channel_id in topics:
            topic = topics[record.channel_id]
            if topic == "/meta":
                about = about or record.data
            if i < count:
                raw.setdefault(topic, []).append((record.log_time, record.data))
    if not about:
        what = "is no recording of this program, or its start is lost" if whole.records else "is no recording"
        raise EpisodeError(
            f"{path} {what}: {whole.damage or 'it has no channel /meta'}", "give a file *.mcap that deploy wrote"
        )
    content = _parse(path, "/meta", about)
    if content.pop("format", None) not in READABLE:
        allowed = " or ".join(map(str, READABLE))
        raise EpisodeError(f"{path} has another format than {allowed}", "read it with the program that wrote it")
    try:
        meta = EpisodeMeta(**content)
    except TypeError as error:
        raise EpisodeError(f"{path}: /meta is incomplete: {error}") from None
    try:
        began = meta.began_ns
    except (TypeError, ValueError) as error:
        raise EpisodeError(f"{path}: /meta tells no date of the beginning: {error}") from None
    messages = {topic: [((at - began) / 1e9, data) for at, data in found] for topic, found in raw.items()}
    missing = tuple(
        (0.0 if begin is None else (begin - began) / 1e9, math.inf if end is None else (end - began) / 1e9)
        for begin, end in whole.missing
    )
    return Episode(path, meta, whole.damage, missing, messages)


@dataclass(frozen=True)
class Episode:
    """A recording in memory. Iterators yield in order of writing and raise EpisodeError on a message that makes no
    sense.

    Attributes:
        damage: None for a whole file, else what is wrong with it, and how much is whole.
        missing: from and to which seconds something that was recorded is lost; to infinity where the end is.
        messages: topic -> (time in s, raw message).
    """

    path: Path
    meta: EpisodeMeta
    damage: str | None
    missing: tuple[tuple[float, float], ...]
    messages: Mapping[str, list[tuple[float, bytes]]] = field(repr=False)

    @property
    def loss(self) -> str:
        """What is wrong and which seconds are missing, for people; empty for a whole file."""
        if not self.missing:
            return f"{self.damage}; no message is missing" if self.damage else ""
        spans = [_span(f"{begin:.1f}", f"{end:.1f}") for begin, end in self.missing]
        more = f", and {len(spans) - MOST} times more" if len(spans) > MOST else ""
        return f"{self.damage}; something is missing {', '.join(spans[:MOST])}{more}"

    @cached_property
    def types(self) -> Mapping[str, Type]:
        """Of its objects, by name; an older recording has those of the arm. Raises EpisodeError."""
        try:
            return {name: Type.from_json(name, data) for name, data in self.meta.types.items()} or TYPES
        except (AttributeError, KeyError, TypeError, ValueError, ResyncError) as error:
            raise EpisodeError(f"{self.path}: the types in /meta make no sense: {error}") from None

    @property
    def duration(self) -> float:
        """Time of the latest message, s."""
        return max((time for channel in self.messages.values() for time, _ in channel), default=0.0)

    @property
    def cameras(self) -> tuple[str, ...]:
        """Those that were looked through, or filmed."""
        kinds = ("/info", "/window", "/film")
        return tuple(sorted({t.split("/")[2] for t in self.messages if t.startswith("/camera/") and t.endswith(kinds)}))

    def joints(self) -> Iterator[Joints]:
        for time, m in self._read("/joints"):
            with self._sense("/joints", time):
                sent = JointTarget(_vector(m["sent"], 6), _number(m["sent_opening"]))
                requested = JointTarget(_vector(m["requested"], 6), _number(m["requested_opening"]))
                opening = _number(m["opening"])
                record = Joints(time, _vector(m["measured"], 6), _vector(m["velocity"], 6), opening, sent, requested)
            yield record

    def tip_force(self) -> Iterator[tuple[float, Float[np.ndarray, "3"]]]:
        for time, m in self._read("/tip_force"):
            with self._sense("/tip_force", time):
                force = _vector(m["force"], 3)
            yield time, force

    def states(self) -> Iterator[tuple[float, State]]:
        return self._states("/state")

    def truths(self) -> Iterator[tuple[float, State]]:
        return self._states("/truth")

    def atoms(self) -> Iterator[tuple[float, dict[str, float]]]:
        for time, m in self._read("/atoms"):
            with self._sense("/atoms", time):
                atoms = {str(atom): _number(p) for atom, p in m["atoms"].items()}
            yield time, atoms

    def plans(self) -> Iterator[Plan]:
        for time, m in self._read("/plan"):
            with self._sense("/plan", time):
                current = None if m["current"] is None else int(m["current"])
                plan = Plan(time, tuple(str(s) for s in m["steps"]), current, str(m["reason"]))
            yield plan

    def events(self) -> Iterator[Event]:
        for time, m in self._read("/event"):
            with self._sense("/event", time):
                event = Event(time, EventKind(m["kind"]), str(m["text"]), dict(m["details"]))
            yield event

    def answers(self) -> Iterator[tuple[float, Answer]]:
        """Time in s of the episode, and what the executive was told then."""
        for time, m in self._read("/answer"):
            with self._sense("/answer", time):
                target = JointTarget(_vector(m["target"], 6), _number(m["target_opening"]))
                answer = Answer(Ask[m["ask"]], _number(m["clock"]), target, dict(m["details"]))
            yield time, answer

    def timings(self) -> Iterator[Timing]:
        for time, m in self._read("/timing"):
            with self._sense("/timing", time):
                picture = None if m["picture"] is None else _number(m["picture"])
                timing = Timing(picture, *(_number(m[name]) for name in ("asked", "due", "computed")))
            yield timing

    def pictures(self, camera: str) -> Iterator[Picture]:
        colours, depths = (dict(self.messages.get(f"/camera/{camera}/{kind}", ())) for kind in ("colour", "depth"))
        for kind, pictures in (("colour", colours), ("depth", depths)):
            for time, message in pictures.items():
                with self._sense(f"/camera/{camera}/{kind}", time):
                    pictures[time] = ros_messages.image_data(message)
        for time, m in self._read(f"/camera/{camera}/info"):
            with self._sense(f"/camera/{camera}/info", time):
                intrinsics, pose = _vector(m["intrinsics"], 3, 3), _vector(m["world_T_cam"], 4, 4)
                size = int(m["width"]), int(m["height"])
            yield Picture(time, camera, intrinsics, pose, *size, colours.get(time), depths.get(time))

    def windows(self, camera: str) -> Iterator[tuple[float, bytes]]:
        """Time and PNG of each part of a picture that a skill looked at."""
        return self._images(f"/camera/{camera}/window")

    def film(self, camera: str) -> Iterator[tuple[float, bytes]]:
        """Time and JPEG of what the camera saw while nobody asked."""
        return self._images(f"/camera/{camera}/film")

    def _images(self, topic: str) -> Iterator[tuple[float, bytes]]:
        for time, message in self.messages.get(topic, ()):
            with self._sense(topic, time):
                data = ros_messages.image_data(message)
            yield time, data

    def points(self) -> Iterator[Points]:
        for time, message in self.messages.get("/points", ()):
            with self._sense("/points", time):
                xyz, rgb = ros_messages.cloud_points(message)
            yield Points(time, xyz, rgb)

    def _read(self, topic: str) -> Iterator[tuple[float, dict[str, Any]]]:
        for time, data in self.messages.get(topic, ()):
            yield time, _parse(self.path, topic, data)

    def _states(self, topic: str) -> Iterator[tuple[float, State]]:
        for time, m in self._read(topic):
            with self._sense(topic, time):
                state = State.from_json(m["objects"], self.types)
            yield time, state

    def _sense(self, topic: str, time: float) -> _Sense:
        return _Sense(f"{self.path}: the message of {topic} at {time:.3f} s makes no sense")


def _span(begin: str, end: str) -> str:
    if end == "inf":
        return f"after {begin} s"
    return f"at {begin} s" if begin == end else f"from {begin} to {end} s"


class _Sense:
    """Turns the errors of reading a strange message into one EpisodeError."""

    def __init__(self, what: str) -> None:
        self._what = what

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, KeyError | ValueError | TypeError | AttributeError | OverflowError | ResyncError):
            raise EpisodeError(f"{self._what}: {error}") from None


def _parse(path: Path, topic: str, data: bytes) -> dict[str, Any]:
    """The JSON in a String, or as it stood in the file up to format 3."""
    try:
        content = json.loads(ros_messages.text_data(data) if ros_messages.is_packed(data) else data)
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise EpisodeError(f"{path}: a message of {topic} is no JSON object")
    return content


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _vector(value: Any, *shape: int) -> np.ndarray:
    """An array of the given shape; null becomes NaN. Raises ValueError or TypeError."""
    return np.array(value, dtype=np.float64).reshape(shape)
