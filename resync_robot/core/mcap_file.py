"""MCAP files as they are found: whole, torn by a killed process, altered. What is whole of one, and a mended copy."""

from __future__ import annotations

import errno
import stat
from pathlib import Path
from typing import BinaryIO, cast

from mcap.records import Channel, Chunk, Footer, Message, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from resync_robot.core import ros_messages
from resync_robot.core.mcap_salvage import WholeRecords, salvage, unpack
from resync_robot.core.ros_definitions import DEFINITIONS

__all__ = ["STRING", "WholeRecords", "begin_file", "offer", "read_whole", "write_whole"]
CHUNK_BYTES = 128 * 1024
STRING = "std_msgs/msg/String"
_FOREVER = "{sec: 9223372036, nsec: 854775807}"


def read_whole(path: Path) -> WholeRecords:
    """Everything in a file that is whole, around whatever is damaged. Raises OSError."""
    about = path.stat()
    if not (stat.S_ISREG(about.st_mode) or stat.S_ISDIR(about.st_mode)):
        raise OSError(errno.EINVAL, "it is no file")
    with path.open("rb") as file:
        if about.st_size == 0:
            return WholeRecords.of([], "it is empty")
        records = _read_all(file, about.st_size)
        if records is not None:
            behind = about.st_size - file.tell()
            return WholeRecords.of(records, f"{behind} bytes follow its end, and are left out" if behind else None)
        file.seek(0)
        return salvage(file.read())


class _Bounded:
    """Reads no more than there is; a plain file first sets aside what it is asked for, gigabytes by a flipped bit."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._left = file, size

    def read(self, length: int) -> bytes:
        data = self._file.read(min(length, self._left))
        self._left -= len(data)
        return data


def _read_all(file: BinaryIO, size: int) -> list[Schema | Channel | Message] | None:
    """The records of a whole file; None where anything is damaged, or other messages are in it than it counts."""
    records: list[Schema | Channel | Message] = []
    counted: int | None = None
    end = False
    try:
        reader = StreamReader(cast(BinaryIO, _Bounded(file, size)), emit_chunks=True, validate_crcs=True)
        for record in reader.records:
            inner = unpack(record) if isinstance(record, Chunk) else [record]
            records += [r for r in inner if isinstance(r, Schema | Channel | Message)]
            if isinstance(record, Statistics):
                counted = record.message_count
            end = isinstance(record, Footer)
    # The decoders are handed a file from anywhere and promise no list of exceptions; what they raise means that the
    # file is not whole.
    except Exception:
        return None
    count = sum(isinstance(r, Message) for r in records)
    return records if end and counted in (None, count) else None


def begin_file(file: BinaryIO, profile: str = "ros2") -> Writer:
    """A writer of a recording. The profile promises that every message is one of ROS 2."""
    writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
    writer.start(profile=profile, library="resync-robot")
    # By this rosbag2, from Jazzy on, knows that the channels offer their quality of service in numbers, as the versions
    # before need it.
    writer.add_metadata("rosbag2", {"serialized_metadata": ""})
    return writer


def offer(latched: bool = False) -> dict[str, str]:
    """What the profile asks to be said of a channel: its quality of service. Who comes late still gets the last message
    of one that is latched."""
    depth, durability = (1, 1) if latched else (10, 2)
    profile = (
        f"- history: 1\n  depth: {depth}\n  reliability: 1\n  durability: {durability}\n"
        f"  deadline: {_FOREVER}\n  lifespan: {_FOREVER}\n  liveliness: 1\n"
        f"  liveliness_lease_duration: {_FOREVER}\n  avoid_ros_namespace_conventions: false"
    )
    return {"offered_qos_profiles": profile}


def write_whole(records: list[Schema | Channel | Message], path: Path) -> None:
    """A file that every reader takes, of ROS 2 too: messages in JSON, as recordings up to format 3 have them, become
    Strings. Records of schemas or channels that nobody declared are left out.

    Raises:
        OSError: it cannot be written, FileExistsError where there is one already. Nothing half written is left behind.
    """
    with path.open("xb") as file:
        try:
            _write(records, file)
        except BaseException:
            path.unlink(missing_ok=True)
            raise


def _write(records: list[Schema | Channel | Message], file: BinaryIO) -> None:
    foreign = any(isinstance(r, Channel) and r.message_encoding not in ("cdr", "json") for r in records)
    writer = begin_file(file, "" if foreign else "ros2")
    schemas, channels, texts = {0: 0}, dict[int, int](), set[int]()
    string = writer.register_schema(STRING, "ros2msg", DEFINITIONS[STRING].encode())
    for r in records:
        if isinstance(r, Schema):
            if r.id not in schemas:
                schemas[r.id] = writer.register_schema(r.name, r.encoding, r.data)
        elif isinstance(r, Channel):
            if r.id not in channels and r.schema_id in schemas:
                text = r.message_encoding == "json"
                texts.update({r.id} if text else ())
                schema, encoding = (string, "cdr") if text else (schemas[r.schema_id], r.message_encoding)
                channels[r.id] = writer.register_channel(r.topic, encoding, schema, {**offer(), **r.metadata})
        elif r.channel_id in channels:
            data = ros_messages.string(r.data) if r.channel_id in texts else r.data
            writer.add_message(channels[r.channel_id], r.log_time, data, r.publish_time, r.sequence)
    writer.finish()
