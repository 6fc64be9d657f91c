"""The camera driver on pyrealsense2's software device: the real syncer, filters and alignment, without a camera."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hardware.base import RobotError, StaleError
from hardware.realsense import PipelineSource, RealSense, Stream, load_pyrealsense2
from resync_robot.core.rig import CameraRig, Rig

WIDTH, HEIGHT = 160, 120
DEPTH_M = 0.5


@pytest.fixture
def rs() -> Any:
    try:
        return load_pyrealsense2()
    except RobotError as error:
        pytest.skip(error.what)


@pytest.fixture
def camera(rig: Rig) -> CameraRig:
    return replace(rig.camera("wrist"), width=WIDTH, height=HEIGHT, fx=120.0, fy=120.0, cx=80.0, cy=60.0)


class SoftwareSource:
    """A software device that gives a pair of pictures for every `wait`.

    Attributes:
        age_s: how old they are; `skew_s`: how much younger the depth is; `silent`: there are none.
    """

    def __init__(self, rs: Any, colour: int = 90) -> None:
        self._rs, self._colour, self._number = rs, colour, 0
        self.age_s, self.skew_s, self.silent, self.stopped = -0.005, 0.0, False, False

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
        self._syncer = rs.syncer(8)
        for name, sensor in self._sensors.items():
            sensor.open(self._profiles[name])
            sensor.start(self._syncer)
        return Stream(np.array([[120.0, 0, 80.0], [0, 120.0, 60.0], [0, 0, 1.0]]), 0.001, (WIDTH, HEIGHT))

    def wait(self, seconds: float) -> Any:
        if self.silent:
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
        for sensor in self._sensors.values():
            sensor.stop()
            sensor.close()


def test_a_picture_has_the_pixels_pose_and_intrinsics(rs: Any, camera: CameraRig) -> None:
    pose = np.eye(4)
    pose[2, 3] = 0.7
    source = SoftwareSource(rs)
    with RealSense(camera, lambda: pose, source, warm_up=4) as device:
        asked = time.time()
        frame = device.capture()
    assert source.stopped
    assert frame.name == "wrist" and frame.time >= asked
    assert frame.colour.shape == (HEIGHT, WIDTH, 3) and (frame.colour == 90).all()
    assert frame.depth.dtype == np.uint16
    middle = frame.depth[20:-20, 20:-20]
    np.testing.assert_allclose(middle, DEPTH_M / frame.DEPTH_UNIT_M, rtol=0.005)
    np.testing.assert_array_equal(frame.world_T_cam, pose)
    np.testing.assert_array_equal(frame.intrinsics, camera.intrinsics)


def test_no_pictures_is_one_error_in_time(rs: Any, camera: CameraRig) -> None:
    source = SoftwareSource(rs)
    with RealSense(camera, lambda: np.eye(4), source, warm_up=1) as device:
        source.silent = True
        with pytest.raises(StaleError, match="no picture came"):
            device.capture()


def test_old_pictures_are_not_passed_off_as_new(rs: Any, camera: CameraRig) -> None:
    source = SoftwareSource(rs)
    source.age_s = 30.0
    with RealSense(camera, lambda: np.eye(4), source, warm_up=4) as device:
        with pytest.raises(StaleError, match="older than the request"):
            device.capture()
        assert device.dropped > 0


def test_a_camera_that_delivers_another_size_is_named(rs: Any, camera: CameraRig) -> None:
    source = SoftwareSource(rs)
    with pytest.raises(RobotError, match="160 x 120 pixels, the rig says 848 x 480"):
        RealSense(replace(camera, width=848, height=480), lambda: np.eye(4), source).connect()
    assert source.stopped


def test_a_missing_serial_number_is_named(rs: Any) -> None:
    with pytest.raises(RobotError, match="no camera with serial number 123; connected: none"):
        PipelineSource("123", (848, 480)).start()


def test_without_the_package_the_command_is_named(camera: CameraRig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(RobotError, match="not installed"):
        RealSense(camera, lambda: np.eye(4)).connect()


def test_it_must_be_connected(camera: CameraRig) -> None:
    with pytest.raises(RobotError, match="not connected"):
        RealSense(camera, lambda: np.eye(4)).capture()
