"""Whatever is done to a file of many chunks: all that was not touched comes back, nothing is made up, nothing fills."""

from __future__ import annotations

import io
import itertools
import random
import struct
import time
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from resync_robot.core import mcap_salvage, ros_messages
from resync_robot.core.mcap_file import read_whole, write_whole
from resync_robot.core.mcap_salvage import WholeRecords, salvage

SECOND = 10**9
CHUNKS = 40


def build(chunks: int = CHUNKS, compression: CompressionType = CompressionType.ZSTD) -> bytes:
    """A chunk a second of five messages; a new channel in every eighth chunk, as they come up in an episode."""
    rng, file = random.Random(3), io.BytesIO()
    writer = Writer(file, chunk_size=10**6, compression=compression)
    writer.start(profile="ros2", library="test")
    channels: list[int] = []
    for k in range(chunks):
        if k % 8 == 0:
            schema = writer.register_schema(f"s{k}", "jsonschema", b"{}" * 20)
            channels.append(writer.register_channel(f"/c{k}", "json", schema))
        for i in range(5):
            stamp = k * SECOND + i * SECOND // 5
            data = f"{k}/{i} ".encode() + rng.randbytes(rng.randrange(300))
            writer.add_message(channels[(k + i) % len(channels)], stamp, data, stamp)
        writer.flush()
    writer.finish()
    return file.getvalue()


def chunks_of(data: bytes) -> list[tuple[int, int]]:
    """Where each chunk begins and ends."""
    file = io.BytesIO(data)
    places, at = [], 8
    for record in StreamReader(file, emit_chunks=True).records:
        if isinstance(record, Chunk):
            places.append((at, file.tell()))
        at = file.tell()
    return places


def summary_of(data: bytes) -> bytes:
    """From behind the end of the data to the end of the footer's checksum."""
    start = struct.unpack_from("<Q", data, len(data) - 28)[0]
    return data[start:-8]


WHOLE = build()
PLACES = chunks_of(WHOLE)
SUMMARY = summary_of(WHOLE)


def messages(records: WholeRecords) -> list[bytes]:
    """Those of a channel that something names."""
    named = {r.id for r in records.records if isinstance(r, Channel)}
    return [r.data for r in records.records if isinstance(r, Message) and r.channel_id in named]


EACH = [messages(WholeRecords.of(mcap_salvage.salvage(WHOLE[: PLACES[k][1]]).records, None)) for k in range(CHUNKS)]
ALL = EACH[-1]


def of_chunk(k: int) -> list[bytes]:
    return EACH[k][len(EACH[k - 1]) if k else 0 :]


def untouched(damaged: bytes) -> list[int]:
    """The chunks whose bytes are all there, somewhere."""
    return [k for k, (a, b) in enumerate(PLACES) if WHOLE[a:b] in damaged]


def declared(damaged: bytes, kept: list[int]) -> bool:
    """Whether the name of every channel is still there."""
    return SUMMARY in damaged or all(k in kept for k in range(0, CHUNKS, 8))


def put(data: bytes, at: int, length: int, what: bytes) -> bytes:
    return data[:at] + what + data[at + length :]


places = st.integers(0, len(WHOLE) - 1)
starts = st.sampled_from([0, 8, *(x for place in PLACES for x in place), WHOLE.index(SUMMARY), len(WHOLE) - 37])
lengths = st.one_of(st.integers(1, 40), st.integers(1, 6000))


@st.composite
def damages(draw: st.DrawFn) -> bytes:
    """What falls upon files: blocks of nothing or of anything, lost, doubled or in a wrong place; flips; torn ends."""
    data = WHOLE
    for _ in range(draw(st.integers(1, 3))):
        if not data:
            break
        at = min(draw(st.one_of(places, starts)), len(data) - 1)
        length = min(draw(lengths), len(data) - at)
        match draw(st.sampled_from(["zeros", "random", "cut", "double", "copy", "length", "flip", "torn", "more"])):
            case "zeros":
                data = put(data, at, length, bytes(length))
            case "random":
                data = put(data, at, length, random.Random(draw(st.integers(0, 99))).randbytes(length))
            case "cut":
                data = put(data, at, length, b"")
            case "double":
                data = put(data, at, 0, data[at : at + length])
            case "copy":
                there = min(draw(places), len(data) - length)
                data = put(data, there, length, data[at : at + length])
            case "length":
                data = put(data, at, 9, data[at : at + 1] + struct.pack("<Q", draw(st.integers(0, 2**64 - 1))))
            case "flip":
                data = put(data, at, 1, bytes([data[at] ^ 1 << draw(st.integers(0, 7))]))
            case "torn":
                data = data[:at]
            case "more":
                data += random.Random(at).randbytes(length)
    return data


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scratch") / "damaged.mcap"


@given(damages())
@settings(max_examples=300, deadline=None)
def test_all_that_was_not_touched_comes_back(scratch: Path, damaged: bytes) -> None:
    scratch.write_bytes(damaged)
    found = read_whole(scratch)
    got = messages(found)
    kept = untouched(damaged)
    if declared(damaged, kept):
        wanted = [m for k in kept for m in of_chunk(k)]
        assert set(wanted) <= set(got), "something whole is lost"
        if SUMMARY in damaged:
            assert got == [m for m in ALL if m in set(got)], "out of order, or twice"
    assert set(got) <= set(ALL), "something was made up"
    assert len(set(got)) == len(got), "something came twice"
    if damaged != WHOLE:
        assert found.damage is not None or got == ALL
    if len(got) < len(ALL):
        assert found.damage
    lost = [k for k in range(CHUNKS) if not set(of_chunk(k)) <= set(got)]
    if SUMMARY in damaged and lost:
        assert all(any(told(span, k) for span in found.missing) for k in lost), "what is missing is not said"
    if not found.missing and found.damage and got:
        assert len(got) == len(ALL)


def told(span: mcap_salvage.Span, k: int) -> bool:
    begin, end = span
    return (begin is None or begin <= (k + 1) * SECOND) and (end is None or end >= k * SECOND)


def test_2000_zeros_in_the_middle_cost_the_chunks_they_hit() -> None:
    at = len(WHOLE) // 2
    damaged = put(WHOLE, at, 2000, bytes(2000))
    found = salvage(damaged)
    lost = sorted(set(range(CHUNKS)) - set(untouched(damaged)))
    assert 1 <= len(lost) <= 5
    assert messages(found) == [m for k in range(CHUNKS) if k not in lost for m in of_chunk(k)]
    assert found.missing == ((lost[0] * SECOND, lost[-1] * SECOND + 4 * SECOND // 5),)
    assert found.damage and f"with {len(ALL) - 5 * len(lost)} of {len(ALL)} messages" in found.damage
    assert messages(WholeRecords.of(found.records[: found.unbroken], None)) == EACH[lost[0] - 1]


def test_declarations_of_a_lost_chunk_come_from_the_summary() -> None:
    begin, end = PLACES[8]
    found = salvage(put(WHOLE, begin, end - begin, bytes(end - begin)))
    assert messages(found) == [m for k in range(CHUNKS) if k != 8 for m in of_chunk(k)]


def test_without_a_summary_what_nothing_names_is_counted() -> None:
    begin, end = PLACES[8]
    torn = put(WHOLE, begin, end - begin, bytes(end - begin))[: PLACES[-1][1]]
    found = salvage(torn)
    unnamed = sum(isinstance(r, Message) for r in found.records) - len(messages(found))
    assert unnamed > 0 and found.damage and f"what {unnamed} more are about is lost" in found.damage
    # From the last message before the damage to the first behind it, and from the last of all to the end.
    assert found.missing == ((7 * SECOND + 4 * SECOND // 5, 9 * SECOND), (39 * SECOND + 4 * SECOND // 5, None))


def test_a_chunk_that_is_gone_without_a_trace_is_missed(tmp_path: Path) -> None:
    begin, end = PLACES[20]
    (tmp_path / "cut.mcap").write_bytes(put(WHOLE, begin, end - begin, b""))
    found = read_whole(tmp_path / "cut.mcap")
    assert found.damage and found.missing == ((20 * SECOND, 20 * SECOND + 4 * SECOND // 5),)


def test_bytes_behind_the_end_and_none_at_all(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    path.write_bytes(WHOLE + b"12345")
    found = read_whole(path)
    assert found.damage == "5 bytes follow its end, and are left out"
    assert messages(found) == ALL and not found.missing and found.unbroken == len(found.records)
    path.write_bytes(b"")
    assert read_whole(path).damage == "it is empty"


def test_uncompressed_chunks_are_found_too() -> None:
    data = build(12, CompressionType.NONE)
    middle = chunks_of(data)[6]
    found = salvage(put(data, middle[0] + 60, 20, bytes(20)))
    assert found.missing == ((6 * SECOND, 6 * SECOND + 4 * SECOND // 5),) and len(messages(found)) == 55


@pytest.mark.parametrize("byte", [0, 6, 255])
def test_time_is_linear_and_memory_bounded(byte: int) -> None:
    size = 4 * 2**20
    # Everywhere a chunk of nearly all the rest, its lengths agreeing, its checksum wrong.
    head = struct.pack("<BQQQQII", 6, 40 + size // 2, 0, 0, size // 2, 1, 0) + struct.pack("<Q", size // 2)
    for data in (bytes([byte]) * size, head * (size // len(head))):
        tracemalloc.start()
        begin = time.process_time()
        salvage(data)
        spent = time.process_time() - begin
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert spent < 20.0 and peak < 8 * size, (spent, peak)


def test_a_length_of_gigabytes_reserves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    for at in itertools.chain(range(0, 60), range(PLACES[3][0], PLACES[3][0] + 60)):
        path.write_bytes(put(WHOLE, at, 8, struct.pack("<Q", 2**33)))
        tracemalloc.start()
        found = read_whole(path)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 2**24 and len(messages(found)) >= len(ALL) - 10


def test_what_is_left_is_written_for_every_reader(tmp_path: Path) -> None:
    found = salvage(put(WHOLE, PLACES[8][0], 500, bytes(500)))
    write_whole(found.records, tmp_path / "m.mcap")
    again = read_whole(tmp_path / "m.mcap")
    # What was JSON is a String of ROS 2 now.
    assert again.damage is None and messages(again) == [ros_messages.string(data) for data in messages(found)]
