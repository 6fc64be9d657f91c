"""What we pack is what a reader of ROS 2 unpacks, by the definitions that go into the file."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from resync_robot.core import ros_messages, spatial
from resync_robot.core.ros_definitions import DEFINITIONS
from resync_robot.core.ros_messages import Marker

names = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
times = st.integers(0, 2 * 10**18)
"""ns since the epoch."""
numbers = st.floats(-1e6, 1e6)


def unpack(kind: str, message: bytes) -> Any:
    """By the library that viewers and labs use."""
    decoder = pytest.importorskip("mcap_ros2.decoder", reason="the extra 'dev' is not installed")
    records = pytest.importorskip("mcap.records")
    schema = records.Schema(id=1, name=kind, encoding="ros2msg", data=DEFINITIONS[kind].encode())
    return decoder.DecoderFactory().decoder_for("cdr", schema)(message)


def nanoseconds(stamp: Any) -> int:
    return stamp.sec * 10**9 + stamp.nanosec


@given(times, st.lists(st.tuples(names, numbers, numbers), max_size=8))
def test_joint_states(stamp: int, joints: list[tuple[str, float, float]]) -> None:
    columns = [list(column) for column in zip(*joints, strict=True)] or [[], [], []]
    got = unpack("sensor_msgs/msg/JointState", ros_messages.joint_state(stamp, *columns))
    assert [list(got.name), list(got.position), list(got.velocity), list(got.effort)] == [*columns, []]
    assert nanoseconds(got.header.stamp) == stamp


@given(st.lists(st.tuples(names, names, arrays(float, 3, elements=st.floats(-3, 3))), max_size=4))
def test_transforms(links: list[tuple[str, str, np.ndarray]]) -> None:
    poses = [spatial.transform(spatial.rotation_from_vector(v), v * 2) for _, _, v in links]
    message = ros_messages.transforms(15 * 10**8, [(p, c, pose) for (p, c, _), pose in zip(links, poses, strict=True)])
    got = unpack("tf2_msgs/msg/TFMessage", message).transforms
    assert [(t.header.frame_id, t.child_frame_id) for t in got] == [(p, c) for p, c, _ in links]
    for found, pose in zip(got, poses, strict=True):
        turn, shift = found.transform.rotation, found.transform.translation
        np.testing.assert_allclose([shift.x, shift.y, shift.z], pose[:3, 3])
        np.testing.assert_allclose(
            spatial.matrix_from_quat(np.array([turn.w, turn.x, turn.y, turn.z])), pose[:3, :3], atol=1e-9
        )


@given(names, st.integers(1, 9), st.integers(1, 9))
def test_depth_and_what_it_takes_to_use_it(frame: str, height: int, width: int) -> None:
    depth = np.arange(height * width, dtype=np.uint16).reshape(height, width) * 700
    got = unpack("sensor_msgs/msg/Image", ros_messages.depth_image(225 * 10**7, frame, depth))
    assert (got.header.frame_id, got.encoding, got.is_bigendian, got.step) == (frame, "16UC1", 0, 2 * width)
    np.testing.assert_array_equal(np.frombuffer(bytes(got.data), "<u2").reshape(got.height, got.width), depth)
    camera = np.array([[600.0, 0, 320], [0, 610, 240], [0, 0, 1]])
    info = unpack("sensor_msgs/msg/CameraInfo", ros_messages.camera_info(225 * 10**7, frame, camera, width, height))
    assert (info.width, info.height, info.distortion_model, list(info.d)) == (width, height, "plumb_bob", [0.0] * 5)
    np.testing.assert_array_equal(np.reshape(info.k, (3, 3)), camera)
    np.testing.assert_array_equal(np.reshape(info.p, (3, 4)), np.column_stack([camera, np.zeros(3)]))
    np.testing.assert_array_equal(np.reshape(info.r, (3, 3)), np.eye(3))
    assert (info.roi.do_rectify, info.binning_x) == (False, 0)


@given(names, st.binary(max_size=40))
def test_compressed_pictures_and_back(frame: str, data: bytes) -> None:
    message = ros_messages.compressed_image(10**8, frame, "jpeg", data)
    got = unpack("sensor_msgs/msg/CompressedImage", message)
    assert (got.header.frame_id, got.format, bytes(got.data)) == (frame, "jpeg", data)
    assert ros_messages.image_data(message) == data


@given(names, arrays(np.uint8, st.tuples(st.integers(0, 20), st.just(3))))
def test_clouds_and_back(frame: str, rgb: np.ndarray) -> None:
    xyz = np.arange(3 * len(rgb), dtype=np.float32).reshape(-1, 3) / 7
    message = ros_messages.point_cloud(3 * 10**9, frame, xyz, rgb)
    got = unpack("sensor_msgs/msg/PointCloud2", message)
    assert (got.header.frame_id, got.height, got.width, got.point_step) == (frame, 1, len(rgb), 16)
    assert [(f.name, f.offset, f.datatype, f.count) for f in got.fields] == [
        ("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("rgb", 12, 7, 1)
    ]  # fmt: skip
    # The bits of the fourth number are 0x00RRGGBB, as PCL packs them.
    packed = np.frombuffer(bytes(got.data), "<u4").reshape(-1, 4)[:, 3]
    np.testing.assert_array_equal(packed, rgb.astype(np.uint32) @ np.array([65536, 256, 1], np.uint32))
    for found, meant in zip(ros_messages.cloud_points(message), (xyz, rgb), strict=True):
        np.testing.assert_array_equal(found, meant)


def test_clouds_of_earlier_recordings() -> None:
    """Fields x y z r g b, 15 bytes a point."""
    points = np.zeros(2, [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    points["xyz"], points["rgb"] = [[1, 2, 3], [4, 5, 6]], [[10, 20, 30], [40, 50, 60]]
    packer = ros_messages._Packer().header(0, "world").numbers("I", 1, 2, 6)
    for i, name in enumerate("xyzrgb"):
        offset, kind = (4 * i, 7) if i < 3 else (9 + i, 2)
        packer.text(name).numbers("I", offset).numbers("B", kind).numbers("I", 1)
    packer.numbers("B", 0).numbers("I", 15, 30)
    xyz, rgb = ros_messages.cloud_points(packer.blob(points.tobytes()).numbers("B", 1).message())
    np.testing.assert_array_equal(xyz, points["xyz"])
    np.testing.assert_array_equal(rgb, points["rgb"])


def test_markers() -> None:
    turned = spatial.transform(spatial.rotation_about("z", 0.5), np.array([1.0, 2.0, 3.0]))
    size, orange = np.array([0.1, 0.2, 0.3]), (1.0, 0.5, 0.0, 0.75)
    shown = [
        Marker("b0", 0, turned, size, orange), Marker("b0", 1, turned, size, orange, outlined=True),
        Marker("b0", 2, np.eye(4), np.full(3, 0.03), orange, text="b0 über"),
    ]  # fmt: skip
    got = unpack("visualization_msgs/msg/MarkerArray", ros_messages.markers(7, "world", shown)).markers
    assert [(m.action, m.type, m.ns, m.id) for m in got] == [
        (3, 1, "", 0),
        (0, 1, "b0", 0),
        (0, 5, "b0", 1),
        (0, 9, "b0", 2),
    ]
    assert {(m.header.frame_id, nanoseconds(m.header.stamp), m.lifetime.sec, m.frame_locked) for m in got} == {
        ("world", 7, 0, False)
    }
    cube, lines, word = got[1:]
    assert (cube.scale.x, cube.scale.y, cube.scale.z) == (0.1, 0.2, 0.3) and not cube.points
    assert (cube.color.r, cube.color.g, cube.color.b, cube.color.a) == orange
    assert (cube.pose.position.y, cube.pose.orientation.z) == (2.0, pytest.approx(np.sin(0.25)))
    ends = np.array([[p.x, p.y, p.z] for p in lines.points]).reshape(12, 2, 3)
    assert {tuple(np.abs(end)) for end in ends.reshape(-1, 3).round(9)} == {(0.05, 0.1, 0.15)}
    lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).round(9).tolist()
    assert sorted(lengths) == [0.1] * 4 + [0.2] * 4 + [0.3] * 4, "every edge of the box once"
    assert len({tuple(sorted(map(tuple, edge))) for edge in ends.round(9).tolist()}) == 12
    assert (lines.scale.x, word.text, word.scale.z) == (ros_messages.OUTLINE, "b0 über", 0.03)


@pytest.mark.parametrize("version", ["ROS2_HUMBLE", "ROS2_JAZZY"])
def test_definitions_are_those_of_the_versions_in_use(version: str) -> None:
    typesys = pytest.importorskip("rosbags.typesys", reason="the extra 'dev' is not installed")
    known = typesys.get_typestore(typesys.Stores[version]).fielddefs
    for kind, text in DEFINITIONS.items():
        for name, (_, fields) in typesys.get_types_from_msg(text, kind).items():
            assert list(fields) == list(known[name][1]), name


@given(st.text(st.characters(codec="utf-8", exclude_characters="\0")))
def test_texts_and_back(text: str) -> None:
    for message in (ros_messages.string(text), ros_messages.string(text.encode())):
        assert ros_messages.is_packed(message) and ros_messages.text_data(message) == text.encode()


@given(st.binary(max_size=120))
def test_what_is_no_such_message_is_a_value_error(data: bytes) -> None:
    for read in (ros_messages.image_data, ros_messages.cloud_points, ros_messages.text_data):
        for message in (data, b"\x00\x01\x00\x00" + data):
            try:
                read(message)
            except ValueError:
                pass


@given(names, numbers, times)
def test_the_small_ones(text: str, number: float, stamp: int) -> None:
    assert unpack("std_msgs/msg/String", ros_messages.string(text)).data == text
    assert unpack("std_msgs/msg/Float64", ros_messages.number(number)).data == number
    line = unpack("rcl_interfaces/msg/Log", ros_messages.log(stamp, 30, "replan", text))
    assert (line.level, line.name, line.msg) == (30, "replan", text)
    assert nanoseconds(line.stamp) == stamp
    force = unpack("geometry_msgs/msg/WrenchStamped", ros_messages.wrench(stamp, text, np.array([1.0, -2.0, number])))
    assert (force.wrench.force.y, force.wrench.force.z, force.wrench.torque.x) == (-2.0, number, 0.0)
