"""A recorded episode in place of a robot: the arm goes where it is sent, everything it sees and feels was recorded.

Its clock runs on setpoints, from the recording's first moment, and pads, pictures and objects are those of that moment;
a look takes it on to when the picture was taken, for a real arm waits while somebody computes. So the executive runs as
it did, and what it does otherwise today shows as a departure from what was sent then.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float

from resync_robot.core.episode import Episode, Joints, Picture
from resync_robot.core.errors import EpisodeError
from resync_robot.core.state import State
from resync_robot.core.world import CameraFrame, Cutout, Window
from resync_robot.hardware.base import SERVO_PERIOD, Connected, GripperState, RobotError, RobotState

HELD = 2e-3
"""m by which the recorded pads stood wider than asked for an object to have been between them."""
STILL_S, STILL = 0.1, 1e-3
"""s before and after, and m within which they did not move then: pads that are late stand wider, too."""


class ReplayGripper(Connected):
    """The recorded pads."""

    def __init__(self, robot: ReplayRobot) -> None:
        self._robot = robot

    def connect(self) -> None:
        pass

    def close(self) -> None:
        pass

    def state(self) -> GripperState:
        opening = self._robot.state().opening
        return GripperState(opening, opening > self._robot.asked + HELD)

    def move(self, opening: float) -> None:
        self._robot.asked = opening


class ReplayRobot(Connected):
    """A robot made of a recording.

    Args:
        episode: with at least one message of joints.

    Raises:
        EpisodeError: it has none.
    """

    def __init__(self, episode: Episode) -> None:
        self._joints: Sequence[Joints] = list(episode.joints())
        if not self._joints:
            raise EpisodeError(f"{episode.path} holds no joints to replay", "record one with resync-robot deploy")
        self._times = [j.time for j in self._joints]
        self._held = held(self._joints)
        forces = list(episode.tip_force())
        self._force_times, self._forces = [t for t, _ in forces], [f for _, f in forces]
        self.gripper = ReplayGripper(self)
        self.departure = 0.0
        """rad by which the setpoints have differed most from those of the recording at the same moment."""
        self._connected = False
        self._begin()

    def _begin(self) -> None:
        first = self._joints[0]
        self.time, self._q, self._qd = first.time, first.measured.copy(), np.zeros(6)
        self.asked = first.opening

    def connect(self) -> None:
        self._connected = True

    def close(self) -> None:
        self._connected = False

    @property
    def ended(self) -> bool:
        """The clock is past the last recorded moment."""
        return self.time > self._times[-1]

    def state(self) -> RobotState:
        self._require_connection()
        return RobotState(self.time, self._q.copy(), self._qd.copy(), self._force(), self._opening())

    def servo(self, q: Float[np.ndarray, "6"], opening: float) -> None:
        self._require_connection()
        self._qd = (q - self._q) / SERVO_PERIOD
        self._q, self.asked = np.array(q, dtype=np.float64), opening
        self.time += SERVO_PERIOD
        if not self.ended:
            self.departure = max(self.departure, float(np.abs(self._recorded().sent.arm - q).max()))

    def skip_to(self, time: float) -> None:
        """Let it be that moment (s) now, if it has not come yet."""
        self.time = max(self.time, time)

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        self._require_connection()

    def _row(self) -> int:
        return max(0, bisect_right(self._times, self.time + 1e-9) - 1)

    def _recorded(self) -> Joints:
        return self._joints[self._row()]

    def _opening(self) -> float:
        # Where nothing stood between the pads, they are where they are asked to be.
        return max(self.asked, self._recorded().opening) if self._held[self._row()] else self.asked

    def _force(self) -> np.ndarray:
        i = bisect_right(self._force_times, self.time + 1e-9) - 1
        return np.zeros(3) if i < 0 or self.ended else self._forces[i].copy()

    def _require_connection(self) -> None:
        if not self._connected:
            raise RobotError("the recording is not connected", "use it as `with ReplayRobot(episode) as robot:`")


def held(joints: Sequence[Joints]) -> Bool[np.ndarray, " n"]:
    """At which of these moments something stood between the pads."""
    times, opening = np.array([j.time for j in joints]), np.array([j.opening for j in joints])
    wider = opening > np.array([j.sent.opening for j in joints]) + HELD
    begins, ends = np.searchsorted(times, times - STILL_S), np.searchsorted(times, times + STILL_S, side="right")
    still = [np.ptp(opening[begin:end]) < STILL for begin, end in zip(begins, ends, strict=True)]
    return wider & np.array(still)


class ReplayCamera(Connected):
    """The recorded pictures of one camera, in order."""

    def __init__(self, episode: Episode, name: str, robot: ReplayRobot) -> None:
        self.name, self._robot, self._where = name, robot, episode.path
        self._pictures = [p for p in episode.pictures(name) if p.colour is not None and p.depth is not None]
        self._windows = list(episode.windows(name))
        self._taken = self._looked = 0

    def connect(self) -> None:
        pass

    def close(self) -> None:
        pass

    def capture(self) -> CameraFrame:
        """The next recorded picture. Raises RobotError when there is none left."""
        if self._taken >= len(self._pictures):
            raise RobotError(
                f"{self._where} has only {len(self._pictures)} pictures of camera '{self.name}'",
                "today's run looks more often than the recorded one did: see what it does otherwise",
            )
        picture = self._pictures[self._taken]
        self._taken += 1
        self._robot.skip_to(picture.time)
        return decode(picture)

    def cut_out(self, window: Window, size: int) -> Cutout:
        """The next recorded part of a picture, wherever the window is. Raises RobotError when there is none left."""
        if self._looked >= len(self._windows):
            raise RobotError(
                f"{self._where} has only {len(self._windows)} looks through camera '{self.name}' during a skill",
                "today's run looks more often, or the recorded one had --skills state: give that too",
            )
        time, png = self._windows[self._looked]
        self._looked += 1
        self._robot.skip_to(time)
        colour = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR) if png else None
        if colour is None or colour.shape != (size, size, 3):
            raise EpisodeError(
                f"{self._where}: the look through camera '{self.name}' at {time:.3f} s is not {size} px wide"
            )
        return Cutout(self.name, cv2.cvtColor(colour, cv2.COLOR_BGR2RGB), time)


class ReplayTruth:
    """The recorded objects at the robot's moment: the simulator's where there was one, else what was believed."""

    def __init__(self, episode: Episode, robot: ReplayRobot) -> None:
        self._robot = robot
        self._states = list(episode.truths()) or list(episode.states())
        if not self._states:
            raise EpisodeError(f"{episode.path} holds no states of objects", "record one with resync-robot deploy")
        self._times = [t for t, _ in self._states]

    def __call__(self) -> State:
        return self._states[max(0, bisect_right(self._times, self._robot.time + 1e-9) - 1)][1]


def decode(picture: Picture) -> CameraFrame:
    """A recorded picture as a camera gives it. Raises EpisodeError where its bytes are no picture."""
    colour = depth = None
    if picture.colour is not None and picture.depth is not None:
        colour = cv2.imdecode(np.frombuffer(picture.colour, np.uint8), cv2.IMREAD_COLOR)
        depth = cv2.imdecode(np.frombuffer(picture.depth, np.uint8), cv2.IMREAD_UNCHANGED)
    if colour is None or depth is None or depth.dtype != np.uint16 or depth.shape != colour.shape[:2]:
        raise EpisodeError(f"the picture of camera '{picture.camera}' at {picture.time:.3f} s cannot be decoded")
    return CameraFrame(
        picture.camera, cv2.cvtColor(colour, cv2.COLOR_BGR2RGB), depth, picture.intrinsics, picture.world_T_cam,
        picture.time,
    )  # fmt: skip
