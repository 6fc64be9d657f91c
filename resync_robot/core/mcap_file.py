"""MCAP files as they are found: whole, torn by a killed process, altered. What is whole of one, and a mended copy."""

from __future__ import annotations

import errno
import stat
from pathlib import Path
from typing import BinaryIO, cast

from mcap.records import Channel, Chunk, Footer, Message, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from resync_robot.core.mcap_salvage import WholeRecords, salvage, unpack

__all__ = ["CHUNK_BYTES", "WholeRecords", "read_whole", "write_whole"]
CHUNK_BYTES = 128 * 1024


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


def write_whole(records: list[Schema | Channel | Message], path: Path) -> None:
    """A file that every reader takes; records of schemas or channels that nobody declared are left out.

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
    writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
    writer.start(profile="ros2", library="resync-robot")
    schemas, channels = {0: 0}, dict[int, int]()
    for r in records:
        if isinstance(r, Schema):
            if r.id not in schemas:
                schemas[r.id] = writer.register_schema(r.name, r.encoding, r.data)
        elif isinstance(r, Channel):
            if r.id not in channels and r.schema_id in schemas:
                schema = schemas[r.schema_id]
                channels[r.id] = writer.register_channel(r.topic, r.message_encoding, schema, r.metadata)
        elif r.channel_id in channels:
            writer.add_message(channels[r.channel_id], r.log_time, r.data, r.publish_time, r.sequence)
    writer.finish()
