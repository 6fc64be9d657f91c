"""A recording in place of a robot."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from resync_robot.core.episode import Episode, EpisodeMeta, read_episode
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.errors import EpisodeError
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.world import CameraFrame, Cutout, Window
from resync_robot.hardware.base import SERVO_PERIOD, Command, RobotError, RobotState
from resync_robot.hardware.replay import ReplayCamera, ReplayRobot, ReplayTruth
from resync_robot.recorder import Recorder
from tests import scenes

STILL = Command(0.0, JointTarget(np.zeros(6), 0.1), JointTarget(np.zeros(6), 0.1))


def write(path: Path, rig: Rig, joints: bool = True, pictures: int = 2) -> Episode:
    """An arm that turns its first joint by 0.1 rad in a second, and closes on an object of 60 mm half way."""
    meta = EpisodeMeta.of(rig, library_hash="", domain="d", scenario="s", goal="g", seed=0, backend="sim")
    state = scenes.scene({"b0": (0.0, 0.0)}).initial
    with EpisodeWriter(path, meta) as writer:
        for k in range(51 if joints else 0):
            time, q = 5.0 + 0.02 * k, rig.arm.home.copy()
            q[0] += 0.002 * k
            sent = JointTarget(q, 0.1 if k < 25 else 0.0)
            writer.joints(time, q, np.zeros(6), 0.1 if k < 25 else 0.06, sent, sent)
            writer.tip_force(time, np.array([0.0, 0.0, float(k)]))
            if k in (0, 40):
                moved = {o: state[o] + (0.1 * (k > 0) if o.name == "b0" else 0.0) for o in state}
                writer.truth(time, State(moved))
        for i in range(pictures):
            colour, depth = np.full((8, 10, 3), 40 * i, np.uint8), np.full((8, 10), 5000 + i, np.uint16)
            frame = CameraFrame("wrist", colour, depth, np.eye(3), np.eye(4), 5.0 + i)
            jpeg, png = (cv2.imencode(kind, x)[1].tobytes() for kind, x in ((".jpg", colour), (".png", depth)))
            writer.picture(frame, jpeg, png)
    return read_episode(path)


@pytest.fixture
def episode(tmp_path: Path, rig: Rig) -> Episode:
    return write(tmp_path / "e.mcap", rig)


def test_time_pads_forces_and_objects_are_those_of_the_moment(episode: Episode, rig: Rig) -> None:
    with ReplayRobot(episode) as robot:
        truth = ReplayTruth(episode, robot)
        block = next(o for o in truth() if o.name == "b0")
        begin = truth()[block][0]
        assert (robot.state().time, robot.state().opening) == (5.0, 0.1)
        for k in range(450):
            q = rig.arm.home.copy()
            q[0] += 0.002 * (k + 1) / 10
            robot.servo(q, 0.1 if k < 249 else 0.0)
        state = robot.state()
        assert state.time == pytest.approx(5.0 + 450 * SERVO_PERIOD)
        assert state.opening == 0.06
        assert robot.gripper.state().object_detected
        assert state.tip_force[2] == 45.0
        assert truth()[block][0] == pytest.approx(begin + 0.1)
        assert robot.departure < 0.0025


def test_pads_that_are_late_hold_nothing(tmp_path: Path, rig: Rig) -> None:
    meta = EpisodeMeta.of(rig, library_hash="", domain="d", scenario="s", goal="g", seed=0, backend="ur7e")
    with EpisodeWriter(tmp_path / "e.mcap", meta) as writer:
        for k in range(150):
            # Told to close at 0.15 m/s, they follow 0.1 s later, and meet an object of 30 mm.
            told, stand = (max(0.0, 0.1 - 0.003 * max(0, k - late)) for late in (0, 5))
            writer.joints(
                0.02 * k, rig.arm.home, np.zeros(6), max(stand, 0.03),
                JointTarget(rig.arm.home, told), JointTarget(rig.arm.home, 0.0),
            )  # fmt: skip
    episode = read_episode(tmp_path / "e.mcap")
    with ReplayRobot(episode) as robot:
        found = []
        for k in range(1490):
            robot.servo(rig.arm.home, max(0.0, 0.1 - 0.0003 * k))
            found.append(robot.gripper.state().object_detected)
    # 0.47 s until they are told less than 30 mm, 0.1 s of being late, and as long at rest.
    assert not any(found[: round(0.55 / SERVO_PERIOD)])
    assert all(found[round(0.8 / SERVO_PERIOD) :])


def test_a_look_takes_the_clock_on_to_when_the_picture_was_taken(episode: Episode, rig: Rig) -> None:
    with ReplayRobot(episode) as robot:
        camera = ReplayCamera(episode, "wrist", robot)
        camera.capture()
        assert robot.state().time == 5.0
        camera.capture()
        assert robot.state().time == 6.0
        robot.skip_to(5.5)
        assert robot.state().time == 6.0


def test_a_departure_from_the_recording_is_measured(episode: Episode, rig: Rig) -> None:
    with ReplayRobot(episode) as robot:
        robot.servo(rig.arm.home + 0.3, 0.1)
        assert robot.departure == pytest.approx(0.3)


def test_pictures_come_in_order_until_there_are_none(episode: Episode) -> None:
    with ReplayRobot(episode) as robot:
        camera = ReplayCamera(episode, "wrist", robot)
        frames = [camera.capture(), camera.capture()]
        assert [f.time for f in frames] == [5.0, 6.0]
        assert [int(f.depth[0, 0]) for f in frames] == [5000, 5001]
        with pytest.raises(RobotError, match="only 2 pictures"):
            camera.capture()


def test_looks_during_a_skill_come_back_bit_by_bit(tmp_path: Path, rig: Rig) -> None:
    rng = np.random.default_rng(0)
    meta = EpisodeMeta.of(rig, library_hash="", domain="d", scenario="s", goal="g", seed=0, backend="sim")
    looks = [Cutout("front", rng.integers(0, 255, (16, 16, 3), np.uint8), 0.1 * k) for k in range(3)]
    with EpisodeWriter(tmp_path / "e.mcap", meta) as writer:
        recorder = Recorder(writer, lambda: 0.0)
        for look in looks:
            recorder.on_look(look)
        recorder.on_stream(RobotState(0.0, rig.arm.home, np.zeros(6), np.zeros(3), 0.1), STILL)
    episode = read_episode(tmp_path / "e.mcap")
    camera = ReplayCamera(episode, "front", ReplayRobot(episode))
    for look in looks:
        seen = camera.cut_out(Window(0.0, 0.0, 9.0, 9.0), 16)
        np.testing.assert_array_equal(seen.colour, look.colour)
        assert seen.time == pytest.approx(look.time)
    with pytest.raises(RobotError, match="only 3 looks"):
        camera.cut_out(Window(0.0, 0.0, 9.0, 9.0), 16)
    again = ReplayCamera(episode, "front", ReplayRobot(episode))
    with pytest.raises(EpisodeError, match="is not 32 px wide"):
        again.cut_out(Window(0.0, 0.0, 9.0, 9.0), 32)


def test_a_recording_without_joints_or_objects_is_refused(tmp_path: Path, rig: Rig) -> None:
    empty = write(tmp_path / "n.mcap", rig, joints=False)
    with pytest.raises(EpisodeError, match="no joints"):
        ReplayRobot(empty)
