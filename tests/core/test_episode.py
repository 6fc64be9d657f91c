"""What is written is read back; what is torn or foreign is an EpisodeError or a prefix, never another exception."""

from __future__ import annotations

import json
import struct
from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from resync_robot.core.episode import FORMAT, mend_episode, read_episode
from resync_robot.core.episode_records import Answer, Ask, EpisodeMeta, EventKind, Timing
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.errors import EpisodeError
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.symbols import SE2, Type
from resync_robot.core.vocabulary import BLOCK
from tests.core.recorded import SIX, block_state, meta, write

VIEWED = (
    "/robot_description", "/tf_static", "/joint_states", "/joint_commands", "/tf", "/wrench", "/plan_text",
    "/atoms_text", "/rosout", "/latency", "/belief_markers", "/truth_markers", "/camera/wrist/camera_info",
    "/camera/wrist/colour", "/camera/wrist/depth", "/camera/wrist/depth_mm", "/camera/wrist/window",
    "/camera/wrist/film", "/points",
)  # fmt: skip
"""The channels for viewers."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "episode.mcap"
    write(path)
    return path.read_bytes()


@pytest.fixture(scope="module")
def scratch(tmp_path_factory):
    return tmp_path_factory.mktemp("scratch") / "torn.mcap"


def test_round_trip(tmp_path):
    path = tmp_path / "new" / "folder" / "e.mcap"
    write(path)
    episode = read_episode(path)
    assert episode.damage is None and episode.meta == meta() and episode.cameras == ("wrist",)
    assert episode.duration == pytest.approx(2.98)
    joints = list(episode.joints())
    assert len(joints) == 150
    np.testing.assert_array_equal(joints[7].measured, SIX * 7 + 0.01)
    np.testing.assert_array_equal(joints[7].sent.arm, SIX * 7)
    assert (joints[7].time, joints[7].opening, joints[7].requested.opening) == (0.14, 0.09, 0.1)
    forces = list(episode.tip_force())
    np.testing.assert_array_equal(forces[9][1], [0, 1, 9])
    (t, state), *_ = list(episode.states())[1:]
    assert t == 1.0 and state == block_state(1.0)
    np.testing.assert_allclose(state.covariance(BLOCK("b0")), np.eye(10) * 1e-6)
    assert list(episode.truths())[2][1] == block_state(2.001)
    assert next(iter(episode.atoms())) == (0.0, {"On(b0, b1)": 0.25, "HandEmpty(r)": 1.0})
    plan = list(episode.plans())[1]
    assert plan.steps == ("Pick(r, b0)", "Insert(r, b0, b1)") and (plan.current, plan.reason) == (1, "first")
    event = next(iter(episode.events()))
    assert (event.kind, event.text, event.details) == (EventKind.SCAN, "looked", {"pose": [[1.0, 0.0], [0.0, 1.0]]})
    picture = list(episode.pictures("wrist"))[2]
    assert (picture.time, picture.width, picture.height, picture.depth) == (2.0, 6, 4, b"png")
    assert picture.colour is not None and len(picture.colour) == 3000
    np.testing.assert_array_equal(picture.intrinsics, np.eye(3) * 2)
    assert list(episode.film("wrist"))[1] == (1.0, b"\xff\xd8jpeg")
    assert list(episode.timings())[1] == Timing(0.92, 0.99, 1.0, 0.002)
    cloud = next(iter(episode.points()))
    assert cloud.xyz.shape == (200, 3) and cloud.xyz.dtype == np.float32 and (cloud.rgb == [7, 8, 9]).all()


def test_what_the_executive_was_told_keeps_every_bit_and_the_robots_own_clock(tmp_path):
    told = [
        Answer(Ask.MEASURE, 1000.1 + 1 / 3, JointTarget(SIX / 3, 0.1 / 3), {"arm": list(SIX / 7), "opening": 0.1}),
        Answer(Ask.REST, 1001.0, JointTarget(SIX, 0.0), {}),
    ]
    with EpisodeWriter(tmp_path / "e.mcap", meta(), 1000.0) as writer:
        for answer in told:
            writer.answer(answer)
    read = list(read_episode(tmp_path / "e.mcap").answers())
    assert [time for time, _ in read] == pytest.approx([0.1 + 1 / 3, 1.0], abs=1e-9)
    for (_, again), then in zip(read, told, strict=True):
        assert (again.ask, again.clock, again.details) == (then.ask, then.clock, then.details)
        np.testing.assert_array_equal(again.target.arm, then.target.arm)
        assert again.target.opening == then.target.opening


def test_a_recording_counts_from_its_beginning_whatever_the_robots_clock_says(whole, tmp_path):
    # Three days after the controller was switched on; the picture of the first target was exposed before that.
    (tmp_path / "at-0.mcap").write_bytes(whole)
    write(tmp_path / "later.mcap", begin=262_144.0)
    first, later = (read_episode(tmp_path / name).messages for name in ("at-0.mcap", "later.mcap"))
    assert first.keys() == later.keys()
    assert {"/tf", "/wrench", "/rosout", "/camera/wrist/window", "/points", "/latency"} < first.keys()
    for topic in first.keys() - {"/timing", "/latency"}:
        assert first[topic] == later[topic], topic
    timings = [list(read_episode(tmp_path / name).timings()) for name in ("at-0.mcap", "later.mcap")]
    for one, other in zip(*timings, strict=True):
        assert astuple(one) == pytest.approx(astuple(other), abs=1e-9)
    assert timings[1][0].picture == 0.0 and timings[1][1].picture == pytest.approx(0.92)


def test_the_rig_is_in_the_recording():
    rig = load_rig()
    assert "where" not in meta().rig, "where its file lies differs from machine to machine"
    recorded = json.loads(json.dumps(meta().rig))
    np.testing.assert_array_equal(recorded["arm"]["world_T_base"], rig.arm.world_T_base)
    assert recorded["cameras"][0]["fx"] == rig.cameras[0].fx


def test_messages_are_standard_mcap_with_schemas(tmp_path):
    path = tmp_path / "e.mcap"
    write(path, 1.0)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    channels = {c.topic: c for c in summary.channels.values()}
    assert set(channels) == {
        "/meta", "/joints", "/tip_force", "/state", "/truth", "/atoms", "/plan", "/event",
        "/timing", "/camera/wrist/info", *VIEWED,
    }  # fmt: skip
    assert "measured" in json.loads(channels["/joints"].metadata["json_schema"])["required"]
    assert {topic for topic, c in channels.items() if "json_schema" in c.metadata} == channels.keys() - set(VIEWED)
    assert {channel.message_encoding for channel in channels.values()} == {"cdr"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}


def test_the_file_has_the_date_and_the_episode_counts_from_zero(tmp_path):
    dated = replace(meta(), began="2025-11-28T10:11:12.123456+00:00")
    with EpisodeWriter(tmp_path / "e.mcap", dated, begin=77.0) as writer:
        writer.tip_force(77.25, np.zeros(3))
    episode = read_episode(tmp_path / "e.mcap")
    assert episode.meta == dated and [t for t, _ in episode.tip_force()] == [0.25]
    stamp = 1_764_324_672_123_456_000 + 250_000_000
    with (tmp_path / "e.mcap").open("rb") as file:
        logged = {c.topic: m for _, c, m in make_reader(file).iter_messages(["/tip_force", "/wrench"])}
    assert {m.log_time for m in logged.values()} == {stamp}
    seconds, nanoseconds = struct.unpack_from("<iI", logged["/wrench"].data, 4)
    assert seconds * 10**9 + nanoseconds == stamp, "as in the header of the message"
    mend_episode(tmp_path / "e.mcap", tmp_path / "mended.mcap")
    assert read_episode(tmp_path / "mended.mcap").messages == episode.messages


@pytest.mark.parametrize("began", ["yesterday", "2025-11-28T10:11:12", None, 3, []])
def test_a_recording_with_a_date_that_is_none_is_refused(tmp_path, began):
    raw_episode(tmp_path / "e.mcap", "/x", b"", {"format": FORMAT, **vars(replace(meta(), began=began))})
    with pytest.raises(EpisodeError, match="no date"):
        read_episode(tmp_path / "e.mcap")


def test_a_recording_made_before_there_were_dates_is_read(tmp_path):
    old = {k: v for k, v in vars(meta()).items() if k != "began"}
    raw_episode(tmp_path / "e.mcap", "/tip_force", b'{"force": [1, 2, 3]}', {"format": 2, **old})
    episode = read_episode(tmp_path / "e.mcap")
    assert episode.meta == meta() and [t for t, _ in episode.tip_force()] == [0.0]


def test_a_damaged_start_does_not_cost_the_recording(whole, scratch):
    scratch.write_bytes(bytes(3000) + whole[3000:])
    episode = read_episode(scratch)
    assert episode.meta == meta() and episode.damage is not None and "does not begin as an MCAP" in episode.damage
    assert len(list(episode.joints())) >= 140
    ((begin, end),) = episode.missing
    assert begin == 0.0 and end < 0.5 and "something is missing " in episode.loss
    nothing = read_episode(scratch, unbroken=True)
    assert nothing.meta == meta() and not nothing.messages and nothing.duration == 0.0


def test_what_comes_before_the_first_hole_can_be_had_alone(whole, scratch):
    middle = whole.index(b"zstd", len(whole) // 2)
    scratch.write_bytes(whole[:middle] + bytes(500) + whole[middle + 500 :])
    every, unbroken = read_episode(scratch), read_episode(scratch, unbroken=True)
    times = [j.time for j in unbroken.joints()]
    np.testing.assert_allclose(times, np.arange(len(times)) * 0.02)
    assert 0.5 < times[-1] < 2.5 and max(j.time for j in every.joints()) == pytest.approx(2.98)
    assert unbroken.missing == every.missing != ()


def test_an_empty_file_and_bytes_behind_the_end_are_told_as_such(whole, scratch):
    scratch.write_bytes(b"")
    with pytest.raises(EpisodeError, match="is no recording: it is empty"):
        read_episode(scratch)
    scratch.write_bytes(whole + b"123")
    episode = read_episode(scratch)
    assert episode.loss == "3 bytes follow its end, and are left out; no message is missing"
    assert len(list(episode.joints())) == 150


def test_not_a_number_survives(tmp_path):
    path = tmp_path / "e.mcap"
    with EpisodeWriter(path, meta()) as writer:
        writer.tip_force(0.0, np.array([np.nan, np.inf, 1.0]))
    (_, force), *_ = read_episode(path).tip_force()
    np.testing.assert_array_equal(force, [np.nan, np.nan, 1.0])


@given(share=st.floats(0, 1))
@settings(max_examples=120, deadline=None)
def test_a_file_cut_anywhere_gives_a_prefix_or_an_error(whole, scratch, share):
    cut = int(share * (len(whole) - 1))
    scratch.write_bytes(whole[:cut])
    try:
        episode = read_episode(scratch)
    except EpisodeError:
        assert cut < 6000, "only the start, before /meta is whole, may be refused"
        return
    assert episode.damage is not None
    times = [j.time for j in episode.joints()]
    np.testing.assert_allclose(times, np.arange(len(times)) * 0.02)
    for read in (episode.states, episode.atoms, episode.plans, episode.events, episode.points, episode.tip_force):
        list(read())
    list(episode.pictures("wrist"))


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_a_file_altered_anywhere_gives_a_prefix_or_an_error(whole, scratch, data):
    altered = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        altered[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    scratch.write_bytes(bytes(altered))
    try:
        episode = read_episode(scratch)
        for read in (episode.joints, episode.states, episode.atoms, episode.plans, episode.events, episode.points):
            list(read())
        list(episode.pictures("wrist"))
    except EpisodeError:
        pass


@given(st.binary(max_size=300))
@settings(max_examples=100, deadline=None)
def test_any_other_file_is_refused(scratch, content):
    scratch.write_bytes(content)
    with pytest.raises(EpisodeError, match="no recording"):
        read_episode(scratch)


def raw_episode(path, topic: str, message: bytes, record_meta: dict | None = None) -> None:
    from mcap.writer import Writer

    content = {"format": FORMAT, **{k: getattr(meta(), k) for k in meta().__dataclass_fields__}}
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for name, data in (("/meta", json.dumps(record_meta or content).encode()), (topic, message)):
            writer.add_message(writer.register_channel(name, "json", 0), log_time=0, data=data, publish_time=0)
        writer.finish()


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        ("/joints", b"not json"),
        ("/joints", b"[]"),
        ("/joints", b'{"measured": [1, 2]}'),
        ("/joints", b'{"measured": "x", "velocity": {}, "opening": [], "sent": 1}'),
        ("/state", b'{"objects": {"b0": {"type": "sofa", "features": []}}}'),
        ("/state", b'{"objects": {"b0": {"type": "block", "features": [1]}}}'),
        ("/state", b'{"objects": 3}'),
        ("/atoms", b'{"atoms": {"On": "often"}}'),
        ("/plan", b'{"steps": 3, "current": 1, "reason": ""}'),
        ("/plan", b'{"steps": [], "current": 1e999, "reason": ""}'),
        ("/event", b'{"kind": "party", "text": "", "details": {}}'),
        ("/event", b"[" * 100_000),
        ("/camera/a/info", b'{"intrinsics": [[1]]}'),
        ("/camera/a/colour", b"a plain JPEG"),
        ("/camera/a/colour", b"\x00\x01\x00\x00" + b"\xff" * 30),
        ("/timing", b'{"picture": null}'),
        ("/answer", b'{"ask": "GUESS", "clock": 1, "target": [1, 2, 3, 4, 5, 6], "target_opening": 0, "details": {}}'),
        ("/answer", b'{"ask": "REST", "clock": 1, "target": [1], "target_opening": 0, "details": {}}'),
        ("/camera/a/film", b"a plain JPEG"),
        ("/points", b"1234567"),
        ("/points", b"\x00\x01\x00\x00" + bytes(40)),
    ],
)
def test_a_senseless_message_is_an_error_that_names_its_channel(tmp_path, topic, message):
    path = tmp_path / "e.mcap"
    raw_episode(path, topic, message)
    episode = read_episode(path)
    readers = {
        "/joints": episode.joints, "/state": episode.states, "/atoms": episode.atoms, "/plan": episode.plans,
        "/event": episode.events, "/timing": episode.timings, "/points": episode.points, "/answer": episode.answers,
        "/camera/a/film": lambda: episode.film("a"),
    }  # fmt: skip
    read = readers.get(topic, lambda: episode.pictures("a"))
    with pytest.raises(EpisodeError, match=topic):
        list(read())


@pytest.mark.parametrize("content", [{"format": 1}, {"format": FORMAT}, {"format": FORMAT, "strange": 3}])
def test_meta_of_another_format_is_refused(tmp_path, content):
    raw_episode(tmp_path / "e.mcap", "/x", b"", content)
    with pytest.raises(EpisodeError):
        read_episode(tmp_path / "e.mcap")


def test_a_recording_has_the_types_of_its_objects(tmp_path):
    sofa = Type("sofa", ("x", "y", "theta", "seats"), pose=SE2)
    state = State({sofa("s"): np.array([1.0, 2.0, 0.5, 3.0])})
    ours = EpisodeMeta(
        rig_hash="", rig={}, library_hash="", domain="home", scenario="tv", goal="", seed=0, backend="sim",
        types={"sofa": sofa.to_json()},
    )  # fmt: skip
    with EpisodeWriter(tmp_path / "e.mcap", ours) as writer:
        writer.truth(0.0, state)
        writer.film("scene", 0.5, b"\xff\xd8jpeg")
    episode = read_episode(tmp_path / "e.mcap")
    assert episode.meta == ours and episode.types["sofa"].pose == SE2
    assert list(episode.truths()) == [(0.0, state)]
    # No robot is described, and the bag is whole all the same.
    topics = {"/meta", "/truth", "/truth_markers", "/camera/scene/film"}
    assert set(episode.messages) == topics and episode.damage is None


def test_a_recording_without_types_has_those_of_the_arm(tmp_path):
    content = {
        "format": 4,
        **{k: getattr(meta(), k) for k in meta().__dataclass_fields__ if k not in ("types", "model")},
    }
    message = json.dumps({"objects": block_state(0.1).to_json()}).encode()
    raw_episode(tmp_path / "e.mcap", "/state", message, content)
    assert [s for _, s in read_episode(tmp_path / "e.mcap").states()] == [block_state(0.1)]
