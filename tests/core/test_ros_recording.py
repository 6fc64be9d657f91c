"""A recording is a bag of ROS 2 as it is: `rosbags` reads every message, and what they are about is one robot."""

from __future__ import annotations

import json
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from mcap.writer import Writer

from resync_robot.core import spatial
from resync_robot.core.episode import mend_episode, read_episode
from resync_robot.core.episode_records import Answer, Ask, EpisodeMeta, EventKind, Timing
from resync_robot.core.episode_schemas import SCHEMAS
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import load_rig
from resync_robot.core.robot_description import JOINTS, camera_frame
from resync_robot.core.state import State
from resync_robot.core.vocabulary import BLOCK, BOX
from resync_robot.core.world import CameraFrame

RIG = load_rig()
BEGAN = "2025-11-28T10:11:12.123456+00:00"
BEGAN_NS = 1_764_324_672_123_456_000
SECONDS = 3
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
STATE = State({
    BLOCK("b0"): np.array([0.35, 0.1, 0.03, *UPRIGHT, 0.06, 0.06, 0.045]),
    BOX("box"): np.array([0.45, 0, 0.005, *UPRIGHT, 0.3, 0.3, 0.11, 0.03]),
})  # fmt: skip
META = EpisodeMeta.of(
    RIG, library_hash="abc", domain="d", scenario="s1", goal="On(b1, b0)", seed=3, backend="sim", began=BEGAN
)


def q_at(time: float) -> np.ndarray:
    return RIG.arm.home + 0.2 * time


def record(path: Path) -> None:
    """All that a deployment may write; pictures come late, as they do where somebody has to encode them."""
    picture = np.zeros((RIG.cameras[0].height, RIG.cameras[0].width))
    with EpisodeWriter(path, META, begin=50.0) as writer:
        for k in range(SECONDS * 10):
            t = k / 10
            asked = JointTarget(q_at(t), 0.1)
            writer.joints(50 + t, q_at(t), np.full(6, 0.2), 0.08 if k else np.nan, asked, asked)
            writer.tip_force(50 + t, np.array([0.0, 1.0, k]))
            if k % 10 != 5:
                continue
            writer.event(50 + t, EventKind.SCAN, "looked")
            writer.state(50 + t, STATE)
            writer.truth(50 + t, STATE)
            writer.atoms(50 + t, {"On(b0, b1)": 0.25})
            writer.plan(50 + t, ["Pick(r, b0)"], 0, "first")
            writer.points(50 + t, np.zeros((5, 3), np.float32), np.full((5, 3), 200, np.uint8))
            for camera in RIG.cameras:
                seen = RIG.camera_pose(camera, q_at(t - 0.5))
                frame = CameraFrame(
                    camera.name, picture.astype(np.uint8), picture.astype(np.uint16), camera.intrinsics, seen, 49.5 + t
                )
                writer.picture(frame, b"jpeg", b"png")
                writer.window(camera.name, 50 + t, b"png")
                writer.film(camera.name, 50 + t, b"\xff\xd8jpeg")
            writer.timing(Timing(49.9 + t, 50 + t, 50.01 + t, 0.002))
            writer.answer(Answer(Ask.REST, 50 + t, JointTarget(q_at(t), 0.1), {}))
    assert writer.error is None


def read(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Every message, unpacked, by topic, with its time in ns, in the order of time."""
    highlevel = pytest.importorskip("rosbags.highlevel", reason="the extra 'dev' is not installed")
    messages = defaultdict(list)
    with highlevel.AnyReader([path]) as reader:
        for connection, time, raw in reader.messages():
            messages[connection.topic].append((time, reader.deserialize(raw, connection.msgtype)))
        assert {topic: len(found) for topic, found in messages.items()} == {
            c.topic: c.msgcount for c in reader.connections
        }
    return dict(messages)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bag") / "episode.mcap"
    record(path)
    return path


@pytest.fixture(scope="module")
def bag(path: Path) -> dict[str, list[tuple[int, Any]]]:
    return read(path)


def headers(message: Any) -> list[Any]:
    """Those of the message and of all in it, but for what it leaves empty."""
    parts = [message, *getattr(message, "transforms", ()), *getattr(message, "markers", ())]
    return [part.header for part in parts if hasattr(part, "header")]


def ns(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def test_every_message_of_every_channel_is_read(path: Path, bag: dict[str, list[tuple[int, Any]]]) -> None:
    assert bag.keys() == read_episode(path).messages.keys()
    names = {*SCHEMAS, "tf", "tf_static", "rosout", "depth_mm", "window", "film"}
    assert {topic.rsplit("/", 1)[-1] for topic in bag} >= names
    for topic in (t for t in bag if t.rsplit("/", 1)[-1] in SCHEMAS):
        schema = SCHEMAS[topic.rsplit("/", 1)[-1]]
        for _, message in bag[topic]:
            assert set(schema["required"]) <= set(json.loads(message.data)), topic
    assert [m.level for _, m in bag["/rosout"]] == [20] * SECONDS
    assert bag["/wrench"][7][1].wrench.force.z == 7.0


def test_the_plan_in_words_marks_what_a_step_came_to_when_it_ends(tmp_path: Path) -> None:
    steps = ["Recover(r, b0, box)", "Pick(r, b1)"]
    with EpisodeWriter(tmp_path / "e.mcap", META) as writer:
        writer.event(0.5, EventKind.SKILL_END, "before any plan", ending="done")
        for i, ending in enumerate(("done", "timeout")):
            writer.plan(1.0 + i, steps, i, "start")
            writer.event(1.5 + i, EventKind.SKILL_END, steps[i], ending=ending)
    words = [(time / 1e9 - BEGAN_NS / 1e9, m.data) for time, m in read(tmp_path / "e.mcap")["/plan_text"]]
    assert [round(time, 1) for time, _ in words] == [1.0, 1.5, 2.0, 2.5]
    assert [[line[0] for line in text.splitlines()[1:]] for _, text in words] == [
        [">", " "],
        ["+", " "],
        [" ", ">"],
        [" ", "x"],
    ]


def test_time_has_its_date_and_runs_forward(bag: dict[str, list[tuple[int, Any]]]) -> None:
    assert bag["/meta"][0][0] == BEGAN_NS
    for topic, messages in bag.items():
        for time, message in messages:
            assert BEGAN_NS <= time <= BEGAN_NS + SECONDS * 10**9, topic
            assert {ns(header.stamp) for header in headers(message)} <= {time}, topic
    # In the order of the file, too, is the robot's motion in the order of time.
    assert len(bag["/tf"]) == 10 * SECONDS


def test_the_file_itself_has_the_motion_in_the_order_of_time(path: Path) -> None:
    times = [time for time, _ in read_episode(path).messages["/tf"]]
    assert times == sorted(times) and len(times) == 10 * SECONDS


def test_who_comes_late_gets_what_does_not_change(path: Path) -> None:
    highlevel = pytest.importorskip("rosbags.highlevel", reason="the extra 'dev' is not installed")
    with highlevel.AnyReader([path]) as reader:
        offered = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    durable = {topic for topic, (profile,) in offered.items() if profile.durability.name == "TRANSIENT_LOCAL"}
    assert durable == {"/meta", "/robot_description", "/tf_static"}
    assert {p.reliability.name for (p,) in offered.values()} == {"RELIABLE"}
    assert {p.history.name for (p,) in offered.values()} == {"KEEP_LAST"}


def test_all_frames_are_one_tree_of_the_robots_links(bag: dict[str, list[tuple[int, Any]]]) -> None:
    parents = defaultdict(set)
    for topic in ("/tf", "/tf_static"):
        for _, message in bag[topic]:
            for t in message.transforms:
                parents[t.child_frame_id].add((topic, t.header.frame_id))
    assert {len(above) for above in parents.values()} == {1}, "each frame hangs on one other, moving or not"
    above = {child: parent for child, ((_, parent),) in parents.items()}
    for frame in above:
        for _ in above:
            frame = above.get(frame, frame)
        assert frame == "world", "the only root"
    used = {h.frame_id for found in bag.values() for _, m in found for h in headers(m)} - {""}
    assert used == {"world", *above.values(), *(camera_frame(c.name) for c in RIG.cameras)}
    assert used <= {"world", *above}
    description = ElementTree.fromstring(bag["/robot_description"][0][1].data)
    links, joints = ({e.get("name") for e in description.iter(kind)} for kind in ("link", "joint"))
    assert links == {"world", *above}
    for topic in ("/joint_states", "/joint_commands"):
        for _, message in bag[topic]:
            assert tuple(message.name) == JOINTS and joints >= set(JOINTS)
            assert len(message.position) == len(JOINTS) and len(message.velocity) in (0, len(JOINTS))


def test_cameras_and_fingers_are_where_they_were(bag: dict[str, list[tuple[int, Any]]]) -> None:
    poses = {}

    def take(message: Any) -> None:
        for t in message.transforms:
            shift, turn = t.transform.translation, t.transform.rotation
            rotation = spatial.matrix_from_quat(np.array([turn.w, turn.x, turn.y, turn.z]))
            position = np.array([shift.x, shift.y, shift.z])
            poses[t.child_frame_id] = t.header.frame_id, spatial.transform(rotation, position)

    def pose_of(frame: str) -> np.ndarray:
        return np.eye(4) if frame == "world" else pose_of(poses[frame][0]) @ poses[frame][1]

    take(bag["/tf_static"][0][1])
    assert {"left_finger", "right_finger"}.isdisjoint(t.child_frame_id for t in bag["/tf"][0][1].transforms), (
        "nobody knew the opening"
    )
    for k, (_, message) in enumerate(bag["/tf"]):
        take(message)
        for camera in RIG.cameras:
            np.testing.assert_allclose(
                pose_of(camera_frame(camera.name)), RIG.camera_pose(camera, q_at(k / 10)), atol=1e-6
            )
    apart = pose_of("left_finger")[:3, 3] - pose_of("right_finger")[:3, 3]
    assert np.linalg.norm(apart) == pytest.approx(0.08)
    assert bag["/joint_states"][-1][1].position[-1] == 0.04


def test_belief_is_orange_and_truth_green(bag: dict[str, list[tuple[int, Any]]]) -> None:
    for topic, kind, colour in (("/belief_markers", 1, "orange"), ("/truth_markers", 5, "green")):
        for _, message in bag[topic]:
            first, *shown = message.markers
            assert first.action == 3 and all(m.action == 0 for m in shown)
            shapes = [m for m in shown if m.type != 9]
            assert [(m.ns, m.type) for m in shapes] == [("b0", kind), *[("box", kind)] * 5]
            assert all((m.color.r > m.color.g > m.color.b) is (colour == "orange") for m in shapes)
            assert colour == "orange" or all(m.color.g > max(m.color.r, m.color.b) for m in shapes)
            np.testing.assert_allclose([shapes[0].pose.position.x, shapes[0].pose.position.z], [0.35, 0.03])


def test_a_camera_that_the_rig_does_not_name_stands_where_it_stood_first(tmp_path: Path) -> None:
    seen = spatial.transform(None, np.array([1.0, 2.0, 3.0]))
    frame = CameraFrame("odd", np.zeros((2, 3, 3), np.uint8), np.zeros((2, 3), np.uint16), np.eye(3), seen, 0.0)
    with EpisodeWriter(tmp_path / "e.mcap", META) as writer:
        writer.picture(frame, b"jpeg", b"png")
        writer.picture(replace(frame, time=1.0), b"jpeg", b"png")
    placed = [t for _, m in read(tmp_path / "e.mcap")["/tf_static"] for t in m.transforms]
    (odd,) = (t for t in placed if t.child_frame_id == camera_frame("odd"))
    assert (odd.header.frame_id, odd.transform.translation.y) == ("world", 2.0)


def test_a_recording_from_before_is_read_and_mended_into_a_bag(tmp_path: Path) -> None:
    """Up to format 3, most messages stood in the file as JSON."""
    old, new = tmp_path / "old.mcap", tmp_path / "new.mcap"
    joints = {
        "measured": [0.5] * 6, "velocity": [0] * 6, "opening": None, "sent": [1] * 6, "sent_opening": 0.1,
        "requested": [2] * 6, "requested_opening": 0.1,
    }  # fmt: skip
    contents = [("/meta", {"format": 3, **vars(META)}), ("/joints", joints)]
    with old.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        for topic, content in contents:
            schema = writer.register_schema(topic[1:], "jsonschema", json.dumps(SCHEMAS[topic[1:]]).encode())
            channel = writer.register_channel(topic, "json", schema)
            writer.add_message(channel, BEGAN_NS, json.dumps(content).encode(), BEGAN_NS)
        writer.finish()
    mend_episode(old, new)
    for path in (old, new):
        (moment,) = read_episode(path).joints()
        assert moment.time == 0.0 and moment.sent.arm[0] == 1.0 and read_episode(path).meta == META
    bag = read(new)
    assert [json.loads(bag[topic][0][1].data) for topic, _ in contents] == [content for _, content in contents]


def test_a_damaged_recording_is_mended_into_a_bag(path: Path, tmp_path: Path) -> None:
    data = path.read_bytes()
    (tmp_path / "torn.mcap").write_bytes(data[: len(data) * 2 // 3])
    mend_episode(tmp_path / "torn.mcap", tmp_path / "mended.mcap")
    bag = read(tmp_path / "mended.mcap")
    assert {"/meta", "/robot_description", "/tf_static", "/tf"} <= bag.keys()
