"""D435i cameras by serial number, through pyrealsense2.

A picture is one that was exposed after it was asked for, its depth filtered in disparity and aligned to its colour,
with the intrinsics that the device itself reports.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

from hardware.base import Connected, RobotError, StaleError
from resync_robot.core.rig import CameraRig
from resync_robot.core.world import CameraFrame

DEPTH_SIZE = (848, 480)
"""Pixels; the width at which the D435i measures best."""
RATE_HZ = 30
WARM_UP_FRAMES = 30
"""Until exposure and white balance have settled."""
STALL_S = 1.0
MOST_SKEW_S = 0.020
"""Between depth and colour of one picture; more, and one of the two streams lost a frame."""
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
        """The next pyrealsense2 frameset, or None when none came in time."""
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
        recording: a file to play instead, as fast as it is read.
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
        if self._recording is not None:
            device.as_playback().set_real_time(False)
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
        arrived, frames = self._pipeline.try_wait_for_frames(max(1, round(1000 * seconds)))
        return frames if arrived else None

    def stop(self) -> None:
        if self._pipeline is not None:
            self._pipeline.stop()
            self._pipeline = None


class RealSense(Connected):
    """One camera of the rig.

    Args:
        camera: name, serial number, mounting and calibrated intrinsics.
        world_T_cam: where the camera is now, (4, 4), from the rig and the arm.
        source: of frames; default: the device with that serial number.
        warm_up: frames that are thrown away first.
        fresh: demand pictures exposed after they were asked for; a recording has none.
    """

    def __init__(
        self,
        camera: CameraRig,
        world_T_cam: Callable[[], Float[np.ndarray, "4 4"]],
        source: FrameSource | None = None,
        warm_up: int = WARM_UP_FRAMES,
        fresh: bool = True,
    ) -> None:
        self.name = camera.name
        self._camera, self._world_T_cam = camera, world_T_cam
        self._source = source or PipelineSource(camera.serial, (camera.width, camera.height))
        self._warm_up, self._fresh = warm_up, fresh
        self._stream: Stream | None = None
        self._filters: list[Any] = []
        self._align: Any = None
        self.dropped = 0
        """Framesets that could not be used: too old, torn, or skewed."""

    def connect(self) -> None:
        """Start it, and let it warm up.

        Raises:
            RobotError: no such camera, it does not start, or delivers other pictures than the rig says.
            StaleError: no pictures come.
        """
        rs = load_pyrealsense2()
        stream = self._source.start()
        self._stream = stream
        try:
            expected = (self._camera.width, self._camera.height)
            if stream.size != expected:
                raise RobotError(
                    f"camera '{self.name}' delivers {stream.size[0]} x {stream.size[1]} pixels, the rig says "
                    f"{expected[0]} x {expected[1]}",
                    "calibrate at the size that is used, and put it into the rig file",
                )
            threshold = rs.disparity_transform(True), rs.spatial_filter(), rs.disparity_transform(False)
            self._filters, self._align = list(threshold), rs.align(rs.stream.color)
            for _ in range(self._warm_up):
                self._next(time.monotonic() + STALL_S)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        if self._stream is not None:
            self._stream = None
            self._source.stop()

    def capture(self) -> CameraFrame:
        """A picture exposed after this call.

        Raises:
            StaleError: none comes, only old ones come, or depth and colour do not fit in time.
        """
        stream = self._require_stream()
        asked, deadline = 1000 * time.time(), time.monotonic() + STALL_S
        why = "no picture came"
        while True:
            frames = self._next(deadline, why)
            depth, colour = frames.get_depth_frame(), frames.get_color_frame()
            if not depth or not colour:
                self.dropped, why = self.dropped + 1, "depth or colour is missing in every one"
                continue
            if self._fresh and min(depth.get_timestamp(), colour.get_timestamp()) < asked:
                self.dropped, why = self.dropped + 1, "every one is older than the request"
                continue
            skew = abs(depth.get_timestamp() - colour.get_timestamp()) / 1000
            if skew > MOST_SKEW_S:
                self.dropped, why = self.dropped + 1, f"depth and colour are {1000 * skew:.0f} ms apart"
                continue
            break
        pose = np.array(self._world_T_cam())
        for step in self._filters:
            frames = step.process(frames).as_frameset()
        frames = self._align.process(frames)
        metres = np.asanyarray(frames.get_depth_frame().get_data()).astype(np.float64) * stream.depth_unit
        depth_out = np.clip(metres / CameraFrame.DEPTH_UNIT_M + 0.5, 0, 65535).astype(np.uint16)
        picture = np.array(np.asanyarray(frames.get_color_frame().get_data()))
        return CameraFrame(self.name, picture, depth_out, stream.intrinsics, pose, colour.get_timestamp() / 1000)

    def _next(self, deadline: float, why: str = "no picture came") -> Any:
        frames = self._source.wait(max(0.0, deadline - time.monotonic()))
        if frames is None or time.monotonic() > deadline:
            raise StaleError(
                f"camera '{self.name}' ({self._camera.serial}) gave nothing usable for {STALL_S:.0f} s: {why}",
                "check its cable; give each camera a USB controller of its own",
            )
        return frames

    def _require_stream(self) -> Stream:
        if self._stream is None:
            raise RobotError(f"camera '{self.name}' is not connected", "use it as `with RealSense(...) as camera:`")
        return self._stream


def matrix_of(intrinsics: Any) -> Float[np.ndarray, "3 3"]:
    """The camera matrix (px) of pyrealsense2's intrinsics."""
    i = intrinsics
    return np.array([[i.fx, 0.0, i.ppx], [0.0, i.fy, i.ppy], [0.0, 0.0, 1.0]])
