"""What the executive of a recorded episode was told, to be told once more, in the order in which it asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from resync_robot.core.episode import Episode
from resync_robot.core.episode_records import Answer, Ask
from resync_robot.core.errors import EpisodeError, ResyncError
from resync_robot.core.joints import ARM_JOINTS, JointTarget
from resync_robot.core.state import State
from resync_robot.core.symbols import Type

ALIKE = 1e-3
"""rad of a joint, or m of the opening, by which a target may differ from the recorded one: the same program on another
processor rounds otherwise."""


class Departure(ResyncError):
    """Today's run does otherwise than the recorded one.

    Attributes:
        time: s of the episode, when.
        why: what it does, and what was done then.
    """

    def __init__(self, time: float, why: str) -> None:
        super().__init__(f"departed at {time:.2f} s, because {why}")
        self.time, self.why = time, why


class RecordingOverError(ResyncError):
    """All that was recorded has been told. The recorded run may have ended there, or broken off."""


class Answers:
    """What the executive of an episode was told, to be told once more.

    Raises:
        EpisodeError: the recording holds none.
    """

    def __init__(self, episode: Episode) -> None:
        self.path, self._types = episode.path, episode.types
        self._told = list(episode.answers())
        if not self._told:
            raise EpisodeError(
                f"{episode.path} does not hold what its executive was told, without which it cannot be replayed",
                "record one with this version:  resync-robot deploy",
            )
        self._given = 0
        self.first = self._told[0][1]
        # What is told of no moment of its own, such as a stop, has the time of what was told before it.
        timed = (answer.clock - time for time, answer in self._told if answer.ask in (Ask.MEASURE, Ask.PICTURE))
        self.begin = next(timed, 0.0)
        self.clock = self.begin
        """s on the recorded robot's clock, of the latest answer."""
        self.at = 0.0
        """s of the episode at which the last one lies in the recording, and with it the picture that it is about."""
        self.largest = 0.0
        """rad or m by which a target has differed most from the recorded one."""

    @property
    def now(self) -> float:
        """s of the episode."""
        return self.clock - self.begin

    @property
    def left(self) -> int:
        """How many have not been given yet."""
        return len(self._told) - self._given

    def stopped(self) -> str | None:
        """Why the robot stopped by itself next, and that is told; None where it goes on."""
        return str(self.take(Ask.STOP).details.get("reason")) if self._next_is(Ask.STOP) else None

    def take(self, ask: Ask, target: JointTarget | None = None, camera: str = "") -> Answer:
        """The next answer.

        Args:
            target: what the arm is being sent to, where that is to be what it was then.
            camera: of which a picture is asked.

        Raises:
            Departure: something else was asked next, or the arm was sent elsewhere.
            RecordingOverError: nothing was asked any more.
        """
        if not self.left:
            raise RecordingOverError(f"the recording ends at {self.now:.2f} s, and today's run {_words(ask, camera)}")
        at, answer = self._told[self._given]
        then = str(answer.details.get("camera", ""))
        # First what the arm was sent to: whoever is sent elsewhere asks otherwise soon, and nobody would see why.
        if target is not None and answer.ask is not Ask.REST:
            self._compare(target, answer.target)
        if (ask, camera) != (answer.ask, then):
            raise Departure(self.now, f"it {_words(ask, camera)}, where the recorded run {_words(answer.ask, then)}")
        self._given, self.at = self._given + 1, at
        self.clock = max(self.clock, answer.clock)
        return answer

    def content(self, answer: Answer) -> Content:
        """Its details, for reading."""
        return Content(answer, f"{self.path}: the answer of {self.now:.3f} s makes no sense", self._types)

    def _next_is(self, ask: Ask) -> bool:
        return bool(self.left) and self._told[self._given][1].ask is ask

    def _compare(self, today: JointTarget, then: JointTarget) -> None:
        difference = np.abs([*(today.arm - then.arm), today.opening - then.opening])
        worst = int(np.argmax(difference))
        if not difference[worst] <= ALIKE:
            if worst == len(ARM_JOINTS):
                told = f"{1000 * today.opening:.1f} mm, where it was told {1000 * then.opening:.1f} mm"
                why = f"the hand is told to open {told}"
            else:
                sent = f"{today.arm[worst]:.3f} rad, where it was sent to {then.arm[worst]:.3f}"
                why = f"{ARM_JOINTS[worst]} is sent to {sent}"
            raise Departure(self.now, why)
        self.largest = max(self.largest, float(difference[worst]))


class Content:
    """Reads an answer's details; raises EpisodeError for what is missing or of another kind."""

    def __init__(self, answer: Answer, what: str, types: Mapping[str, Type]) -> None:
        self._details, self._what, self._types = answer.details, what, types

    def vector(self, name: str, length: int) -> Float[np.ndarray, " n"]:
        return self._read(name, lambda value: np.array(value, dtype=np.float64).reshape(length))

    def number(self, name: str) -> float:
        return self._read(name, float)

    def flag(self, name: str) -> bool:
        return self._read(name, bool)

    def state(self, name: str) -> State:
        return self._read(name, lambda value: State.from_json(value, self._types))

    def _read(self, name: str, read: Callable[[Any], Any]) -> Any:
        try:
            return read(self._details[name])
        except (LookupError, TypeError, ValueError, AttributeError, ResyncError) as error:
            raise EpisodeError(f"{self._what}: {name}: {error}") from None


def _words(ask: Ask, camera: str) -> str:
    return f"{ask.value} of camera '{camera}'" if camera else ask.value
