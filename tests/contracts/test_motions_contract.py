"""What every feeder of an arm must do for a deployed world, over a robot or over a recording of one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from resync_robot.core.episode import read_episode
from resync_robot.core.episode_records import Answer, Ask, EpisodeMeta
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig, load_rig
from resync_robot.deployment.recorder import Recorder
from resync_robot.hardware.answers import Answers
from resync_robot.hardware.base import Command, Motions, Robot, RobotState
from resync_robot.hardware.emulator.arm import KinematicArm
from resync_robot.hardware.joint_moves import travel
from resync_robot.hardware.replay import ReplayArm
from resync_robot.hardware.sim import SimRobot
from resync_robot.hardware.stream import Stream
from tests.contracts.conftest import KinematicPhysics

Tell = Callable[[Ask, RobotState | None], None]


def drive(robot: Robot, motions: Motions, rig: Rig, tell: Tell) -> list[RobotState]:
    """Whatever a deployed world does with an arm; the targets that it builds on what it hears."""
    seen: list[RobotState] = []

    def measure() -> RobotState:
        seen.append(robot.state())
        tell(Ask.MEASURE, seen[-1])
        return seen[-1]

    np.testing.assert_array_equal(motions.target.arm, measure().q)
    travel(motions, rig.arm.home + 0.1)
    np.testing.assert_array_equal(motions.target.arm, rig.arm.home + 0.1)
    measure()
    motions.keep_out()
    for limit in ((40.0, 40.0, 40.0, 12.0, 12.0, 12.0), None):
        motions.limit_effort(limit)
        tell(Ask.REST, None)
        for k in range(5):
            q = motions.target.arm + 0.001 * (measure().q - motions.target.arm) + 0.002
            motions.run(JointTarget(q, 0.1 - 0.005 * k), 0.05)
            np.testing.assert_array_equal(motions.target.arm, q)
    measure()
    return seen


def test_a_recording_of_a_drive_is_driven_in_the_same_way(tmp_path: Path) -> None:
    path, rig = tmp_path / "e.mcap", load_rig()
    meta = EpisodeMeta.of(rig, library_hash="", domain="", scenario="", goal="", seed=0, backend="sim")
    streamed: list[tuple[float, np.ndarray]] = []
    with SimRobot(KinematicPhysics(KinematicArm(rig.arm.home, 0.1))) as robot, EpisodeWriter(path, meta) as writer:
        stream, recorder = Stream(robot, rig), Recorder(writer, lambda: robot.state().time)
        stream.recorders += [recorder.on_stream, lambda state, command: streamed.append((state.time, state.q))]

        def tell(ask: Ask, state: RobotState | None) -> None:
            told = {} if state is None else {
                "arm": state.q, "velocity": state.qd, "force": state.tip_force, "opening": state.opening
            }  # fmt: skip
            recorder.on_answer(Answer(ask, robot.state().time, stream.target, told))

        first = drive(robot, stream, rig, tell)
    episode = read_episode(path)
    answers = Answers(episode)
    again: list[tuple[float, np.ndarray]] = []

    def record(state: RobotState, command: Command) -> None:
        again.append((state.time, state.q))

    with ReplayArm(episode, answers) as arm:
        arm.recorders.append(record)
        second = drive(arm, arm, rig, lambda ask, state: None)
    assert len(first) == len(second) and answers.left == 0 and answers.largest == 0.0
    for then, now in zip(first, second, strict=True):
        assert (then.time, then.opening) == (now.time, now.opening)
        for name in ("q", "qd", "tip_force"):
            np.testing.assert_array_equal(getattr(then, name), getattr(now, name))
    # A recording counts in nanoseconds.
    assert [t for t, _ in again] == pytest.approx([t for t, _ in streamed], abs=1e-9) and len(again) > 40
    np.testing.assert_array_equal([q for _, q in again], [q for _, q in streamed])
