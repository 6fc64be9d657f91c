"""What is left of a damaged MCAP file: every chunk whose checksum is right, wherever in the file it lies now.

A chunk can be told without the records around it: its two lengths agree, and its content has a checksum. The summary at
the end of a whole file lists all chunks and has a checksum, too; where that is right, it gives their order, what is
missing, and the declarations that a lost chunk held.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from itertools import islice
from typing import Any

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC as MAGIC

MAX_CHUNK_BYTES = 256 * 2**20
"""A chunk that claims to unpack to more is taken for damage; one picture is far below."""
WASTE = 100
"""Times the size of the file (beside one largest chunk) that may be unpacked in vain; chunks never pack so tightly, and
a file that was made to waste more is not looked through further."""
SMALLEST_CHUNK = 64
"""Bytes; less damage than this cannot have hit a chunk as a whole."""
CLOSE = 500_000_000
"""ns between two things that are missing, below which they are told as one."""
TRIED = 4
"""Places that are tried for the end of a file, and for the begin of its summary."""

Content = Schema | Channel | Message

_HEAD = 9
"""Bytes of an opcode and a length."""
# An opcode, a length below 2**40, times, size and checksum, a compression that this program knows.
_CHUNK = re.compile(rb"\x06(?=.{5}\x00{3}.{28}(?:\x00{4}|\x04\x00{3}zstd))", re.DOTALL)
# Opcode and length, where the summary begins and its offsets, its checksum.
_FOOTER = re.compile(re.escape(struct.pack("<BQ", Opcode.FOOTER, 20)) + rb".{16}(.{4})", re.DOTALL)
_DATA_END = struct.pack("<BQ", Opcode.DATA_END, 4)
_READERS: dict[int, Any] = {
    Opcode.HEADER: Header.read, Opcode.FOOTER: Footer.read, Opcode.SCHEMA: Schema.read, Opcode.CHANNEL: Channel.read,
    Opcode.MESSAGE_INDEX: MessageIndex.read, Opcode.CHUNK_INDEX: ChunkIndex.read, Opcode.ATTACHMENT: Attachment.read,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex.read, Opcode.STATISTICS: Statistics.read, Opcode.METADATA: Metadata.read,
    Opcode.METADATA_INDEX: MetadataIndex.read, Opcode.SUMMARY_OFFSET: SummaryOffset.read, Opcode.DATA_END: DataEnd.read,
}  # fmt: skip


_Key = tuple[int, int, int, int]
"""What an index says of a chunk: first and last log time in ns, bytes packed and unpacked."""
Span = tuple[int | None, int | None]
"""Log times in ns, from and to; None is the begin or the end of the file."""


@dataclass(frozen=True)
class WholeRecords:
    """What is whole of a file.

    Attributes:
        records: in order.
        damage: what is wrong, None for a whole file.
        missing: log times of what is lost, rising; empty where all is there.
        unbroken: how many of the records come before the first that is lost.
    """

    records: list[Content]
    damage: str | None
    missing: tuple[Span, ...] = ()
    unbroken: int = 0

    @staticmethod
    def of(records: list[Content], damage: str | None) -> WholeRecords:
        """With nothing missing between them."""
        return WholeRecords(records, damage, (), len(records))


@dataclass(frozen=True)
class _Found:
    """A chunk that is whole: its place in the file, its records, the log times of its messages in ns."""

    begin: int
    end: int
    records: list[Content]
    times: list[int]
    key: _Key


@dataclass(frozen=True)
class _Summary:
    """What the end of the file says, where its checksum is right. `keys` are those of all chunks, in order."""

    declarations: list[Content]
    keys: list[_Key]
    messages: int | None


def salvage(data: bytes) -> WholeRecords:
    """Whatever is whole of a damaged file. Takes time in proportion to its size, and never raises."""
    found = list(_chunks(data))
    if not found:
        return _loose(data)
    summary = _summary(data)
    if summary is None:
        kept, holes = _by_place(data, found)
        records: list[Content] = []
    else:
        kept, holes = _by_index(found, summary.keys)
        records = list(summary.declarations)
    unbroken = None
    for i, chunk in enumerate(kept):
        if i in holes and unbroken is None:
            unbroken = len(records)
        records += chunk.records
    if unbroken is None:
        unbroken = len(records)
    named = {r.id for r in records if isinstance(r, Channel)}
    channels = [r.channel_id for r in records if isinstance(r, Message)]
    count = sum(channel in named for channel in channels)
    total = "" if summary is None or summary.messages is None else f" of {summary.messages}"
    size = sum(chunk.end - chunk.begin for chunk in kept)
    damage = f"{_what(data, found[-1].end)}; {size} of {len(data)} bytes are whole, with {count}{total} messages"
    if count < len(channels):
        damage += f"; what {len(channels) - count} more are about is lost with what was damaged"
    return WholeRecords(records, damage, _merged(span for spans in holes.values() for span in spans), unbroken)


def unpack(chunk: Chunk) -> list[Content]:
    """Records of a chunk. Raises ValueError, among others, for damage, and for a chunk that would fill the memory."""
    if not _plausible(chunk):
        raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes, compression '{chunk.compression}'")
    return [r for r in breakup_chunk(chunk, validate_crc=True) if isinstance(r, Schema | Channel | Message)]


def _plausible(chunk: Chunk) -> bool:
    """Its content does not claim another size than the chunk, so that unpacking it takes no more memory than that."""
    if chunk.uncompressed_size > MAX_CHUNK_BYTES or chunk.compression not in ("zstd", ""):
        return False
    if not chunk.compression:
        return len(chunk.data) == chunk.uncompressed_size
    try:
        return zstandard.frame_content_size(chunk.data) in (chunk.uncompressed_size, -1)
    except zstandard.ZstdError:
        return False


def _chunks(data: bytes) -> Iterator[_Found]:
    """Every whole chunk, in the order of the file."""
    at, waste = 0, MAX_CHUNK_BYTES + WASTE * len(data)
    while waste >= 0 and (match := _CHUNK.search(data, at)):
        at = match.start() + 1
        chunk = _chunk_at(data, match.start())
        if chunk is None or not _plausible(chunk):
            continue
        # The decoders promise no list of exceptions for content that is damaged.
        try:
            records = unpack(chunk)
        except Exception:
            waste -= len(chunk.data) + chunk.uncompressed_size
            continue
        end = match.start() + _HEAD + 40 + len(chunk.compression) + len(chunk.data)
        times = [r.log_time for r in records if isinstance(r, Message)]
        key = min(times, default=0), max(times, default=0), len(chunk.data), chunk.uncompressed_size
        yield _Found(match.start(), end, records, times, key)
        at = end


def _chunk_at(data: bytes, at: int) -> Chunk | None:
    """What claims to be a chunk there, where its lengths agree and it ends within the file."""
    length, begin, end, size, crc, name = struct.unpack_from("<QQQQII", data, at + 1)
    body = at + _HEAD + 40 + name
    if body > len(data) or at + _HEAD + length > len(data):
        return None
    (stored,) = struct.unpack_from("<Q", data, body - 8)
    if length != 40 + name + stored:
        return None
    # Not copied: each of many false begins may claim all the rest of the file.
    return Chunk(
        compression="zstd" if name else "", data=memoryview(data)[body : body + stored], message_start_time=begin,
        message_end_time=end, uncompressed_crc=crc, uncompressed_size=size,
    )  # fmt: skip


def _by_index(found: list[_Found], keys: list[_Key]) -> tuple[list[_Found], dict[int, list[Span]]]:
    """The chunks in the order of the index, each once; times of those that are missing, by the next one's number."""
    places: dict[_Key, list[int]] = {}
    for place in reversed(range(len(keys))):
        places.setdefault(keys[place], []).append(place)
    kept = {places[chunk.key].pop(): chunk for chunk in found if places.get(chunk.key)}
    holes: dict[int, list[Span]] = {}
    number = 0
    for place, (begin, end, *_) in enumerate(keys):
        if place in kept:
            number += 1
        else:
            holes.setdefault(number, []).append((begin, end))
    return [kept[place] for place in sorted(kept)], holes


def _by_place(data: bytes, found: list[_Found]) -> tuple[list[_Found], dict[int, list[Span]]]:
    """The same without an index: in the order of the file; missing is what damaged bytes between them may have held."""
    kept: dict[bytes, _Found] = {}
    holes: dict[int, list[Span]] = {}
    at, latest = 0, None
    for chunk in found:
        if chunk.begin - at >= SMALLEST_CHUNK and _walk(data, at, chunk.begin)[1] != chunk.begin:
            # A picture may be written some time after it was taken: the next is what was taken later than all before.
            later = [t for t in chunk.times if latest is None or t >= latest]
            holes.setdefault(len(kept), []).append((latest, min(later, default=latest)))
        kept.setdefault(data[chunk.begin : chunk.end], chunk)
        at, latest = chunk.end, max([*chunk.times, *([] if latest is None else [latest])], default=None)
    if not _walk(data, at, len(data))[2]:
        holes.setdefault(len(kept), []).append((latest, None))
    return list(kept.values()), holes


def _merged(spans: Iterable[Span]) -> tuple[Span, ...]:
    """Rising, those that meet within CLOSE as one."""
    merged: list[Span] = []
    for begin, end in sorted(spans, key=lambda span: -1 if span[0] is None else span[0]):
        if merged and (merged[-1][1] is None or (begin or 0) <= merged[-1][1] + CLOSE):
            last = merged.pop()
            begin, end = last[0], None if last[1] is None or end is None else max(last[1], end)
        merged.append((begin, end))
    return tuple(merged)


def _loose(data: bytes) -> WholeRecords:
    """Of a file without chunks, what comes before the first damage."""
    records, at, _ = _walk(data, 0, len(data))
    times = [r.log_time for r in records if isinstance(r, Message)]
    damage = f"{_what(data, at)}; {at} of {len(data)} bytes are whole, with {len(times)} messages"
    return WholeRecords(records, damage, ((max(times, default=None), None),), len(records))


def _what(data: bytes, at: int) -> str:
    """In words, what is wrong with a file in which nothing is whole after `at`."""
    if not data.startswith(MAGIC):
        return "it does not begin as an MCAP file does"
    if _walk(data, at, len(data))[2]:
        return "it is damaged"
    return "the file ends early" if data.find(MAGIC, at) < 0 else "its end is damaged"


def _walk(data: bytes, at: int, end: int) -> tuple[list[Content], int, bool]:
    """The records from one place on, but for chunks; where they end, and whether the file does there, as it should."""
    records: list[Content] = []
    if at == 0 and data.startswith(MAGIC):
        at = len(MAGIC)
    while end - at >= _HEAD:
        opcode, length = struct.unpack_from("<BQ", data, at)
        if length > end - at - _HEAD:
            break
        stream = ReadDataStream(BytesIO(data[at + _HEAD : at + _HEAD + length]))
        try:
            record = Message.read(stream, length) if opcode == Opcode.MESSAGE else _READERS[opcode](stream)
        except Exception:
            break
        if stream.count != length:
            break
        at += _HEAD + length
        if isinstance(record, Schema | Channel | Message):
            records.append(record)
        elif isinstance(record, Footer):
            return records, at, data[at : at + len(MAGIC)] == MAGIC
    return records, at, False


def _summary(data: bytes) -> _Summary | None:
    """The first summary whose checksum is right; bytes that were lost or added before it do not matter."""
    for footer in islice(_FOOTER.finditer(data), TRIED):
        crc, begin = int.from_bytes(footer[1], "little"), footer.start()
        for _ in range(TRIED if crc else 0):
            begin = data.rfind(_DATA_END, 0, begin)
            start = begin + _HEAD + 4
            if begin >= 0 and zlib.crc32(data[start : footer.start(1)]) == crc:
                return _read_summary(data[start : footer.start()])
    return None


def _read_summary(data: bytes) -> _Summary | None:
    declarations: list[Content] = []
    keys: list[_Key] = []
    messages, at = None, 0
    # A right checksum is no promise that whoever wrote it kept to the format.
    with suppress(Exception):
        while at < len(data):
            opcode, length = struct.unpack_from("<BQ", data, at)
            stream = ReadDataStream(BytesIO(data[at + _HEAD : at + _HEAD + length]))
            record = _READERS[opcode](stream)
            if isinstance(record, Schema | Channel):
                declarations.append(record)
            elif isinstance(record, ChunkIndex):
                times = record.message_start_time, record.message_end_time
                keys.append((*times, record.compressed_size, record.uncompressed_size))
            elif isinstance(record, Statistics):
                messages = record.message_count
            at += _HEAD + length
        return _Summary(declarations, keys, messages) if keys else None
    return None
