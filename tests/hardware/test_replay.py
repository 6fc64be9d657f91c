"""A recording in place of a robot: it tells once more what was told, and notices what is asked otherwise."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from resync_robot.core.episode import Episode, read_episode
from resync_robot.core.episode_records import Answer, Ask, EpisodeMeta
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.errors import EpisodeError
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.world import CameraFrame, Cutout, Window
from resync_robot.deployment.recorder import Recorder
from resync_robot.hardware.answers import Answers, Departure, RecordingOverError
from resync_robot.hardware.base import Command, ProtectiveStopError, RobotError, RobotState
from resync_robot.hardware.joint_moves import travel
from resync_robot.hardware.replay import (
    ReplayArm,
    ReplayCamera,
    ReplayTruth,
    replay_ready,
)
from tests import scenes

BEGIN = 5000.125
"""s on the controller's clock when the episode began: it has been on for a while."""
HOME = np.array([0.1, -1.5, 1.6, -1.7, -1.5, 0.2])
FIRST, SECOND, THIRD = (JointTarget(HOME + 0.1 * k, 0.1) for k in range(3))
STATE = scenes.scene({"b0": (0.0, 0.0)}).initial
WINDOW = Window(0.0, 0.0, 9.0, 9.0)


def measured(k: int, target: JointTarget) -> Answer:
    told = {"arm": HOME + 0.01 * k, "velocity": np.full(6, 0.1 * k), "force": np.full(3, float(k)), "opening": 0.06}
    return Answer(Ask.MEASURE, BEGIN + 0.05 * k, target, told)


class Writing:
    """A recording as a deployment writes it."""

    def __init__(self, path: Path, rig: Rig) -> None:
        meta = EpisodeMeta.of(rig, library_hash="", domain="d", scenario="s", goal="g", seed=0, backend="ur7e")
        self.path, self.writer = path, EpisodeWriter(path, meta, BEGIN)
        self.recorder = Recorder(self.writer, lambda: BEGIN)

    def told(self, *answers: Answer) -> Writing:
        for answer in answers:
            self.recorder.on_answer(answer)
        return self

    def streamed(self, count: int) -> Writing:
        for k in range(count):
            state = RobotState(BEGIN + 0.02 * k, HOME + 0.001 * k, np.zeros(6), np.full(3, float(k)), 0.1)
            self.recorder.on_stream(state, Command(state.time, SECOND, FIRST))
        return self

    def read(self) -> Episode:
        self.writer.close()
        return read_episode(self.path)


@pytest.fixture
def writing(tmp_path: Path, rig: Rig) -> Writing:
    return Writing(tmp_path / "e.mcap", rig)


def opened(episode: Episode) -> tuple[Answers, ReplayArm]:
    answers = Answers(episode)
    arm = ReplayArm(episode, answers)
    arm.connect()
    return answers, arm


def test_the_arm_is_measured_as_then_bit_by_bit_and_time_is_recorded_time(writing: Writing) -> None:
    told = [measured(0, FIRST), measured(1, SECOND)]
    answers, arm = opened(writing.told(*told).streamed(5).read())
    streamed: list[tuple[RobotState, Command]] = []
    arm.recorders.append(lambda state, command: streamed.append((state, command)))
    for k, target in enumerate((FIRST, SECOND)):
        if k:
            arm.run(target, 0.05)
        state = arm.state()
        for name, value in (("arm", state.q), ("velocity", state.qd), ("force", state.tip_force)):
            np.testing.assert_array_equal(value, told[k].details[name])
        assert (state.time, state.opening) == (BEGIN + 0.05 * k, 0.06)
        assert answers.clock == BEGIN + 0.05 * k and answers.now == pytest.approx(0.05 * k, abs=1e-9)
    # What was streamed until then is passed on, and no more.
    assert [round((s.time - BEGIN) / 0.02) for s, _ in streamed] == [0, 1, 2]
    np.testing.assert_array_equal(streamed[2][0].q, HOME + 0.002)
    np.testing.assert_array_equal(streamed[2][1].sent.arm, FIRST.arm)
    np.testing.assert_array_equal(streamed[2][0].tip_force, [2.0, 2.0, 2.0])
    assert answers.left == 0 and answers.largest == 0.0


def test_whoever_sends_the_arm_elsewhere_departs_and_is_told_which_joint(writing: Writing) -> None:
    episode = writing.told(measured(0, FIRST), measured(1, SECOND)).streamed(1).read()
    answers, arm = opened(episode)
    arm.state()
    arm.run(JointTarget(SECOND.arm + np.array([0, 0, 5e-4, 0, 0, 0]), 0.1), 0.05)
    arm.state()
    assert answers.largest == pytest.approx(5e-4), "which rounding may do"
    answers, arm = opened(episode)
    arm.state()
    arm.run(JointTarget(SECOND.arm + np.array([0, 0, 0.2, 0, 0, 0]), 0.1), 0.05)
    with pytest.raises(Departure, match=r"departed at 0\.00 s, because elbow_joint is sent to 1\.900 rad, .* 1\.700"):
        arm.state()
    answers, arm = opened(episode)
    arm.state()
    arm.run(JointTarget(SECOND.arm, 0.03), 0.05)
    with pytest.raises(Departure, match=r"told to open 30\.0 mm, where it was told 100\.0 mm"):
        arm.state()


def test_whoever_asks_otherwise_departs_and_whoever_asks_more_is_at_the_end(writing: Writing) -> None:
    episode = (
        writing.told(measured(0, FIRST), Answer(Ask.PART, BEGIN + 0.1, FIRST, {"camera": "side"})).streamed(1).read()
    )
    answers, arm = opened(episode)
    arm.state()
    with pytest.raises(Departure, match=r"measures the arm, where the recorded run looks at a part .* camera 'side'"):
        arm.state()
    with pytest.raises(Departure, match=r"camera 'front', where .* camera 'side'"):
        ReplayCamera(episode, "front", answers, arm).cut_out(WINDOW, 16)
    answers.take(Ask.PART, camera="side")
    with pytest.raises(RecordingOverError, match=r"ends at 0\.10 s, and today's run measures the arm"):
        arm.state()


def test_the_arm_rests_where_it_came_to_rest_then(writing: Writing) -> None:
    _, arm = opened(writing.told(measured(0, FIRST), Answer(Ask.REST, BEGIN, SECOND)).streamed(1).read())
    arm.state()
    # One that yielded to what it pressed on rests elsewhere than it was sent.
    arm.run(THIRD, 0.1)
    arm.limit_effort(None)
    np.testing.assert_array_equal(arm.target.arm, SECOND.arm)


def test_a_stop_of_the_robot_comes_again_and_so_does_its_release(writing: Writing) -> None:
    stop = Answer(Ask.STOP, BEGIN, FIRST, {"reason": "the robot made a protective stop"})
    episode = writing.told(measured(0, FIRST), stop, Answer(Ask.REST, BEGIN, SECOND)).streamed(1).read()
    for move in (
        lambda arm: arm.run(THIRD, 0.1),
        lambda arm: arm.limit_effort((1.0,) * 6),
        lambda arm: arm.settle(),
        lambda arm: travel(arm, THIRD.arm),
    ):
        _, arm = opened(episode)
        arm.state()
        with pytest.raises(ProtectiveStopError, match="protective stop"):
            move(arm)
        arm.restart()
        np.testing.assert_array_equal(arm.target.arm, SECOND.arm)


def frame(name: str, k: int) -> CameraFrame:
    rng = np.random.default_rng(k)
    colour, depth = rng.integers(0, 255, (24, 32, 3), np.uint8), rng.integers(0, 9999, (24, 32), np.uint16)
    pose = np.eye(4) + rng.random((4, 4)) * 1e-9
    return CameraFrame(name, colour, depth, np.eye(3) * np.pi, pose, BEGIN + 0.1 * k)


def test_pictures_come_back_bit_by_bit_whatever_was_filmed_or_thrown_away_beside_them(writing: Writing) -> None:
    asked = [frame("wrist", k) for k in range(3)]
    for k, seen in enumerate(asked):
        writing.writer.film("wrist", seen.time, b"\xff\xd8 for people")
        writing.recorder.on_picture(seen)
        if k != 1:  # A picture that nobody was told of is nobody's answer.
            writing.told(Answer(Ask.PICTURE, seen.time, FIRST, {"camera": "wrist"}))
    episode = writing.streamed(1).read()
    camera = ReplayCamera(episode, "wrist", *opened(episode))
    for then in (asked[0], asked[2]):
        seen = camera.capture()
        for name in ("colour", "depth", "intrinsics", "world_T_cam", "time"):
            np.testing.assert_array_equal(getattr(seen, name), getattr(then, name))
    with pytest.raises(RecordingOverError):
        camera.capture()
    assert [jpeg for _, jpeg in episode.film("wrist")] == [b"\xff\xd8 for people"] * 3


def test_looks_during_a_skill_come_back_bit_by_bit(writing: Writing) -> None:
    rng = np.random.default_rng(0)
    looks = [Cutout("front", rng.integers(0, 255, (16, 16, 3), np.uint8), BEGIN + 0.1 * k) for k in range(3)]
    for look in looks:
        writing.told(Answer(Ask.PART, look.time, FIRST, {"camera": "front"}))
        writing.recorder.on_look(look)
    episode = writing.streamed(1).read()
    camera = ReplayCamera(episode, "front", *opened(episode))
    for look in looks:
        seen = camera.cut_out(WINDOW, 16)
        np.testing.assert_array_equal(seen.colour, look.colour)
        assert seen.time == look.time
    again = ReplayCamera(episode, "front", *opened(episode))
    with pytest.raises(Departure, match="is asked for 32 px, where it was asked for 16 px"):
        again.cut_out(WINDOW, 32)


def test_a_thought_is_as_late_as_it_was_however_fast_this_machine_is(writing: Writing) -> None:
    done = [Answer(Ask.THOUGHT, BEGIN, FIRST, {"done": d}) for d in (False, True)]
    ready = replay_ready(Answers(writing.told(*done).streamed(1).read()))
    finished: Future[None] = Future()
    finished.set_result(None)
    assert not ready(finished)
    go_on = threading.Event()
    with ThreadPoolExecutor(1) as thread:
        slow = thread.submit(go_on.wait, 5.0)
        threading.Timer(0.05, go_on.set).start()
        assert ready(slow) and slow.done()


def test_objects_are_where_they_were_told_to_be_and_beside_that_where_they_were_recorded(writing: Writing) -> None:
    moved = [State({o: STATE[o] + (0.1 * k if o.name == "b0" else 0.0) for o in STATE}) for k in range(3)]
    for k in (0, 1):
        writing.writer.truth(BEGIN + 0.1 * k, moved[k])
    told = Answer(Ask.TRUTH, BEGIN + 0.2, FIRST, {"objects": moved[2].to_json()})
    episode = writing.told(measured(0, FIRST), told).streamed(1).read()
    answers, arm = opened(episode)
    truth = ReplayTruth(episode, answers, arm)
    arm.state()
    assert truth.known and truth.recorded() == moved[0]
    assert truth.told() == moved[2]
    assert truth.recorded() == moved[1]


def test_a_recording_without_answers_or_joints_is_refused(tmp_path: Path, rig: Rig) -> None:
    old = Writing(tmp_path / "o.mcap", rig).streamed(3).read()
    with pytest.raises(EpisodeError, match="does not hold what its executive was told"):
        Answers(old)
    still = Writing(tmp_path / "s.mcap", rig).told(measured(0, FIRST)).read()
    with pytest.raises(EpisodeError, match="holds no joints"):
        ReplayArm(still, Answers(still))


@pytest.mark.parametrize(
    ("answer", "ask"),
    [
        (Answer(Ask.MEASURE, BEGIN, FIRST, {"arm": [1.0]}), lambda answers, arm, episode: arm.state()),
        (Answer(Ask.MEASURE, BEGIN, FIRST), lambda answers, arm, episode: arm.state()),
        (Answer(Ask.THOUGHT, BEGIN, FIRST), lambda answers, arm, episode: replay_ready(answers)(Future())),
        (
            Answer(Ask.TRUTH, BEGIN, FIRST, {"objects": 3}),
            lambda answers, arm, episode: ReplayTruth(episode, answers, arm).told(),
        ),
        (
            Answer(Ask.PICTURE, BEGIN, FIRST, {"camera": "wrist"}),
            lambda answers, arm, episode: ReplayCamera(episode, "wrist", answers, arm).capture(),
        ),
        (
            Answer(Ask.PART, BEGIN, FIRST, {"camera": "wrist"}),
            lambda answers, arm, episode: ReplayCamera(episode, "wrist", answers, arm).cut_out(WINDOW, 16),
        ),
    ],
)
def test_an_answer_that_makes_no_sense_is_one_error(
    writing: Writing, answer: Answer, ask: Callable[[Answers, ReplayArm, Episode], object]
) -> None:
    episode = writing.told(answer).streamed(1).read()
    with pytest.raises(EpisodeError):
        ask(*opened(episode), episode)


def test_setpoints_and_closed_recordings_are_refused(writing: Writing) -> None:
    _, arm = opened(writing.told(measured(0, FIRST)).streamed(1).read())
    with pytest.raises(RobotError, match="takes targets"):
        arm.servo(HOME, 0.1)
    arm.close()
    with pytest.raises(RobotError, match="not connected"):
        arm.state()
