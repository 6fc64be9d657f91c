"""A copy of what is whole of a file: taken by every reader, whatever the file says, or not there at all."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema

from resync_robot.core import mcap_file, ros_messages
from resync_robot.core.mcap_file import read_whole, write_whole


def schema(number: int) -> Schema:
    return Schema(id=number, data=b"{}", encoding="jsonschema", name=f"s{number}")


def channel(number: int, schema_number: int) -> Channel:
    return Channel(id=number, topic=f"/c{number}", message_encoding="json", metadata={}, schema_id=schema_number)


def message(channel_number: int, data: bytes) -> Message:
    return Message(channel_id=channel_number, log_time=5, data=data, publish_time=5, sequence=0)


ALTERED = [
    schema(1), channel(1, 1), message(1, b"one"),
    # As every chunk of a file without a summary may repeat them.
    schema(1), channel(1, 1), message(1, b"two"),
    message(2, b"of a channel that comes later"), channel(2, 0), message(2, b"three"),
    channel(3, 9), message(3, b"of a channel of no schema"), message(7, b"of no channel"),
]  # fmt: skip


def test_records_of_what_nobody_declared_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "whole.mcap"
    write_whole(ALTERED, path)
    with path.open("rb") as file:
        reader = make_reader(file)
        seen = [(c.topic, ros_messages.text_data(m.data)) for _, c, m in reader.iter_messages()]
        summary = reader.get_summary()
    assert seen == [("/c1", b"one"), ("/c1", b"two"), ("/c2", b"three")]
    assert summary is not None and {c.message_encoding for c in summary.channels.values()} == {"cdr"}
    assert read_whole(path).damage is None


def test_the_profile_promises_no_more_than_the_file_keeps(tmp_path: Path) -> None:
    strange = Channel(id=4, topic="/c4", message_encoding="protobuf", metadata={"a": "b"}, schema_id=0)
    for name, records in (("ours", ALTERED), ("strange", [*ALTERED, strange, message(4, b"four")])):
        write_whole(records, tmp_path / name)
        with (tmp_path / name).open("rb") as file:
            reader = make_reader(file)
            summary = reader.get_summary()
            assert reader.get_header().profile == ("ros2" if name == "ours" else "")
            assert [m.name for m in reader.iter_metadata()] == ["rosbag2"]
        assert summary is not None
        assert all("durability: 2" in c.metadata["offered_qos_profiles"] for c in summary.channels.values())
    assert {c.metadata.get("a") for c in summary.channels.values()} == {None, "b"}


def test_what_cannot_be_written_is_not_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*args: object) -> None:
        raise OSError(28, "No space left on device")

    path, other = tmp_path / "whole.mcap", tmp_path / "other.mcap"
    monkeypatch.setattr(mcap_file.Writer, "finish", full)
    with pytest.raises(OSError, match="No space"):
        write_whole(ALTERED, path)
    other.write_bytes(b"mine")
    with pytest.raises(FileExistsError):
        write_whole(ALTERED, other)
    assert [p.name for p in tmp_path.iterdir()] == ["other.mcap"] and other.read_bytes() == b"mine"
