"""A recorded episode in place of a robot: what the executive asks of the world is answered with what it was told then.

Answers come in the order in which they were given, and time is recorded time: nothing is simulated, the arm goes where
it went. So the executive, the policies and the perception of today run over the measurements of then. Whatever they ask
or want otherwise is a `Departure`, and the end: nobody knows what the world would have answered to that.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from resync_robot.core.episode import Episode
from resync_robot.core.episode_records import Ask, Joints, Picture
from resync_robot.core.errors import EpisodeError
from resync_robot.core.joints import JointTarget
from resync_robot.core.state import State
from resync_robot.core.world import CameraFrame, Cutout, Window
from resync_robot.hardware.answers import Answers, Departure
from resync_robot.hardware.base import Command, Connected, ProtectiveStopError, Recorder, RobotError, RobotState
from resync_robot.hardware.clearance import Obstacle


class ReplayArm(Connected):
    """The recorded arm and hand: a `Robot` that is measured as then, and `Motions` whose targets are compared with
    those of then.

    Args:
        episode: with at least one message of joints.

    Raises:
        EpisodeError: it has none.
    """

    timing = None

    def __init__(self, episode: Episode, answers: Answers) -> None:
        self._answers = answers
        self._joints = list(episode.joints())
        if not self._joints:
            raise EpisodeError(f"{episode.path} holds no joints to replay", "record one with resync-robot deploy")
        self._forces = dict(episode.tip_force())
        self._passed = 0
        self.recorders: list[Recorder] = []
        self._target = answers.first.target
        self._connected = False

    def connect(self) -> None:
        self._connected = True

    def close(self) -> None:
        self._connected = False

    def state(self) -> RobotState:
        """What was measured when this was asked then."""
        if not self._connected:
            raise RobotError("the recording is not connected", "use it as `with ReplayArm(episode, answers) as arm:`")
        answer = self._answers.take(Ask.MEASURE, self._target)
        told = self._answers.content(answer)
        self._pass_on()
        arm, velocity, force = told.vector("arm", 6), told.vector("velocity", 6), told.vector("force", 3)
        return RobotState(answer.clock, arm, velocity, force, told.number("opening"))

    def servo(self, q: Float[np.ndarray, "6"], opening: float) -> None:
        raise RobotError("a recording takes targets, and no setpoints", "send it targets with `run`")

    @property
    def target(self) -> JointTarget:
        return self._target

    def run(self, target: JointTarget, duration: float, travel: bool = False) -> None:
        """The target is compared with the recorded one when something is asked next."""
        self._raise_if_stopped()
        self._target = JointTarget(np.array(target.arm, dtype=np.float64), float(target.opening))

    def settle(self, tolerance: float = 2e-3, timeout: float = 3.0) -> bool:
        self._raise_if_stopped()
        return True

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        """The arm rests where it came to rest then."""
        self._raise_if_stopped()
        self.restart()

    def restart(self) -> None:
        self._target = self._answers.take(Ask.REST).target

    def keep_out(self, *obstacles: Obstacle) -> None:
        """Nothing moves that could touch them."""

    def _raise_if_stopped(self) -> None:
        if (why := self._answers.stopped()) is not None:
            raise ProtectiveStopError(why)

    def _pass_on(self) -> None:
        """Tell the recorders what was streamed meanwhile."""
        begin = self._answers.begin
        while self._passed < len(self._joints) and self._joints[self._passed].time <= self._answers.now:
            row = self._joints[self._passed]
            self._passed += 1
            state, command = _streamed(row, self._forces.get(row.time, np.zeros(3)), begin + row.time)
            for recorder in self.recorders:
                recorder(state, command)


def _streamed(row: Joints, force: np.ndarray, clock: float) -> tuple[RobotState, Command]:
    state = RobotState(clock, row.measured, row.velocity, force, row.opening)
    return state, Command(clock, row.requested, row.sent)


class ReplayCamera(Connected):
    """The recorded pictures of one camera, as they were asked for."""

    def __init__(self, episode: Episode, name: str, answers: Answers, arm: ReplayArm) -> None:
        self.name, self._answers, self._arm, self._where = name, answers, arm, episode.path
        self._pictures: Iterator[Picture] = episode.pictures(name)
        self._windows = episode.windows(name)

    def connect(self) -> None:
        pass

    def close(self) -> None:
        pass

    def capture(self) -> CameraFrame:
        """The picture that was taken here then. Raises Departure, RecordingOverError or EpisodeError."""
        answer = self._answers.take(Ask.PICTURE, self._arm.target, self.name)
        moment = self._answers.at
        picture = next((p for p in self._pictures if p.time == moment), None)
        if picture is None:
            raise EpisodeError(f"{self._where}: the picture of camera '{self.name}' of {moment:.3f} s is missing")
        return decode(picture, answer.clock)

    def cut_out(self, window: Window, size: int) -> Cutout:
        """The part of a picture that was looked at here then. Raises as `capture`."""
        answer = self._answers.take(Ask.PART, self._arm.target, self.name)
        time, png = next(self._windows, (0.0, b""))
        colour = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR) if png else None
        if colour is None:
            raise EpisodeError(f"{self._where}: what camera '{self.name}' was asked for after {time:.3f} s is missing")
        if colour.shape != (size, size, 3):
            raise Departure(
                self._answers.now,
                f"camera '{self.name}' is asked for {size} px, where it was asked for {len(colour)} px",
            )
        return Cutout(self.name, cv2.cvtColor(colour, cv2.COLOR_BGR2RGB), answer.clock)


class ReplayTruth:
    """Where the objects were: as it was told to a skill that follows them, and as it was recorded beside it."""

    def __init__(self, episode: Episode, answers: Answers, arm: ReplayArm) -> None:
        self._answers, self._arm = answers, arm
        self._states = list(episode.truths())
        self._times = [t for t, _ in self._states]

    @property
    def known(self) -> bool:
        """A simulator was there to ask."""
        return bool(self._states)

    def told(self) -> State:
        """What the executive was told when it asked this then."""
        return self._answers.content(self._answers.take(Ask.TRUTH, self._arm.target)).state("objects")

    def recorded(self) -> State:
        """What was recorded last before this moment."""
        row = bisect_right(self._times, self._answers.now + 1e-9) - 1
        return self._states[max(0, row)][1]


def replay_ready(answers: Answers) -> Callable[[Future[Any]], bool]:
    """`core.world.Ready` as it was then, however fast the policy thinks today."""

    def ready(thought: Future[Any]) -> bool:
        done = answers.content(answers.take(Ask.THOUGHT)).flag("done")
        if done:
            thought.exception()
        return done

    return ready


def decode(picture: Picture, clock: float) -> CameraFrame:
    """A recorded picture as the camera gave it at `clock`. Raises EpisodeError where its bytes are no picture."""
    colour = depth = None
    if picture.colour is not None and picture.depth is not None:
        colour = cv2.imdecode(np.frombuffer(picture.colour, np.uint8), cv2.IMREAD_COLOR)
        depth = cv2.imdecode(np.frombuffer(picture.depth, np.uint8), cv2.IMREAD_UNCHANGED)
    if colour is None or depth is None or depth.dtype != np.uint16 or depth.shape != colour.shape[:2]:
        raise EpisodeError(f"the picture of camera '{picture.camera}' at {picture.time:.3f} s cannot be decoded")
    return CameraFrame(
        picture.camera, cv2.cvtColor(colour, cv2.COLOR_BGR2RGB), depth, picture.intrinsics, picture.world_T_cam, clock
    )
