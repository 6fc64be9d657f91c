"""MCAP files as they are found: whole, torn by a killed process, altered. What is whole of one, and a mended copy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap.records import Channel, Chunk, Footer, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

MAX_CHUNK_BYTES = 256 * 2**20
"""A chunk that claims to unpack to more is taken for damage; one picture is far below."""
CHUNK_BYTES = 128 * 1024


@dataclass(frozen=True)
class WholeRecords:
    """Attributes: `records` before the damage, in order; what the `damage` is, None for a whole file."""

    records: list[Schema | Channel | Message]
    damage: str | None


def read_whole(path: Path) -> WholeRecords:
    """Everything before the first damage; at most what had been written when the writer died. Raises OSError."""
    records: list[Schema | Channel | Message] = []
    why: str | None = "the file ends early"
    with path.open("rb") as file:
        size, at = path.stat().st_size, 0
        reader = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=size)
        try:
            for record in reader.records:
                inner = _unpack(record) if isinstance(record, Chunk) else [record]
                records += [r for r in inner if isinstance(r, Schema | Channel | Message)]
                at = file.tell()
                if isinstance(record, Footer):
                    why = None
        # The decoders are handed a file from anywhere and promise no list of exceptions; what they raise means
        # that the file is not whole from here on.
        except Exception as error:
            why = f"{type(error).__name__}: {error}"
    if why is None:
        return WholeRecords(records, None)
    count = sum(isinstance(r, Message) for r in records)
    return WholeRecords(records, f"{why}; {at} of {size} bytes are whole, with {count} messages")


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


def _unpack(chunk: Chunk) -> list[Schema | Channel | Message]:
    """Records of a chunk, refusing one that would fill the memory."""
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        size = max(size, zstandard.frame_content_size(chunk.data))
    if size > MAX_CHUNK_BYTES or chunk.compression not in ("zstd", ""):
        raise ValueError(f"a chunk of {size} bytes, compression '{chunk.compression}'")
    return breakup_chunk(chunk, validate_crc=True)
