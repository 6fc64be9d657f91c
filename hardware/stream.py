"""From targets at the skill's rate (10-50 Hz) to setpoints at 500 Hz, within velocity, acceleration and jerk limits.

Each target starts one time-optimal, jerk-limited trajectory from the last COMMANDED position, velocity and
acceleration (a measured pose would feed the tracking error back), so there is no jump where targets meet. The arm is
asked to arrive with the speed at which the targets move, but no faster than it can stop from within OVERSHOOT.
Why, measured on the simulated rig's limits: arriving with the full speed overshoots a target that stops by 37 mrad
at 0.5 rad/s and 9 mrad at 0.2 rad/s; arriving at rest makes slow 10 Hz targets stop and go (velocity ripple 67 % at
0.1 rad/s, 33 % this way). What remains is a lag: 14 ms on a ramp of 0.05 rad/s, 49 ms at 0.2, 63 ms for 0.05 rad
every 0.1 s (at 8 rad/s^2 and 80 rad/s^3).

A policy that was trained without that lag does not survive it: such a recovery succeeded in 6 of 20 worlds at
8 rad/s^2 and 200 rad/s^3. Trained with an arm that is up to 90 ms late, it succeeds in 20 of 20 there, at the simulated
rig's 12 and 500, and at 20 and 1500.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from resync_robot.core.episode_records import Timing
from resync_robot.core.errors import MotionError
from resync_robot.core.joints import ARM_JOINTS, JointTarget
from resync_robot.core.rig import Rig
from resync_robot.hardware.base import (
    SERVO_PERIOD,
    Command,
    RealtimeRobot,
    Recorder,
    Robot,
    RobotError,
    SafetyError,
    StarvedError,
)
from resync_robot.hardware.clearance import Obstacle
from resync_robot.hardware.generator import Generator, Motion, Way
from resync_robot.hardware.safety import FIRST_RUN_SPEED, Guard

OVERSHOOT = 1e-3
"""rad; 0.8 mm at the tip of the stretched arm."""
JUMP_SLACK = 0.05
"""rad by which a target may lie further from the one before than the arm gets at its fastest: lag, and targets that
are built on the measured pose. Anything further is a mistake of the caller, not a step of a skill."""
MOST_TICKS = 30_000
"""For one target; 60 s."""
PIECE = 50
"""Setpoints that a robot in real time is given at once, 0.1 s, each with a way to rest from there: it brakes as soon
as that when this process lets go of it or dies, however long the target takes."""
MAX_LATENESS = 20
"""How often one target may come too late for the robot before that is an error."""
FIRST_RUN_PACE = 0.25
"""Share of every speed until the motions have been confirmed at a machine. The path is the same, in more time."""
PACE_MARGIN = 0.8
"""Of the tip's speed limit then, at which a target is given still more time: the guard holds the limit itself."""
PRESSING_SPEED = 0.12
"""m/s of the tip of an arm that yields, which takes back what it ran ahead only as fast as its limits allow. At
0.2 m/s the simulated arm hit a block with 350 N within 10 ms, before any setpoint could answer. In the air it holds as
well: travelling at 0.25 m/s the arm yielded to what accelerated it, and left its path by 9 cm."""
FALLING = 0.99
"""Share of its excess speed that a target must fall below when it is given more time, to be given still more."""
STILL = 0.02
"""rad/s below which a settled joint counts as at rest."""


@dataclass(frozen=True)
class _Piece:
    """Setpoints `begin` to `end` (excluded) of a target, the motion at their end, and the way to rest from there."""

    begin: int
    end: int
    after: Motion
    stop: Float[np.ndarray, "m 6"]


class Stream:
    """Feeds one robot. Not thread-safe: one skill drives at a time.

    Args:
        robot: a connected robot; it is taken where it stands, at rest.
        rig: limits, mounting and gripper.
        recorders: called `record_hz` times a second with the measurement and the command of that moment.
        gripper_speed: m/s at which the opening changes, within what the gripper can do.
        guard: the safety gate, where other heights than the default are wanted.
    """

    def __init__(
        self,
        robot: Robot,
        rig: Rig,
        *,
        recorders: list[Recorder] | None = None,
        record_hz: float = 50.0,
        gripper_speed: float = 0.15,
        guard: Guard | None = None,
    ) -> None:
        least, most = rig.gripper.facts.speed
        if not least <= gripper_speed <= most:
            raise MotionError(f"gripper speed {gripper_speed} m/s; allowed: {least} to {most} m/s")
        if not 1.0 <= record_hz <= 1.0 / SERVO_PERIOD:
            raise MotionError(f"recording at {record_hz} Hz; allowed: 1 to {1 / SERVO_PERIOD:.0f} Hz")
        self.recorders: list[Recorder] = list(recorders or [])
        self._robot = robot
        self._realtime = robot if isinstance(robot, RealtimeRobot) else None
        self.late = 0
        """How often the arm braked because a target came too late; only a robot in real time can."""
        self.timing: Timing | None = None
        """Of the last target that `run` was given."""
        self._guard = guard or Guard(robot, rig)
        self._record_every = round(1.0 / record_hz / SERVO_PERIOD)
        self._since_record = 0
        self._gripper_step = gripper_speed * SERVO_PERIOD
        self._arm = rig.arm
        slow = rig.controller is not None and not rig.controller.full_speed
        self._pace = FIRST_RUN_PACE if slow else 1.0
        self._first_run = FIRST_RUN_SPEED if slow else np.inf
        self._fastest = self._first_run
        self._generator = Generator(rig.arm, self._pace)
        # Stopping from v at jerk j takes the distance v * sqrt(v / j), hence the fastest v for OVERSHOOT.
        self._arrival_limit = self._pace * np.minimum(
            (OVERSHOOT * np.sqrt(rig.arm.jerk_limit)) ** (2.0 / 3.0), rig.arm.velocity_limit
        )
        self.restart()

    def keep_out(self, *obstacles: Obstacle) -> None:
        """See `Guard.keep_out`."""
        self._guard.keep_out(*obstacles)

    def restart(self) -> None:
        """Begin again where the robot is measured, at rest: after a stop that this stream did not command."""
        self._guard.start()
        self._rest()

    def _rest(self) -> None:
        here = self._guard.last_sent
        self._motion = Motion(here, np.zeros(6), np.zeros(6))
        self._target = JointTarget(here.copy(), self._guard.last_opening)
        self._target_velocity = np.zeros(6)

    @property
    def target(self) -> JointTarget:
        """The last target asked for."""
        return self._target

    def run(self, target: JointTarget, duration: float, travel: bool = False) -> Command:
        """Move towards `target` for `duration` seconds of robot time; blocks until its last setpoint is sent.

        A controller that runs at a fraction of full speed (slider, reduced mode) gets the same path in more time.

        Args:
            travel: the target may lie anywhere; otherwise one that no arm could reach in `duration` is refused.

        Returns:
            The last setpoint sent, beside the target that was requested.

        Raises:
            SafetyError: the target or the way to it breaks a limit, or it is a jump. The arm has then been braked to
                rest within its limits; nothing of the refused motion was sent.
            RobotError: the robot stopped, or does not answer.
        """
        asked, begin = self._clock(), time.perf_counter()
        fraction = self._pace if self._realtime is None else self._pace * self._realtime.speed_fraction()
        count = self._count(duration, fraction)
        for _ in range(MAX_LATENESS):
            try:
                self._guard.check_target(target.arm, target.opening)
                arm = np.array(target.arm, dtype=np.float64)
                if not travel:
                    self._check_jump(arm, count * SERVO_PERIOD)
                way, setpoints, velocity = self._plan(arm, count)
                openings = self._openings(target.opening, len(setpoints))
                pieces = self._pieces(way, len(setpoints))
                if len(pieces) > 1:
                    self._guard.check(setpoints, openings, {piece.end: piece.stop for piece in pieces})
                due = self._clock() if self._realtime is None else self._realtime.due()
                self.timing = Timing(None, asked, due, time.perf_counter() - begin)
                for piece in pieces:
                    rows = slice(piece.begin, piece.end)
                    self._send(target, setpoints[rows], openings[rows], piece.stop)
                    self._motion = piece.after
            except StarvedError as error:
                self._guard.rest_at(error.q)
                before = self._target
                self._rest()
                if error.felt is not None:
                    raise self._guard.too_much_force(error.felt) from None
                # The arm rests where it braked to; the same target is asked for again from there.
                self.late += 1
                self._target = before
                continue
            except MotionError:
                self.stop()
                raise
            self._target, self._target_velocity = JointTarget(arm, float(target.opening)), velocity
            return self._command(target)
        raise RobotError(
            f"setpoints came too late {MAX_LATENESS} times in a row: this machine is too busy to stream to a robot",
            "end other programs, or raise the lead in the rig file's [controller]",
        )

    def settle(self, tolerance: float = 2e-3, timeout: float = 3.0) -> bool:
        """Hold the last target until every joint is within `tolerance` rad of it and at rest.

        Returns:
            False when `timeout` seconds of robot time pass first (the arm is held off by contact, say).
        """
        slice_s = 10 * SERVO_PERIOD
        for _ in range(max(1, round(timeout / slice_s))):
            self.run(self._target, slice_s)
            state = self._robot.state()
            arrived = np.abs(state.q - self._target.arm).max() <= tolerance and np.abs(state.qd).max() <= STILL
            if arrived and self._guard.last_opening == self._target.opening:
                return True
        return False

    def stop(self) -> None:
        """Brake to rest as fast as the limits allow and hold there.

        Raises:
            SafetyError: even braking would break a limit (the floor, say); the robot then gets no more setpoints.
        """
        setpoints = self._generator.to_rest(self._motion)
        if len(setpoints):
            end = JointTarget(setpoints[-1].copy(), self._guard.last_opening)
            try:
                self._send(end, setpoints, np.full(len(setpoints), self._guard.last_opening), braking=True)
            except StarvedError as error:
                self._guard.rest_at(error.q)
        self._rest()

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        """Cap the joint torques at (6,) N m, or no more; an arm that stands off its last command goes on from there.

        A robot in real time yields instead, as fast as it can: with a limit its tip keeps to PRESSING_SPEED, in more
        time.

        Raises:
            MotionError: a limit that is not six positive numbers.
        """
        if limit is not None and not (len(limit) == 6 and all(0.0 < most < np.inf for most in limit)):
            raise MotionError(f"an effort limit of {limit} N m; allowed: six positive numbers, or None")
        if self._realtime is None:
            self._robot.limit_effort(limit)
            if limit is None:
                self.stop()
            return
        self.stop()
        self._robot.limit_effort(limit)
        self._fastest = min(self._first_run, np.inf if limit is None else PRESSING_SPEED)
        try:
            # The arm's answer to being asked to stay is where it stays.
            self._guard.send(self._guard.last_sent[None], np.array([self._guard.last_opening]), braking=True)
        except StarvedError as error:
            self._guard.rest_at(error.q)
        self._rest()

    def _pieces(self, way: Way, count: int) -> list[_Piece]:
        """The parts in which `count` setpoints of `way` are sent, each as good as a target of its own."""
        ends = [count] if self._realtime is None else [*range(PIECE, count, PIECE), count]
        pieces, begin = [], 0
        for end in ends:
            after = way.at(end)
            stop = np.empty((0, 6)) if self._realtime is None else self._generator.to_rest(after)
            pieces.append(_Piece(begin, end, after, stop))
            begin = end
        return pieces

    def _plan(self, arm: np.ndarray, count: int) -> tuple[Way, Float[np.ndarray, "n 6"], Float[np.ndarray, "6"]]:
        """A way to a target, its setpoints over `count` ticks, or more where the tip would be too fast, and the
        target's speed.
        """
        before = np.inf
        while True:
            velocity = (arm - self._target.arm) / (count * SERVO_PERIOD)
            way = self._generator.towards(self._motion, arm, self._arrival(velocity), count * SERVO_PERIOD)
            setpoints = way.setpoints(count)
            excess = (
                self._guard.tip_speed(setpoints) / (PACE_MARGIN * self._fastest) if np.isfinite(self._fastest) else 0.0
            )
            if excess <= 1.0 or count >= MOST_TICKS:
                return way, setpoints, velocity
            # A trajectory that lasts longer than this ignores the count so far; one that does not, and is no slower
            # for more time, is fast because of the motion that it begins with, which no time helps.
            if way.duration <= (count + 1) * SERVO_PERIOD:
                if excess > FALLING * before:
                    return way, setpoints, velocity
                before = excess
            count = min(MOST_TICKS, int(np.ceil(count * max(excess, 1.1))))

    def _check_jump(self, arm: np.ndarray, seconds: float) -> None:
        allowed = self._pace * self._arm.velocity_limit * seconds + JUMP_SLACK
        jump = np.abs(arm - self._target.arm)
        joint = int(np.argmax(jump - allowed))
        if jump[joint] > allowed[joint]:
            raise SafetyError(
                "jump", ARM_JOINTS[joint], float(jump[joint]), float(allowed[joint]),
                f"{ARM_JOINTS[joint]} is asked to jump by {jump[joint]:.3f} rad from the last target; "
                f"allowed within {seconds:.3f} s: {allowed[joint]:.3f} rad",
                "ask for nearer targets, or for a travel",
            )  # fmt: skip

    def _count(self, duration: float, fraction: float) -> int:
        """Ticks that a target gets at a fraction of full speed."""
        if not (np.isfinite(duration) and SERVO_PERIOD <= duration <= MOST_TICKS * SERVO_PERIOD):
            raise MotionError(
                f"a target for {duration} s; allowed: {SERVO_PERIOD} to {MOST_TICKS * SERVO_PERIOD:.0f} s"
            )
        return min(MOST_TICKS, round(duration / fraction / SERVO_PERIOD))

    def _arrival(self, velocity: np.ndarray) -> np.ndarray:
        """The speed to arrive with: that of the slower of the last two steps of the target, if they agree."""
        slower = np.minimum(np.abs(velocity), np.abs(self._target_velocity))
        agree = velocity * self._target_velocity > 0
        return np.where(agree, np.sign(velocity) * np.minimum(slower, self._arrival_limit), 0.0)

    def _openings(self, wanted: float, count: int) -> np.ndarray:
        start = self._guard.last_opening
        reach = self._gripper_step * np.arange(1, count + 1)
        return np.clip(wanted, start - reach, start + reach)

    def _send(
        self,
        requested: JointTarget,
        setpoints: np.ndarray,
        openings: np.ndarray,
        stop: np.ndarray | None = None,
        braking: bool = False,
    ) -> None:
        def record() -> None:
            self._since_record += 1
            if self._since_record >= self._record_every:
                self._since_record = 0
                state, command = self._robot.state(), self._command(requested)
                for recorder in self.recorders:
                    recorder(state, command)

        self._guard.send(setpoints, openings, record if self.recorders else None, stop, braking)

    def _clock(self) -> float:
        return self._robot.state().time

    def _command(self, requested: JointTarget) -> Command:
        if self._realtime is not None:
            sent = self._realtime.last_sent()
        else:
            sent = JointTarget(self._guard.last_sent, self._guard.last_opening)
        return Command(self._clock(), requested, sent)
