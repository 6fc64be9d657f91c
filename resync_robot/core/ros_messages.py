"""The messages of ROS 2 that a recording holds, packed as ROS 2 packs them (CDR, little-endian).

Written here because a recording needs no more than these few, and the library that packs any message has no way to
close a chunk in between, which is what a killed process leaves behind. Each function gives the bytes of one message,
its `stamp` in ns since the epoch: a float of seconds would round it. `ros_definitions` has what a reader needs to
unpack them.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from resync_robot.core import spatial

_HEAD = b"\x00\x01\x00\x00"
"""Plain CDR, little-endian."""
_FLOAT = 7
_POINT = np.dtype(
    {"names": ["xyz", "bgr"], "formats": [("<f4", 3), ("u1", 3)], "offsets": [0, 12], "itemsize": 16}
)  # fmt: skip
"""A point as every tool of ROS takes it: its colour is packed into the bits of one more number, `rgb`."""
_LOOSE_POINT = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])
"""As recordings up to format 3 have it: fields x y z r g b."""
_CUBE, _LINES, _TEXT = 1, 5, 9
_ADD, _DELETE_ALL = 0, 3
OUTLINE = 0.0015
"""m; width of the lines of a marker that is only outlined."""
_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_EDGES = [(i, j) for i in range(8) for j in range(i) if np.abs(_CORNERS[i] - _CORNERS[j]).sum() == 1.0]


@dataclass(frozen=True)
class Marker:
    """A box, or a word, in a picture of the scene.

    Attributes:
        name: of the thing that it belongs to; of one thing, `number` tells the markers apart.
        pose: (4, 4) of its middle; size: (3,) m, of a word its height comes last.
        colour: red, green, blue and opacity, 0 to 1.
        outlined: only its edges.
        text: the word; empty for a box.
    """

    name: str
    number: int
    pose: Float[np.ndarray, "4 4"]
    size: Float[np.ndarray, "3"]
    colour: tuple[float, float, float, float]
    outlined: bool = False
    text: str = ""


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

    def text(self, text: str | bytes) -> _Packer:
        return self.blob((text if isinstance(text, bytes) else text.encode()) + b"\0")

    def header(self, stamp: int, frame: str) -> _Packer:
        return self.stamp(stamp).text(frame)

    def stamp(self, stamp: int) -> _Packer:
        return self.numbers("i", stamp // 10**9).numbers("I", stamp % 10**9)

    def message(self) -> bytes:
        return _HEAD + bytes(self._data)


def joint_state(stamp: int, names: Sequence[str], position: np.ndarray, velocity: np.ndarray) -> bytes:
    """sensor_msgs/msg/JointState: rad and rad/s of a joint that turns, m and m/s of one that slides."""
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


def point_cloud(stamp: int, frame: str, xyz: Float[np.ndarray, "n 3"], rgb: UInt8[np.ndarray, "n 3"]) -> bytes:
    """sensor_msgs/msg/PointCloud2: m, and colours of 255."""
    points = np.zeros(len(xyz), _POINT)
    points["xyz"], points["bgr"] = xyz, rgb[:, ::-1]
    packer = _Packer().header(stamp, frame).numbers("I", 1, len(points), 4)
    for i, name in enumerate(("x", "y", "z", "rgb")):
        packer.text(name).numbers("I", 4 * i).numbers("B", _FLOAT).numbers("I", 1)
    packer.numbers("B", 0).numbers("I", points.itemsize, points.nbytes)
    return packer.blob(points.tobytes()).numbers("B", 1).message()


def markers(stamp: int, frame: str, shown: Sequence[Marker]) -> bytes:
    """visualization_msgs/msg/MarkerArray: these, in place of all that were there."""
    nowhere = Marker("", 0, np.eye(4), np.ones(3), (0.0, 0.0, 0.0, 0.0))
    packer = _Packer().numbers("I", 1 + len(shown))
    for marker, action in ((nowhere, _DELETE_ALL), *((marker, _ADD) for marker in shown)):
        kind = _TEXT if marker.text else _LINES if marker.outlined else _CUBE
        packer.header(stamp, frame).text(marker.name).numbers("i", marker.number, kind, action)
        w, *xyz = spatial.quat_from_matrix(marker.pose[:3, :3])
        packer.numbers("d", *marker.pose[:3, 3], *xyz, w)
        packer.numbers("d", *((OUTLINE, 0.0, 0.0) if marker.outlined else marker.size)).numbers("f", *marker.colour)
        # For ever; not moving with its frame.
        packer.numbers("i", 0).numbers("I", 0).numbers("B", 0)
        edges = (_CORNERS * marker.size)[_EDGES].reshape(-1) if marker.outlined else np.empty(0)
        packer.numbers("I", len(edges) // 3)
        if len(edges):
            packer.numbers("d", *edges)
        # Neither colours of their own, nor a texture, an empty picture with its coordinates, nor a mesh.
        packer.numbers("I", 0).text("").header(0, "").text("").blob(b"").numbers("I", 0)
        packer.text(marker.text).text("").text("").blob(b"").numbers("B", 0)
    return packer.message()


def string(text: str | bytes) -> bytes:
    """std_msgs/msg/String; bytes are taken for UTF-8."""
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


def text_data(message: bytes) -> bytes:
    """The text in a String, as UTF-8. Raises ValueError where the message is none."""
    return _Unpacker(message).blob().removesuffix(b"\0")


def is_packed(message: bytes) -> bool:
    """Whether it may be a message of ROS 2 at all; no JSON text begins like one."""
    return message.startswith(_HEAD)


def cloud_points(message: bytes) -> tuple[Float[np.ndarray, "n 3"], UInt8[np.ndarray, "n 3"]]:
    """Places in m and colours in a PointCloud2 like ours, of now or up to format 3.

    Raises:
        ValueError: the message is none.
    """
    unpacker = _Unpacker(message)
    unpacker.header()
    _, count, fields = (unpacker.number("I") for _ in range(3))
    if fields not in (4, 6):
        raise ValueError(f"its points have {fields} fields")
    for _ in range(fields):
        unpacker.blob()
        for kind in "IBI":
            unpacker.number(kind)
    unpacker.number("B")
    step, _ = unpacker.number("I"), unpacker.number("I")
    data, point = unpacker.blob(), _POINT if fields == 4 else _LOOSE_POINT
    if step != point.itemsize or len(data) != count * step:
        raise ValueError("it has no whole number of points")
    points = np.frombuffer(data, point)
    return points["xyz"], points["bgr"][:, ::-1] if fields == 4 else points["rgb"]
