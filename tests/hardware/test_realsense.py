"""The camera driver on pyrealsense2's software device: the real syncer, filters and alignment, without a camera."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from resync_robot.core.errors import PerceptionError
from resync_robot.core.rig import CameraRig, Rig
from resync_robot.core.world import Window
from resync_robot.hardware.base import RobotError, SkewError, StaleError, WindowedCamera
from resync_robot.hardware.realsense import FRESH_S, RealSense
from resync_robot.hardware.realsense_device import PipelineSource, load_pyrealsense2
from tests.hardware.software_camera import DEPTH_M, HEIGHT, WIDTH, SoftwareSource

WINDOW = Window(40.0, 30.0, 48.0, 48.0)


def succeeds(action: Callable[[], object]) -> bool:
    try:
        action()
    except RobotError:
        return False
    return True


def wait_until(condition: Callable[[], bool], seconds: float = 5.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline


@pytest.fixture
def rs() -> Any:
    try:
        return load_pyrealsense2()
    except RobotError as error:
        pytest.skip(error.what)


@pytest.fixture
def camera(rig: Rig) -> CameraRig:
    return replace(rig.camera("wrist"), width=WIDTH, height=HEIGHT, fx=120.0, fy=120.0, cx=80.0, cy=60.0)


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
    with RealSense(camera, lambda: np.eye(4), source, warm_up=4) as device:
        source.silent = True
        # One may be under way.
        time.sleep(0.1)
        with pytest.raises(StaleError, match=r"gave nothing usable for 1\.0 s: the newest was exposed"):
            device.capture()


def test_a_camera_that_never_gives_a_picture_does_not_connect(rs: Any, camera: CameraRig) -> None:
    source = SoftwareSource(rs)
    source.silent = True
    with pytest.raises(StaleError, match="no picture came"):
        RealSense(camera, lambda: np.eye(4), source).connect()
    assert source.stopped


def test_old_pictures_are_not_passed_off_as_new(rs: Any, camera: CameraRig) -> None:
    source = SoftwareSource(rs)
    source.age_s = 30.0
    with RealSense(camera, lambda: np.eye(4), source, warm_up=4) as device:
        with pytest.raises(StaleError, match=r"was exposed 3\d\.\d\d s ago"):
            device.capture()
        with pytest.raises(StaleError, match=r"was exposed 3\d\.\d\d s ago"):
            device.cut_out(WINDOW, 16)


def test_depth_and_colour_of_two_moments_are_no_picture(
    rs: Any, camera: CameraRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = SoftwareSource(rs)
    with RealSense(camera, lambda: np.eye(4), source, warm_up=4) as device:
        device.capture()
        # Less than half a frame: the syncer still pairs them.
        source.skew_s = 0.012
        device.capture()
        monkeypatch.setattr("resync_robot.hardware.realsense.MOST_SKEW_S", 0.010)
        with pytest.raises(SkewError, match="12 ms apart"):
            device.capture()
        assert device.dropped > 0


def test_a_part_of_the_newest_picture_is_there_at_once(rs: Any, camera: CameraRig) -> None:
    """Three cameras at 10 Hz, as a skill looks through them: nothing waits for an exposure."""
    sources = [SoftwareSource(rs, colour) for colour in (30, 60, 90)]
    now = time.time()
    with ExitStack() as stack:
        devices = [
            stack.enter_context(RealSense(camera, lambda: np.eye(4), source, lambda: time.time() - now, warm_up=4))
            for source in sources
        ]
        for device in devices:
            assert isinstance(device, WindowedCamera)
            device.cut_out(WINDOW, 16)
        took, ages = [], []
        for _ in range(10):
            begin = time.perf_counter()
            parts = [device.cut_out(WINDOW, 16) for device in devices]
            took.append(time.perf_counter() - begin)
            assert [int(part.colour[8, 8, 0]) for part in parts] == [30, 60, 90]
            ages += [time.time() - now - part.time for part in parts]
            time.sleep(0.05)
    assert np.median(took) < 0.03, "less than a frame for all three"
    # On the robot's clock, and never older than promised.
    assert max(ages) <= FRESH_S + max(took)
    assert min(ages) > -0.05


def test_a_camera_that_falls_silent_is_noticed_within_the_limit(rs: Any, camera: CameraRig) -> None:
    source = SoftwareSource(rs)
    with RealSense(camera, lambda: np.eye(4), source, warm_up=4) as device:
        device.cut_out(WINDOW, 16)
        source.silent = True
        begin = time.monotonic()
        with pytest.raises(StaleError, match=r"the newest was exposed 0\.[12]"):
            while True:
                device.cut_out(WINDOW, 16)
        assert time.monotonic() - begin < 2 * FRESH_S + 0.3
        source.silent = False
        wait_until(lambda: succeeds(lambda: device.cut_out(WINDOW, 16)))


def test_an_unplugged_camera_is_one_error_from_then_on(rs: Any, camera: CameraRig) -> None:
    source = SoftwareSource(rs)
    with RealSense(camera, lambda: np.eye(4), source, warm_up=4) as device:
        device.capture()
        source.gone = True
        for ask in (device.capture, lambda: device.cut_out(WINDOW, 16)):
            with pytest.raises(RobotError, match="camera 123 is gone"):
                while True:
                    ask()


def test_a_window_beside_the_picture_is_named(rs: Any, camera: CameraRig) -> None:
    with (
        RealSense(camera, lambda: np.eye(4), SoftwareSource(rs), warm_up=4) as device,
        pytest.raises(PerceptionError, match="shows nothing of a picture of 160 x 120"),
    ):
        device.cut_out(Window(WIDTH + 5.0, 10.0, 20.0, 20.0), 16)


def test_a_recording_plays_through_the_real_pipeline(rs: Any, camera: CameraRig, tmp_path: Path) -> None:
    source = SoftwareSource(rs, file=tmp_path / "camera.db3")
    source.start()
    for _ in range(30):
        source.wait(1.0)
    source.stop()
    played = PipelineSource("123", (WIDTH, HEIGHT), recording=tmp_path / "camera.db3")
    with RealSense(camera, lambda: np.eye(4), played, warm_up=2, fresh=False) as device:
        frame = device.capture()
        assert (device.cut_out(WINDOW, 16).colour == 90).all()
        with pytest.raises(StaleError):
            while True:
                device.capture()
    assert (frame.colour == 90).all()
    np.testing.assert_allclose(frame.depth[20:-20, 20:-20], DEPTH_M / frame.DEPTH_UNIT_M, rtol=0.005)


def test_a_camera_that_delivers_another_size_is_named(rs: Any, camera: CameraRig) -> None:
    source = SoftwareSource(rs)
    with pytest.raises(RobotError, match="160 x 120 pixels, the rig says 848 x 480"):
        RealSense(replace(camera, width=848, height=480), lambda: np.eye(4), source).connect()
    assert source.stopped


def test_a_missing_serial_number_is_named(rs: Any) -> None:
    said = r"no camera with serial number 123; connected: none(.|\n)*the serial in the rig file"
    with pytest.raises(RobotError, match=said):
        PipelineSource("123", (848, 480)).start()


def test_without_the_package_the_command_is_named(camera: CameraRig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(RobotError, match="not installed"):
        RealSense(camera, lambda: np.eye(4)).connect()


def test_it_must_be_connected(camera: CameraRig) -> None:
    with pytest.raises(RobotError, match="not connected"):
        RealSense(camera, lambda: np.eye(4)).capture()
