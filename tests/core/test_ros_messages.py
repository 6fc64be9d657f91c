"""What we pack is what a reader of ROS 2 unpacks, by the definitions that go into the file."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from resync_robot.core import ros_messages, spatial
from resync_robot.core.episode import POINT

names = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
times = st.integers(0, 2 * 10**18)
"""ns since the epoch."""
numbers = st.floats(-1e6, 1e6)


def unpack(kind: str, message: bytes) -> Any:
    """By the library that viewers and labs use."""
    decoder = pytest.importorskip("mcap_ros2.decoder", reason="the extra 'dev' is not installed")
    records = pytest.importorskip("mcap.records")
    schema = records.Schema(id=1, name=kind, encoding="ros2msg", data=ros_messages.DEFINITIONS[kind].encode())
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


@given(names, st.integers(0, 20))
def test_clouds_and_back(frame: str, count: int) -> None:
    points = np.zeros(count, POINT)
    points["xyz"], points["rgb"] = np.arange(3 * count).reshape(count, 3) / 7, 200
    message = ros_messages.point_cloud(3 * 10**9, frame, points)
    got = unpack("sensor_msgs/msg/PointCloud2", message)
    assert (got.header.frame_id, got.height, got.width, got.point_step) == (frame, 1, count, POINT.itemsize)
    named = (
        {
            f.name: np.ndarray(count, {7: "<f4", 2: "u1"}[f.datatype], bytes(got.data), f.offset, got.point_step)
            for f in got.fields
        }
        if count
        else {}
    )
    for i, name in enumerate(named):
        np.testing.assert_array_equal(named[name], points["xyz" if i < 3 else "rgb"][:, i % 3])
    assert ros_messages.cloud_data(message) == points.tobytes()


@given(st.binary(max_size=120))
def test_what_is_no_picture_and_no_cloud_is_a_value_error(data: bytes) -> None:
    for read in (ros_messages.image_data, ros_messages.cloud_data):
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
