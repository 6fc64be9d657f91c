"""The messages of ROS 2 that a recording holds for viewers, packed as ROS 2 packs them (CDR, little-endian).

Written here because a viewer needs no more than these few, and the library that packs any message has no way to close
a chunk in between, which is what a killed process leaves behind. Each function gives the bytes of one message, its
`stamp` in ns since the epoch: a float of seconds would round it. `DEFINITIONS` has what a reader needs to unpack them.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt16

from resync_robot.core import spatial

_HEAD = b"\x00\x01\x00\x00"
"""Plain CDR, little-endian."""
_FLOAT, _BYTE = 7, 2
_CLOUD_FIELDS = (
    ("x", 0, _FLOAT),
    ("y", 4, _FLOAT),
    ("z", 8, _FLOAT),
    ("r", 12, _BYTE),
    ("g", 13, _BYTE),
    ("b", 14, _BYTE),
)


class _Packer:
    """Fields in order, each aligned to its own size."""

    def __init__(self) -> None:
        self._data = bytearray()

    def numbers(self, kind: str, *values: float) -> _Packer:
        """Numbers of one `struct` letter, without a count in front."""
        self._data += bytes(-len(self._data) % struct.calcsize(kind))
        self._data += struct.pack(f"<{len(values)}{kind}", *values)
        return self

    def sequence(self, kind: str, values: Sequence[float] | np.ndarray) -> _Packer:
        return self.numbers("I", len(values)).numbers(kind, *values) if len(values) else self.numbers("I", 0)

    def blob(self, data: bytes) -> _Packer:
        self.numbers("I", len(data))
        self._data += data
        return self

    def text(self, text: str) -> _Packer:
        return self.blob(text.encode() + b"\0")

    def header(self, stamp: int, frame: str) -> _Packer:
        return self.stamp(stamp).text(frame)

    def stamp(self, stamp: int) -> _Packer:
        return self.numbers("i", stamp // 10**9).numbers("I", stamp % 10**9)

    def message(self) -> bytes:
        return _HEAD + bytes(self._data)


def joint_state(stamp: int, names: Sequence[str], position: np.ndarray, velocity: np.ndarray) -> bytes:
    """sensor_msgs/msg/JointState: rad and rad/s of a joint, m of an opening."""
    packer = _Packer().header(stamp, "").numbers("I", len(names))
    for name in names:
        packer.text(name)
    return packer.sequence("d", position).sequence("d", velocity).sequence("d", ()).message()


def transforms(stamp: int, poses: Sequence[tuple[str, str, Float[np.ndarray, "4 4"]]]) -> bytes:
    """tf2_msgs/msg/TFMessage of (parent, child, pose of child in parent)."""
    packer = _Packer().numbers("I", len(poses))
    for parent, child, pose in poses:
        w, *xyz = spatial.quat_from_matrix(pose[:3, :3])
        packer.header(stamp, parent).text(child).numbers("d", *pose[:3, 3], *xyz, w)
    return packer.message()


def wrench(stamp: int, frame: str, force: Float[np.ndarray, "3"]) -> bytes:
    """geometry_msgs/msg/WrenchStamped: N, no torque."""
    return _Packer().header(stamp, frame).numbers("d", *force, 0.0, 0.0, 0.0).message()


def camera_info(stamp: int, frame: str, intrinsics: Float[np.ndarray, "3 3"], width: int, height: int) -> bytes:
    """sensor_msgs/msg/CameraInfo of a rectified picture."""
    projection = np.column_stack([intrinsics, np.zeros(3)])
    packer = _Packer().header(stamp, frame).numbers("I", height, width).text("plumb_bob").sequence("d", [0.0] * 5)
    packer.numbers("d", *intrinsics.ravel(), *np.eye(3).ravel(), *projection.ravel())
    return packer.numbers("I", 0, 0, 0, 0, 0, 0).numbers("B", 0).message()


def compressed_image(stamp: int, frame: str, kind: str, data: bytes) -> bytes:
    """sensor_msgs/msg/CompressedImage; `kind` is jpeg or png."""
    return _Packer().header(stamp, frame).text(kind).blob(data).message()


def depth_image(stamp: int, frame: str, millimetres: UInt16[np.ndarray, "h w"]) -> bytes:
    """sensor_msgs/msg/Image, 16UC1: mm, 0 = nothing, as every tool of ROS takes 16-bit depth."""
    height, width = millimetres.shape
    packer = _Packer().header(stamp, frame).numbers("I", height, width).text("16UC1")
    packer.numbers("B", 0).numbers("I", 2 * width)
    return packer.blob(millimetres.astype("<u2").tobytes()).message()


def point_cloud(stamp: int, frame: str, points: np.ndarray) -> bytes:
    """sensor_msgs/msg/PointCloud2 of `core.episode.POINT`s: x y z in m, r g b of 255."""
    packer = _Packer().header(stamp, frame).numbers("I", 1, len(points), len(_CLOUD_FIELDS))
    for name, offset, kind in _CLOUD_FIELDS:
        packer.text(name).numbers("I", offset).numbers("B", kind).numbers("I", 1)
    packer.numbers("B", 0).numbers("I", points.itemsize, points.nbytes)
    return packer.blob(points.tobytes()).numbers("B", 1).message()


def string(text: str) -> bytes:
    """std_msgs/msg/String."""
    return _Packer().text(text).message()


def number(value: float) -> bytes:
    """std_msgs/msg/Float64."""
    return _Packer().numbers("d", value).message()


def log(stamp: int, level: int, name: str, text: str) -> bytes:
    """rcl_interfaces/msg/Log: level 20 information, 30 warning, 40 error."""
    return _Packer().stamp(stamp).numbers("B", level).text(name).text(text).text("").text("").numbers("I", 0).message()


class _Unpacker:
    """Fields in order; raises ValueError where the message ends early."""

    def __init__(self, message: bytes) -> None:
        if not message.startswith(_HEAD):
            raise ValueError("it is not packed as ROS 2 does")
        self._data, self._at = memoryview(message)[len(_HEAD) :], 0

    def number(self, kind: str) -> int:
        size = struct.calcsize(kind)
        begin = self._at + -self._at % size
        self._at = begin + size
        if self._at > len(self._data):
            raise ValueError("it ends early")
        return int(struct.unpack_from(f"<{kind}", self._data, begin)[0])

    def blob(self) -> bytes:
        size = self.number("I")
        begin, self._at = self._at, self._at + size
        if self._at > len(self._data):
            raise ValueError("it ends early")
        return bytes(self._data[begin : self._at])

    def header(self) -> None:
        for kind in "iI":
            self.number(kind)
        self.blob()


def image_data(message: bytes) -> bytes:
    """The compressed bytes in a CompressedImage. Raises ValueError where the message is none."""
    unpacker = _Unpacker(message)
    unpacker.header()
    unpacker.blob()
    return unpacker.blob()


def cloud_data(message: bytes) -> bytes:
    """The bytes of the points in a PointCloud2 like ours. Raises ValueError where the message is none."""
    unpacker = _Unpacker(message)
    unpacker.header()
    _, points, fields = (unpacker.number("I") for _ in range(3))
    if fields != len(_CLOUD_FIELDS):
        raise ValueError(f"its points have {fields} fields")
    for _ in range(fields):
        unpacker.blob()
        for kind in "IBI":
            unpacker.number(kind)
    unpacker.number("B")
    step, _ = unpacker.number("I"), unpacker.number("I")
    data = unpacker.blob()
    if len(data) != points * step:
        raise ValueError("it has no whole number of points")
    return data


_SEPARATOR = "=" * 80
_TIME = f"{_SEPARATOR}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
_HEADER = f"{_SEPARATOR}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n{_TIME}"
_VECTOR = f"{_SEPARATOR}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
DEFINITIONS = {
    "sensor_msgs/msg/JointState": (
        f"std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n{_HEADER}"
    ),
    "tf2_msgs/msg/TFMessage": (
        f"geometry_msgs/TransformStamped[] transforms\n{_SEPARATOR}\nMSG: geometry_msgs/TransformStamped\n"
        f"std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n{_SEPARATOR}\n"
        f"MSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n{_VECTOR}"
        f"{_SEPARATOR}\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n{_HEADER}"
    ),
    "geometry_msgs/msg/WrenchStamped": (
        f"std_msgs/Header header\ngeometry_msgs/Wrench wrench\n{_SEPARATOR}\nMSG: geometry_msgs/Wrench\n"
        f"geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n{_VECTOR}{_HEADER}"
    ),
    "sensor_msgs/msg/CameraInfo": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n"
        "float64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n"
        f"{_SEPARATOR}\nMSG: sensor_msgs/RegionOfInterest\nuint32 x_offset\nuint32 y_offset\nuint32 height\n"
        f"uint32 width\nbool do_rectify\n{_HEADER}"
    ),
    "sensor_msgs/msg/CompressedImage": f"std_msgs/Header header\nstring format\nuint8[] data\n{_HEADER}",
    "sensor_msgs/msg/Image": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
        f"uint8[] data\n{_HEADER}"
    ),
    "sensor_msgs/msg/PointCloud2": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n"
        f"uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n{_SEPARATOR}\nMSG: sensor_msgs/PointField\n"
        f"string name\nuint32 offset\nuint8 datatype\nuint32 count\n{_HEADER}"
    ),
    "std_msgs/msg/String": "string data\n",
    "std_msgs/msg/Float64": "float64 data\n",
    "rcl_interfaces/msg/Log": (
        "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\n"
        f"uint32 line\n{_TIME}"
    ),
}
"""Name of a message -> its fields, and those of the messages in it, as ROS 2 writes them into recordings."""
