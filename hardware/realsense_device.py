"""Where a D435i's frames come from: a device by its serial number, or a recording of one."""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

from resync_robot.hardware.base import RobotError

DEPTH_SIZE = (848, 480)
"""Pixels; the width at which the D435i measures best."""
RATE_HZ = 30
INSTALL = "uv pip install -e '.[hardware]' -c constraints.txt"


@dataclass(frozen=True)
class Stream:
    """What a started source delivers: `intrinsics` (3, 3) px of the colour, `depth_unit` m, `size` (width, height)."""

    intrinsics: Float[np.ndarray, "3 3"]
    depth_unit: float
    size: tuple[int, int]


class FrameSource(Protocol):
    """Where pairs of depth and colour come from: a device's pipeline, a recording, or a software device."""

    def start(self) -> Stream:
        """Raises RobotError when the device is not there."""
        ...

    def wait(self, seconds: float) -> Any:
        """The next pyrealsense2 frameset, or None when none came in time. Raises RobotError when the device is gone."""
        ...

    def stop(self) -> None: ...


def load_pyrealsense2() -> ModuleType:
    """The library. Raises RobotError with the command that installs it, or what it lacks."""
    if importlib.util.find_spec("pyrealsense2") is None:
        raise RobotError("the package pyrealsense2 is not installed", INSTALL)
    if importlib.util.find_spec("libusb_package") is not None:
        # Its wheel links to the system's libusb; this makes pip's copy known under the same name.
        library = importlib.import_module("libusb_package").get_library_path()
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
    try:
        import pyrealsense2
    except ImportError as error:
        raise RobotError(f"pyrealsense2 does not load: {error}", "sudo apt-get install libusb-1.0-0") from None
    return pyrealsense2


class PipelineSource:
    """A connected camera by its serial number, or a recording of one.

    Args:
        serial: as printed on the camera and as `rs-enumerate-devices` says.
        colour_size: (width, height) px of the rig's camera.
        recording: a file to play instead, at the speed at which it was recorded.
    """

    def __init__(self, serial: str, colour_size: tuple[int, int], recording: Path | None = None) -> None:
        self._serial, self._size, self._recording = serial, colour_size, recording
        self._pipeline: Any = None

    def start(self) -> Stream:
        rs = load_pyrealsense2()
        config = rs.config()
        if self._recording is None:
            found = [d.get_info(rs.camera_info.serial_number) for d in rs.context().query_devices()]
            if self._serial not in found:
                there = ", ".join(sorted(found)) or "none"
                raise RobotError(
                    f"no camera with serial number {self._serial}; connected: {there}",
                    "check its USB 3 cable, and the serial in the rig file",
                )
            config.enable_device(self._serial)
            config.enable_stream(rs.stream.depth, *DEPTH_SIZE, rs.format.z16, RATE_HZ)
            config.enable_stream(rs.stream.color, *self._size, rs.format.rgb8, RATE_HZ)
        else:
            config.enable_device_from_file(str(self._recording), False)
        pipeline = rs.pipeline()
        try:
            profile = pipeline.start(config)
        except RuntimeError as error:
            raise RobotError(
                f"camera {self._serial} does not start: {error}", "unplug it and plug it in again"
            ) from None
        self._pipeline = pipeline
        device = profile.get_device()
        for sensor in device.query_sensors():
            if sensor.supports(rs.option.global_time_enabled):
                sensor.set_option(rs.option.global_time_enabled, 1)
        colour = profile.get_stream(rs.stream.color).as_video_stream_profile()
        scale = 0.001
        for sensor in device.query_sensors():
            if sensor.supports(rs.option.depth_units):
                scale = float(sensor.get_option(rs.option.depth_units))
        return Stream(matrix_of(colour.get_intrinsics()), scale, (colour.width(), colour.height()))

    def wait(self, seconds: float) -> Any:
        try:
            arrived, frames = self._pipeline.try_wait_for_frames(max(1, round(1000 * seconds)))
        except RuntimeError as error:
            raise RobotError(f"camera {self._serial} is gone: {error}", "check its USB 3 cable") from None
        return frames if arrived else None

    def stop(self) -> None:
        if self._pipeline is not None:
            self._pipeline.stop()
            self._pipeline = None


def matrix_of(intrinsics: Any) -> Float[np.ndarray, "3 3"]:
    """The camera matrix (px) of pyrealsense2's intrinsics."""
    i = intrinsics
    return np.array([[i.fx, 0.0, i.ppx], [0.0, i.fy, i.ppy], [0.0, 0.0, 1.0]])
