"""A D435i that is none: pyrealsense2's software device, fed by hand, through the real syncer."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from resync_robot.hardware.base import RobotError
from resync_robot.hardware.realsense_device import Stream

WIDTH, HEIGHT = 160, 120
DEPTH_M = 0.5


class SoftwareSource:
    """A software device that gives a pair of pictures for every `wait`.

    Attributes:
        age_s: how old they are; `skew_s`: how much younger the depth is; `silent`: there are none; `gone`: unplugged.
    """

    def __init__(self, rs: Any, colour: int = 90, file: Path | None = None) -> None:
        self._rs, self._colour, self._number, self._file = rs, colour, 0, file
        self.age_s, self.skew_s, self.silent, self.gone, self.stopped = -0.005, 0.0, False, False, False

    def start(self) -> Stream:
        rs = self._rs
        self._begin = time.time()
        self._device = rs.software_device()
        intrinsics = rs.intrinsics()
        intrinsics.width, intrinsics.height = WIDTH, HEIGHT
        intrinsics.fx = intrinsics.fy = 120.0
        intrinsics.ppx, intrinsics.ppy = 80.0, 60.0
        intrinsics.model = rs.distortion.none
        self._sensors, self._profiles = {}, {}
        for uid, (name, kind, form, size) in enumerate(
            (("depth", rs.stream.depth, rs.format.z16, 2), ("colour", rs.stream.color, rs.format.rgb8, 3))
        ):
            sensor = self._device.add_sensor(name)
            stream = rs.video_stream()
            stream.type, stream.index, stream.uid, stream.width, stream.height = kind, 0, uid, WIDTH, HEIGHT
            stream.fps, stream.bpp, stream.fmt, stream.intrinsics = 30, size, form, intrinsics
            self._profiles[name] = rs.video_stream_profile(sensor.add_video_stream(stream))
            if name == "depth":
                sensor.add_read_only_option(rs.option.depth_units, 0.001)
            self._sensors[name] = sensor
        extrinsics = rs.extrinsics()
        extrinsics.rotation, extrinsics.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [0, 0, 0]
        self._profiles["depth"].register_extrinsics_to(self._profiles["colour"], extrinsics)
        self._device.create_matcher(rs.matchers.dlr_c)
        self._recorder = None if self._file is None else rs.recorder(str(self._file), self._device)
        running = self._sensors.values() if self._recorder is None else self._recorder.query_sensors()
        self._running = list(running)
        self._syncer = rs.syncer(8)
        for profile, sensor in zip(self._profiles.values(), self._running, strict=True):
            sensor.open(profile)
            sensor.start(self._syncer)
        return Stream(np.array([[120.0, 0, 80.0], [0, 120.0, 60.0], [0, 0, 1.0]]), 0.001, (WIDTH, HEIGHT))

    def wait(self, seconds: float) -> Any:
        if self.gone:
            raise RobotError("camera 123 is gone")
        if self.silent:
            time.sleep(0.01)
            return None
        rs = self._rs
        # At the rate that the profiles promise: the matcher goes by it.
        self._number += 1
        taken = self._begin + self._number / 30
        time.sleep(max(0.0, taken - time.time()))
        now = 1000 * (taken - self.age_s)
        depth = np.full((HEIGHT, WIDTH), round(DEPTH_M * 1000), np.uint16)
        colour = np.full((HEIGHT, WIDTH, 3), self._colour, np.uint8)
        for name, pixels, size, stamp in (
            ("depth", depth, 2, now + 1000 * self.skew_s),
            ("colour", colour, 3, now),
        ):
            frame = rs.software_video_frame()
            frame.pixels, frame.stride, frame.bpp = pixels, WIDTH * size, size
            frame.timestamp, frame.frame_number = stamp, self._number
            frame.domain = rs.timestamp_domain.global_time
            frame.profile = self._profiles[name]
            if name == "depth":
                frame.depth_units = 0.001
            self._sensors[name].on_video_frame(frame)
        found, frames = self._syncer.try_wait_for_frames(15)
        return frames if found else self.wait(seconds)

    def stop(self) -> None:
        self.stopped = True
        for sensor in self._running:
            sensor.stop()
            sensor.close()
        # A recorder finishes its file when it goes.
        del self._recorder, self._running
