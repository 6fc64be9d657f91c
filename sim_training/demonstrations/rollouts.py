"""Recoveries rolled out: the teacher's, pushed off its path now and then, or taking over from a student that strayed.

What is recorded is what was executed: a policy that predicts chunks of actions cannot learn from labels that nobody
carried out. So variety comes from bursts that are not recorded, and each of them begins a segment of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from resync_robot.core.rig import Rig
from resync_robot.learning import camera_view, recovery_policy
from resync_robot.learning.camera_view import (
    DONE_IN_A_ROW,
    CameraPolicy,
    Chunks,
    Scanned,
    careful_steps,
    says_done,
    state_seen,
    to_hand,
)
from resync_robot.learning.recovery_policy import up_axis
from resync_robot.sim_training.demonstrations.recoveries import RenderedRecovery, Seen
from resync_robot.sim_training.demonstrations.starts import Start


@dataclass(frozen=True)
class Teacher:
    """A recovery that sees the exact state, as (n, 19) observations.

    Attributes:
        act: -> (n, 3) actions.
        done: -> (n,) is there nothing left to do? Its beta_N, which the planner's verdicts taught.
    """

    act: Callable[[Tensor], Tensor]
    done: Callable[[Tensor], Tensor]

    def judge(self, x: Tensor, margin: float = 0.0) -> list[Judgement]:
        """Of (n, 27) projected states: recovered in boxes that are narrower by `margin` m at every wall, free as they
        are."""
        with torch.no_grad():
            recovered, free = (self.done(recovery_policy.observe(_narrower(x, m))) for m in (margin, 0.0))
        return [Judgement(bool(r), bool(f)) for r, f in zip(recovered, free, strict=True)]


@dataclass(frozen=True)
class Judgement:
    """What a teacher says of a state: whether to stop there, and whether the failed skill would succeed there."""

    recovered: bool
    free: bool


@dataclass(frozen=True, kw_only=True)
class RolloutSettings:
    """In control steps of 0.1 s, lengths in m."""

    picture: int = camera_view.PICTURE
    """Pixels of a side of what is recorded."""
    horizon: int = 70
    """After so many steps with the teacher at the helm an episode counts as failed."""
    student_horizon: int = 80
    hold: int = 5
    """Steps at rest after success: what being done looks like."""
    burst_probability: float = 0.08
    """Of a burst in any step of the teacher's."""
    burst_steps: tuple[int, int] = (2, 6)
    burst_size: float = 0.02
    """Most motion a step in a burst, along each axis."""
    least_frames: int = 3
    drive: tuple[int, int] = (2, 60)
    """Steps after which the teacher takes over from a student, unless it is called before."""
    leaning: float = 0.995
    """Upward part of the block's upward axis below which the teacher is called: most of what goes wrong begins so."""
    margin: float = 0.008
    """m by which the box is narrower at every wall for the word that it is done. A student that sees gaps a few mm
    wrong would stop short of the line in half of its attempts if demonstrations ended on it. What the teacher acts on
    is the box as it is: in a narrower one a block at a wall would stand in the wall, which no policy has seen."""
    lag: float = recovery_policy.LAG
    """Most control steps that an arm is behind its commands."""
    unrecorded_noise: float = 0.0
    """m of noise on what is executed but not on what is recorded. Nothing to use: an ablation shows what it costs."""


@dataclass(frozen=True)
class Segment:
    """One stretch of a recovery as the robot saw and did it; n frames.

    Attributes:
        pictures: (n, views, p, p, 3).
        state: (n, 21), as in `camera_view.STATE_NAMES`.
        action: (n, 3) m, the step that followed the one under way.
        recovered: (n,) was it time to stop? A margin beyond where the failed skill begins to succeed.
        free: (n,) would the failed skill succeed?
        block: (n, 7), as in `camera_view.BLOCK_NAMES`.
        acts: (n,) is the action known? A still moment has none.
        ends: did it end with the recovery, rather than with a burst?
    """

    pictures: UInt8[np.ndarray, "n v p p 3"]
    state: Float[np.ndarray, "n s"]
    action: Float[np.ndarray, "n 3"]
    recovered: Bool[np.ndarray, " n"]
    free: Bool[np.ndarray, " n"]
    block: Float[np.ndarray, "n 7"]
    acts: Bool[np.ndarray, " n"]
    ends: bool


@dataclass(frozen=True)
class _Frame:
    """What was seen when a step began that was sent to `sent`, and where the teacher wanted it to go."""

    seen: Seen
    sent: np.ndarray
    wanted: np.ndarray
    judged: Judgement
    block: np.ndarray


@dataclass
class _Frames:
    """A segment that is being recorded."""

    taken: list[_Frame] = field(default_factory=list)

    def finish(self, yaw: float, scanned: Scanned, ends: bool) -> Segment:
        sent = np.stack([f.sent for f in self.taken])
        steps = np.stack([f.wanted for f in self.taken])[1:] - sent[:-1]
        # After the end the hand rests; before a burst nobody knows what the step after the last would have been.
        steps, count = (np.vstack([steps, np.zeros(3)]), len(sent)) if ends else (steps, len(sent) - 1)
        return Segment(
            np.stack([f.seen.pictures for f in self.taken[:count]]),
            np.stack(
                [state_seen(f.seen.q, f.seen.tip, f.sent, yaw, scanned, f.seen.carried) for f in self.taken[:count]]
            ),
            to_hand(steps, yaw).astype(np.float32),
            np.array([f.judged.recovered for f in self.taken[:count]]),
            np.array([f.judged.free for f in self.taken[:count]]),
            np.stack([f.block for f in self.taken[:count]]).astype(np.float32),
            np.ones(count, dtype=bool),
            ends,
        )


class _Run:
    """One scene, who is at the helm, and what was recorded."""

    def __init__(self, scene: RenderedRecovery, s: RolloutSettings, student_steps: int, seed: int) -> None:
        self.scene, self.s, self.rng = scene, s, np.random.default_rng([seed, 53])
        self.student_left, self.taught, self.held, self.burst_left = student_steps, 0, 0, 0
        self.frames, self.segments = _Frames(), list[Segment]()
        self.led_by: _Frame | None = None
        self.goal = scene.sent
        self.over = not scene.stands
        self.success = False
        self.push = np.zeros(3)
        self.chunks = Chunks()
        self.said_done = 0

    @property
    def with_student(self) -> bool:
        return not self.over and self.student_left > 0

    def call_teacher(self) -> None:
        """End the student's drive where it goes wrong, or believes that it is done."""
        if self.said_done >= DONE_IN_A_ROW or float(up_axis(self.scene.x)[0, 2]) < self.s.leaning:
            self.student_left = 0

    def lead_in(self, seen: Seen, judged: Judgement) -> None:
        """Remember the step that begins now, which is not the teacher's. If the teacher's follows, the segment begins
        with this one: what to do next when somebody else's step is under way is what a student has to know most of
        all, first of all at the start, where the hand is at rest.
        """
        self.led_by = _Frame(seen, np.array(self.goal), np.array(self.goal), judged, self.scene.block())

    def close_segment(self, ends: bool) -> None:
        if len(self.frames.taken) > self.s.least_frames:
            self.segments.append(self.frames.finish(self.scene.yaw, self.scene.scanned, ends))
        self.frames, self.led_by = _Frames(), None

    def teach(self, action: Tensor, judged: Judgement) -> None:
        """Decide where the tip goes in this step, and record it."""
        scene, s = self.scene, self.s
        if self.burst_left > 0:
            self.burst_left -= 1
            self.goal = scene.reach(scene.sent + self.push)
            self.lead_in(scene.see(), judged)
            return
        if not self.frames.taken:
            if self.led_by is None:
                self.goal = scene.sent
                self.lead_in(scene.see(), judged)
                return
            self.frames.taken.append(self.led_by)
        if self.held > 0:
            # It stays finished where the block comes to rest a little nearer to a wall.
            judged = replace(judged, recovered=judged.free)
        if self.held == 0 and not judged.recovered and self.taught > 1 and self.rng.random() < s.burst_probability:
            self.close_segment(ends=False)
            self.burst_left = int(self.rng.integers(*s.burst_steps))
            self.push = self.rng.uniform(-s.burst_size, s.burst_size, 3)
            self.goal = scene.reach(scene.sent + self.push)
            self.lead_in(scene.see(), judged)
            return
        if judged.recovered or self.held > 0:
            self.held += 1
            self.goal = scene.sent
        else:
            self.goal = recovery_policy.commanded_tip(scene.x, action[None])[0].double().numpy()
        wanted = self.goal
        if s.unrecorded_noise and self.held == 0:
            self.goal = scene.reach(wanted + self.rng.normal(0.0, s.unrecorded_noise, 3))
        self.frames.taken.append(_Frame(scene.see(), np.array(self.goal), np.array(wanted), judged, scene.block()))
        self.taught += 1
        if self.held > s.hold:
            self.success, self.over = judged.free, True
            self.close_segment(ends=True)
        elif self.taught > s.horizon:
            self.over = True


def demonstrate(
    starts: Sequence[Start],
    rig: Rig,
    teacher: Teacher,
    seed: int,
    student: CameraPolicy | None = None,
    settings: RolloutSettings | None = None,
) -> list[list[Segment]]:
    """For each start the segments of a successful recovery; none where the teacher failed or the scene fell over.

    Args:
        student: drives first, for a drawn number of steps or until it goes wrong; the teacher takes over from there.
    """
    s = settings or RolloutSettings()
    rng = np.random.default_rng([seed, 59])
    runs = []
    for i, start in enumerate(starts):
        steps = 0 if student is None else int(rng.integers(*s.drive))
        runs.append(_Run(RenderedRecovery(start, rig, s.lag, seed + i, s.picture), s, steps, seed + i))
    while any(not r.over for r in runs):
        driven = [r for r in runs if r.with_student]
        if student is not None:
            seen = _advance_students(driven, student)
            for r, o in zip(driven, seen, strict=True):
                r.lead_in(o, teacher.judge(r.scene.x, s.margin)[0])
                r.call_teacher()
        taught = [r for r in runs if not r.over and r not in driven]
        if taught:
            x = torch.cat([r.scene.x for r in taught])
            with torch.no_grad():
                actions = teacher.act(recovery_policy.observe(x))
            for r, action, judged in zip(taught, actions, teacher.judge(x, s.margin), strict=True):
                r.teach(action, judged)
        for r in runs:
            if not r.over:
                r.scene.step(r.goal)
            r.student_left -= 1
    return [r.segments if r.success else [] for r in runs]


def _narrower(x: Tensor, margin: float) -> Tensor:
    """(n, 27) the same projected states in a box whose walls stand `margin` further inside."""
    x = x.clone()
    x[:, recovery_policy.BOX][:, 7:9] -= 2 * margin
    return x


def look_around(
    starts: Sequence[Start],
    rig: Rig,
    teacher: Teacher,
    seed: int,
    each: int = 3,
    settings: RolloutSettings | None = None,
) -> Segment | None:
    """Moments without motion, for what tells a recovery that is done from one that is not: `each` of every start.

    They cost a tenth of a recovery, and every start is another world to see. None where all scenes fell over.
    """
    random = torch.Generator().manual_seed(seed)
    s = settings or RolloutSettings()
    found: list[tuple[np.ndarray, np.ndarray, Judgement, np.ndarray]] = []
    for i, start in enumerate(starts):
        scene = RenderedRecovery(start, rig, s.lag, seed + i, s.picture)
        for _ in range(each if scene.stands else 0):
            scene.freeze(random)
            seen = scene.see()
            state = state_seen(seen.q, seen.tip, scene.sent, scene.yaw, scene.scanned, seen.carried)
            found.append((seen.pictures, state, teacher.judge(scene.x, s.margin)[0], scene.block()))
    if not found:
        return None
    n = len(found)
    pictures, states, judged, blocks = zip(*found, strict=True)
    return Segment(
        np.stack(pictures),
        np.stack(states),
        np.zeros((n, 3), dtype=np.float32),
        np.array([j.recovered for j in judged]),
        np.array([j.free for j in judged]),
        np.stack(blocks).astype(np.float32),
        np.zeros(n, dtype=bool),
        ends=False,
    )


def _advance_students(runs: Sequence[_Run], student: CameraPolicy) -> list[Seen]:
    """The next step of every run with a student at the helm: `goal` is what is under way, chunks say what follows.
    Returns what each of them sees as it begins.
    """
    for r in runs:
        r.goal = r.scene.reach(r.scene.sent + camera_view.from_hand(r.chunks.next(), r.scene.yaw))
    # Everybody looks at every step: a late camera is late by one step, however often it is asked.
    seen = [r.scene.see() for r in runs]
    asking = [(r, o) for r, o in zip(runs, seen, strict=True) if r.chunks.wanting]
    if not asking:
        return seen
    states = [state_seen(o.q, o.tip, r.goal, r.scene.yaw, r.scene.scanned, o.carried) for r, o in asking]
    said = student(np.stack([o.pictures for _, o in asking]), np.stack(states))
    for (r, _), steps, done in zip(asking, careful_steps(said), says_done(said), strict=True):
        r.chunks.push(steps)
        r.said_done = r.said_done + 1 if done else 0
    return seen


@dataclass(frozen=True)
class Trial:
    """How a policy alone did from one start.

    Attributes:
        recovered: at the end, as beta_N says of the exact state.
        stopped: it said by itself that it was done.
        steps: control steps until then.
    """

    recovered: bool
    stopped: bool
    steps: int

    @property
    def success(self) -> bool:
        return self.recovered and self.stopped


def try_student(
    starts: Sequence[Start],
    rig: Rig,
    student: CameraPolicy,
    teacher: Teacher,
    seed: int,
    settings: RolloutSettings | None = None,
) -> list[Trial | None]:
    """The student alone, stopped by its own word, as it is deployed; None where a scene fell over at once."""
    s = settings or RolloutSettings()
    runs = [
        _Run(RenderedRecovery(start, rig, s.lag, seed + i, student.picture), s, s.student_horizon, seed + i)
        for i, start in enumerate(starts)
    ]
    trials: list[Trial | None] = [None] * len(runs)
    for step in range(s.student_horizon):
        _advance_students([r for r in runs if not r.over], student)
        for i, r in enumerate(runs):
            if r.over:
                continue
            stopped = r.said_done >= DONE_IN_A_ROW
            if stopped or step == s.student_horizon - 1:
                trials[i], r.over = Trial(teacher.judge(r.scene.x)[0].free, stopped, step), True
            else:
                r.scene.step(r.goal)
    return trials
