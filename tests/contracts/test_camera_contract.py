"""What every camera must give, whatever stands behind it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from resync_robot.core.episode import read_episode
from resync_robot.core.episode_records import Answer, Ask, EpisodeMeta
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import load_rig
from resync_robot.core.world import CameraFrame, Cutout, Glimpse, Window
from resync_robot.hardware.answers import Answers
from resync_robot.hardware.base import Camera, FilmedCamera, RobotError, WindowedCamera
from resync_robot.hardware.emulator.camera import EmulatedCamera
from resync_robot.hardware.realsense import RealSense
from resync_robot.hardware.realsense_device import load_pyrealsense2
from resync_robot.hardware.replay import ReplayArm, ReplayCamera
from resync_robot.hardware.sim import SimCamera
from tests.hardware.software_camera import HEIGHT, WIDTH, SoftwareSource

RIG = load_rig()
WRIST = replace(RIG.camera("wrist"), width=WIDTH, height=HEIGHT, fx=120.0, fy=120.0, cx=80.0, cy=60.0)
POSE = RIG.camera_pose(WRIST, RIG.arm.home)
WINDOW = Window(40.0, 30.0, 48.0, 48.0)


def frame(time: float) -> CameraFrame:
    colour, depth = np.full((HEIGHT, WIDTH, 3), 90, np.uint8), np.full((HEIGHT, WIDTH), 5000, np.uint16)
    return CameraFrame("wrist", colour, depth, WRIST.intrinsics, POSE, time)


class Physics:
    """Of a simulator, what a camera needs; and of an emulated lab."""

    def __init__(self) -> None:
        self.time = 0.0

    def render(self, camera: str) -> CameraFrame:
        self.time += 0.1
        return replace(frame(self.time), name=camera)

    def render_window(self, camera: str, window: Window, size: int, error: np.ndarray) -> Cutout:
        return Cutout(camera, np.full((size, size, 3), 90, np.uint8), self.time)

    def render_colour(self, camera: str) -> Glimpse:
        return Glimpse(camera, np.full((HEIGHT, WIDTH, 3), 90, np.uint8), self.time)

    def colour(self, camera: str) -> tuple[float, np.ndarray]:
        return self.time, self.render_colour(camera).colour

    def picture(self, camera: str) -> tuple[float, np.ndarray, np.ndarray]:
        seen = self.render(camera)
        return seen.time, seen.colour, seen.depth

    def window(self, camera: str, window: Window, size: int) -> tuple[float, np.ndarray]:
        return self.time, np.full((size, size, 3), 90, np.uint8)


@contextmanager
def sim() -> Iterator[Camera]:
    yield SimCamera(Physics(), "wrist")  # type: ignore[arg-type]


@contextmanager
def emulated() -> Iterator[Camera]:
    robot = SimpleNamespace(state=lambda: SimpleNamespace(q=RIG.arm.home))
    yield EmulatedCamera(Physics(), RIG, WRIST, robot)  # type: ignore[arg-type]


@contextmanager
def realsense() -> Iterator[Camera]:
    try:
        rs = load_pyrealsense2()
    except RobotError as error:
        pytest.skip(error.what)
    yield RealSense(WRIST, lambda: POSE, SoftwareSource(rs), warm_up=4)


@contextmanager
def replay(parts: bool = False) -> Iterator[Camera]:
    """Over a recording of whoever took three pictures, or looked at a part of one."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "episode.mcap"
        meta = EpisodeMeta.of(RIG, library_hash="", domain="", scenario="", goal="", seed=0, backend="sim")
        there = JointTarget(RIG.arm.home, 0.1)
        with EpisodeWriter(path, meta) as writer:
            writer.joints(0.0, RIG.arm.home, np.zeros(6), 0.1, there, there)
            for k in range(3):
                seen = frame(0.1 * k)
                writer.answer(Answer(Ask.PART if parts else Ask.PICTURE, seen.time, there, {"camera": "wrist"}))
                jpeg, png = (cv2.imencode(kind, x)[1] for kind, x in ((".jpg", seen.colour), (".png", seen.depth)))
                writer.picture(seen, jpeg.tobytes(), png.tobytes())
                part = np.full((16, 16, 3), 90, np.uint8)
                writer.window("wrist", seen.time, cv2.imencode(".png", part)[1].tobytes())
        episode = read_episode(path)
        answers = Answers(episode)
        yield ReplayCamera(episode, "wrist", answers, ReplayArm(episode, answers))


MADE = ("sim", "emulated", "realsense", "replay")


@pytest.fixture(params=[sim, emulated, realsense, replay], ids=lambda make: make.__name__)
def camera(request: pytest.FixtureRequest) -> Iterator[Camera]:
    make: Callable[[], object] = request.param
    with make() as made, made:  # type: ignore[attr-defined]
        yield made


def test_pictures_are_whole_aligned_and_in_order(camera: Camera) -> None:
    frames = [camera.capture() for _ in range(3)]
    for seen in frames:
        assert seen.name == camera.name == "wrist"
        assert (seen.colour.shape, seen.colour.dtype) == ((HEIGHT, WIDTH, 3), np.uint8)
        assert (seen.depth.shape, seen.depth.dtype) == ((HEIGHT, WIDTH), np.uint16)
        np.testing.assert_allclose(seen.intrinsics, WRIST.intrinsics)
        np.testing.assert_allclose(seen.world_T_cam, POSE, atol=1e-9)
        np.testing.assert_allclose(seen.colour[60, 80], 90, atol=2)
        assert seen.depth[60, 80] == pytest.approx(5000, rel=0.01), "0.5 m in units of 0.1 mm"
    times = [seen.time for seen in frames]
    assert times == sorted(times) and len(set(times)) == 3


def test_a_picture_belongs_to_whoever_asked(camera: Camera) -> None:
    first = camera.capture()
    kept = first.colour.copy()
    camera.capture()
    np.testing.assert_array_equal(first.colour, kept)


@pytest.mark.parametrize("make", [sim, emulated, realsense, partial(replay, parts=True)], ids=MADE)
def test_a_part_of_a_picture_has_the_size_asked_for(make: Callable[[], AbstractContextManager[Camera]]) -> None:
    with make() as camera, camera:
        check_part(camera)


@pytest.mark.parametrize("make", [sim, emulated, realsense], ids=MADE[:3])
def test_a_glimpse_shows_the_whole_picture_and_holds_up_nobody(
    make: Callable[[], AbstractContextManager[Camera]],
) -> None:
    with make() as camera, camera:
        before = camera.capture()
        assert isinstance(camera, FilmedCamera)
        seen = camera.glimpse()
        height, width = seen.colour.shape[:2]
        assert (seen.name, seen.colour.dtype) == ("wrist", np.uint8) and (height, width) == (HEIGHT, WIDTH)
        np.testing.assert_allclose(seen.colour[height // 2, width // 2], 90, atol=2)
        assert seen.time >= before.time - 0.2


def check_part(camera: Camera) -> None:
    assert isinstance(camera, WindowedCamera)
    part = camera.cut_out(WINDOW, 16)
    assert (part.name, part.colour.shape, part.colour.dtype) == ("wrist", (16, 16, 3), np.uint8)
    np.testing.assert_allclose(part.colour, 90, atol=2)
