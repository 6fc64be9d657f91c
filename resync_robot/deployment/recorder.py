"""Writes what happens in an episode of `plan_and_execute` into its recording."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence

import cv2
import numpy as np

from resync_robot.core.episode_records import Answer, EventKind, Timing
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.errors import ResyncError
from resync_robot.core.skill import GroundSkill, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, GroundOperator
from resync_robot.core.world import CameraFrame, Cutout, Glimpse
from resync_robot.hardware.base import Command, Halt, RobotState
from resync_robot.planning.execute import EpisodeEnd, Listener
from resync_robot.planning.search import Plan

_log = logging.getLogger(__name__)
CLOUD_POINTS = 6000
TRUTH_EVERY = 1.0
"""s between two moments at which an arm's simulator is asked where everything is."""
EARLY_S = 1e-6
"""By which a moment may come early, for sums of steps are rounded."""
JPEG_QUALITY = 80
"""Of films, which people look at."""


class Recorder(Listener):
    """Subscribes to the executive, the stream and the scans of one episode.

    Args:
        clock: seconds on the robot's clock now.
        truth: the simulator's own state, recorded under that name for comparison; None on a real robot.
        cameras: what each sees is filmed while the arm moves. Nobody who asks a camera for a picture gets another one
            for it, and a replay needs none of this.
        film_hz: how often.
        states_every: s between two moments at which `truth` is asked, and of which `on_seen` keeps the state.
        live: time goes on by itself, so `cameras` and `truth` are asked on the recording's thread, beside the stream;
            not while it is still busy with the time before.
        confirm: asked before each step.
        tell: called with a line for people at every plan and skill.
    """

    def __init__(
        self,
        writer: EpisodeWriter,
        clock: Callable[[], float],
        truth: Callable[[], State] | None = None,
        cameras: Sequence[Callable[[], Glimpse]] = (),
        film_hz: float = 10.0,
        states_every: float = TRUTH_EVERY,
        live: bool = False,
        confirm: Callable[[GroundOperator], bool] = lambda step: True,
        tell: Callable[[str], None] = lambda line: None,
    ) -> None:
        self._writer, self._clock, self._truth, self._confirm = writer, clock, truth, confirm
        self._cameras, self._period, self._next_look = cameras, 1.0 / film_hz, -math.inf
        self._next_truth, self._next_seen, self._states_every = -math.inf, -math.inf, states_every
        self._live, self._looking, self._over = live, False, False
        self.skills = 0
        """How many have ended."""
        self._steps: tuple[GroundOperator, ...] = ()
        self._reason = ""
        self._failed: dict[str, str] = {}
        self._tell = tell

    def on_stream(self, state: RobotState, command: Command) -> None:
        """Measured, requested and sent joints, at the stream's recording rate."""
        w = self._writer
        w.joints(state.time, state.q, state.qd, state.opening, command.sent, command.requested)
        w.tip_force(state.time, state.tip_force)
        self.on_moment(state.time)

    def on_moment(self, time: float) -> None:
        """The film and the truth, where they are due."""
        w = self._writer
        film = bool(self._cameras) and time + EARLY_S >= self._next_look
        truth = self._truth is not None and time + EARLY_S >= self._next_truth
        if (film or truth) and not self._looking:
            self._next_look = _due(self._next_look, self._period, time) if film else self._next_look
            self._next_truth = _due(self._next_truth, self._states_every, time) if truth else self._next_truth
            self._looking = True
            if self._live:
                w.defer(lambda: self._look_around(film, truth))
            else:
                self._look_around(film, truth)

    def _look_around(self, film: bool, truth: bool) -> None:
        """A camera in trouble is the business of whoever needs it; the recording goes on without its pictures."""
        try:
            for glimpse in self._cameras if film else ():
                if self._over:
                    return
                try:
                    self._film(glimpse())
                except ResyncError as error:
                    _log.warning("a picture is missing from the recording: %s", error.what)
            if truth and self._truth and not self._over:
                self._writer.truth(self._clock(), self._truth())
        except ResyncError as error:
            _log.warning("the truth is missing from the recording: %s", error.what)
        finally:
            self._looking = False

    def on_seen(self, state: State) -> None:
        """What a skill is told of everything while it runs."""
        now = self._clock()
        if now + EARLY_S >= self._next_seen:
            self._next_seen = _due(self._next_seen, self._states_every, now)
            self._writer.state(now, state)

    def on_answer(self, answer: Answer) -> None:
        """What the executive was told, for a replay."""
        self._writer.answer(answer)

    def on_picture(self, frame: CameraFrame) -> None:
        """A picture that was asked for; bit by bit, for a replay."""

        def encode() -> None:
            self._writer.picture(frame, _png(frame.colour[..., ::-1]), _png(frame.depth))

        self._writer.defer(encode)

    def on_look(self, part: Cutout) -> None:
        """What a skill looked at while it moved; bit by bit, for a replay."""

        def encode() -> None:
            self._writer.window(part.name, part.time, _png(part.colour[..., ::-1]))

        self._writer.defer(encode)

    def on_timing(self, timing: Timing) -> None:
        self._writer.timing(timing)

    def on_scan(self, frames: Sequence[CameraFrame], state: State) -> None:
        now = self._clock()
        self._writer.event(now, EventKind.SCAN, f"{len(frames)} views")
        xyz, rgb = cloud(frames)
        self._writer.points(now, xyz, rgb)

    def on_doubt(self, atoms: Mapping[Atom, float], looks: int) -> None:
        """What stays in doubt after so many looks: the share of pose samples in which each atom holds."""
        words = ", ".join(f"{atom} {share:.2f}" for atom, share in sorted(atoms.items()))
        details = {str(atom): share for atom, share in atoms.items()}
        self._writer.event(self._clock(), EventKind.DOUBT, f"after {looks} looks: {words}", shares=details)
        self._tell(f"  in doubt after {looks} looks, and not counted on: {words}")

    def on_unsettled(self, names: Sequence[str], words: str) -> None:
        """Objects that are not, or not well, where the belief has them."""
        self._writer.event(self._clock(), EventKind.DOUBT, words, objects=list(names))
        self._tell(f"  {words}; poses of {', '.join(names)} are rough")

    def on_perceived(self, state: State, atoms: Mapping[Atom, float]) -> None:
        now = self._clock()
        self._writer.state(now, state)
        self._writer.atoms(now, atoms)
        if self._truth:
            self._writer.truth(now, self._truth())

    def on_plan(self, plan: Plan, reason: str) -> None:
        if self._reason or self._steps:
            self._writer.event(self._clock(), EventKind.REPLAN, reason, **self._failed)
            self._failed = {}
        self._steps, self._reason = plan.steps, reason
        self._writer.plan(self._clock(), plan.steps, None, reason)
        self._tell(f"  plan ({reason}): {plan}")

    def on_step_of_plan(self, index: int) -> None:
        self._writer.plan(self._clock(), self._steps, index, self._reason)

    def on_skill_start(self, skill: GroundSkill) -> None:
        self._writer.event(self._clock(), EventKind.SKILL_START, str(skill))

    def on_skill_end(self, skill: GroundSkill, outcome: SkillOutcome) -> None:
        self.skills += 1
        words = f"{skill}: {outcome.ending.value}" + (f", {outcome.reason}" if outcome.reason else "")
        self._writer.event(self._clock(), EventKind.SKILL_END, words, ending=outcome.ending.value)
        self._tell(f"  {words}")

    def on_effects_missing(self, step: GroundOperator) -> None:
        # Told with the event that follows from it.
        self._failed = {"failed": str(step)}

    def on_end(self, end: EpisodeEnd, reason: str) -> None:
        kinds = {
            EpisodeEnd.GOAL: EventKind.GOAL,
            EpisodeEnd.PLANNED: EventKind.PLANNED,
            EpisodeEnd.STOPPED: EventKind.STOP,
        }
        self._writer.event(
            self._clock(), kinds.get(end, EventKind.GIVE_UP), reason or end.value, end=end.value, **self._failed
        )

    def let_go(self) -> None:
        """The robot and its cameras are about to be closed: what is still to be looked at is not."""
        self._over = True

    def on_halt(self, halt: Halt) -> None:
        """What is known of the robot once it has been let go."""
        kind = EventKind.HALTED if halt is Halt.STOPPED else EventKind.MAY_MOVE
        self._writer.event(self._clock(), kind, halt.value)

    def confirm(self, step: GroundOperator) -> bool:
        return self._confirm(step)

    def _film(self, seen: Glimpse) -> None:
        def encode() -> None:
            _, jpeg = cv2.imencode(".jpg", seen.colour[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
            self._writer.film(seen.name, seen.time, jpeg.tobytes())

        self._writer.defer(encode)


def _due(before: float, period: float, now: float) -> float:
    """When the next is due: `period` after the one before was, so that the pace is kept, unless that is past."""
    return before + period if before + period > now else now + period


def _png(picture: np.ndarray) -> bytes:
    """Fast rather than small, of blue, green, red or of one channel."""
    _, png = cv2.imencode(".png", np.ascontiguousarray(picture), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return png.tobytes()


def cloud(frames: Sequence[CameraFrame]) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) points in the world in m and (n, 3) uint8 colours, thinned evenly over the pictures."""
    points, colours = [], []
    for frame in frames:
        v, u = np.nonzero(frame.depth)
        keep = slice(None, None, max(1, len(v) * len(frames) // CLOUD_POINTS))
        v, u = v[keep], u[keep]
        z = frame.depth[v, u] * CameraFrame.DEPTH_UNIT_M
        k = frame.intrinsics
        local = np.stack([(u - k[0, 2]) / k[0, 0] * z, (v - k[1, 2]) / k[1, 1] * z, z], -1)
        points.append(local @ frame.world_T_cam[:3, :3].T + frame.world_T_cam[:3, 3])
        colours.append(frame.colour[v, u])
    return np.concatenate(points).astype(np.float32), np.concatenate(colours)
