"""The only road to a command: a guard that checks every setpoint before any of its block is sent.

A block is the run of setpoints for one target. It is checked as a whole, so a motion that would break a limit at
its end is refused before its beginning. Velocity, acceleration and jerk are finite differences over the setpoints
really sent, seams included: what is checked is what the robot sees. Workspace and tip speed are looked at every STRIDE
setpoints, between which the tip moves no further than the workspace's MARGIN and a little.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float

from resync_robot.core.joints import ARM_JOINTS
from resync_robot.core.rig import Rig
from resync_robot.hardware.base import SERVO_PERIOD, RealtimeRobot, Robot, SafetyError
from resync_robot.hardware.clearance import Obstacle
from resync_robot.hardware.workspace import Workspace

FIRST_RUN_SPEED = 0.25
"""m/s of the tip until somebody has confirmed the motions at this machine; the usual figure for people nearby."""
STRIDE = 5

# Relative. A third difference over 2 ms of positions known to 1e-15 rad is off by 1e-6 rad/s^3.
_ROUNDING = 1e-6


class Guard:
    """Checks setpoints against the rig's limits and hands them to the robot.

    Args:
        robot: a connected robot.
        rig: limits, mounting and gripper.
        table_z: height of the table in the world, m.
        margin: how far below the table a setpoint may put the tip, m; pressing on things needs a little.
    """

    def __init__(self, robot: Robot, rig: Rig, table_z: float = 0.0, margin: float = 0.01) -> None:
        self._robot = robot
        self._realtime = robot if isinstance(robot, RealtimeRobot) else None
        self._rig = rig
        # Orders 1, 2, 3 of the differences of position, and the limit on each.
        arm = rig.arm
        self._rates = (
            ("velocity", "rad/s", arm.velocity_limit),
            ("acceleration", "rad/s^2", arm.acceleration_limit),
            ("jerk", "rad/s^3", arm.jerk_limit),
        )
        self._controller = rig.controller
        self._workspace = Workspace(rig, table_z, margin)
        if self._realtime is not None:
            self._realtime.stay_in(self._workspace)
        self._past = np.zeros((3, 6))
        self._opening = float(np.clip(robot.state().opening, 0.0, rig.gripper.max_opening))
        self.start()

    @property
    def last_sent(self) -> Float[np.ndarray, "6"]:
        """The setpoint that the robot follows now, rad."""
        return self._past[-1].copy()

    @property
    def last_opening(self) -> float:
        return self._opening

    def keep_out(self, *obstacles: Obstacle) -> None:
        """Let nothing but the hand come near these, from now on."""
        self._workspace.keep_out(*obstacles)

    def start(self) -> None:
        """Take the arm where it is measured, at rest, as the last setpoint: after connecting, after a stop.

        A stop of the arm is none of the gripper's: it goes on with what it was told last, or would let go of what it
        holds.

        Raises:
            SafetyError: the measurement is not finite or lies outside the limits. Where the arm stands too near to
                something, the error says that a person has to move it clear by hand.
        """
        state = self._robot.state()
        try:
            self.check_target(np.asarray(state.q, dtype=np.float64), self._opening)
        except SafetyError as error:
            if error.quantity not in ("position", "floor", "workspace", "clearance"):
                raise
            raise SafetyError(
                error.quantity, error.joint, error.value, error.limit,
                f"the arm cannot be driven from where it stands: {error.what}",
                "move it clear by hand on the teach pendant (freedrive, or jog it), then start again",
            ) from None  # fmt: skip
        self._past[:] = state.q

    def rest_at(self, q: Float[np.ndarray, "6"]) -> None:
        """Take `q` (rad), at rest, as the last setpoint: where a robot says it has braked to."""
        self._past[:] = q

    def check_target(self, q: Float[np.ndarray, "6"], opening: float) -> None:
        """Refuse a target that could never be sent, whatever the path. Raises SafetyError."""
        q = np.asarray(q, dtype=np.float64)
        if q.shape != (6,):
            raise SafetyError("shape", "arm", float(q.size), 6.0, f"a target has shape {q.shape}, it must be (6,)")
        self._check_block(q[None], np.array([opening], dtype=np.float64))
        self._workspace.check_frames(self._workspace.frames(q[None]))

    def tip_speed(self, setpoints: Float[np.ndarray, "n 6"]) -> float:
        """m/s; the fastest of the tip on the way from the last setpoint through these."""
        return self._tip_speed(*self._sampled(self._past, setpoints))

    def check(
        self,
        setpoints: Float[np.ndarray, "n 6"],
        openings: Float[np.ndarray, " n"],
        stops: Mapping[int, Float[np.ndarray, "m 6"]],
    ) -> None:
        """Refuse a motion that must not be sent, from the last setpoint on. Raises SafetyError.

        Args:
            stops: ways to rest, by how many of the setpoints come before.
        """
        self._check_block(setpoints, openings)
        before = np.concatenate([self._past, setpoints])
        self._check_motion(self._past, setpoints)
        self._check_opening_speed(openings)
        for count, stop in stops.items():
            if len(stop):
                self._check_block(stop, np.zeros(len(stop)))
                self._check_motion(before[count : count + 3], stop)

    def send(
        self,
        setpoints: Float[np.ndarray, "n 6"],
        openings: Float[np.ndarray, " n"],
        after_each: Callable[[], None] | None = None,
        stop: Float[np.ndarray, "m 6"] | None = None,
        braking: bool = False,
    ) -> None:
        """Check the whole block, then send it, one setpoint every SERVO_PERIOD; call `after_each` after each.

        Args:
            stop: the way to rest from the block's end, for a robot whose clock does not wait; checked like the block.
            braking: the block leads to rest, and so is sent whatever the tip feels.

        Raises:
            SafetyError: a setpoint breaks a limit; nothing of the block was sent.
            StarvedError: see `RealtimeRobot.play`; nothing of the block was sent.
        """
        self.check(setpoints, openings, {} if stop is None else {len(setpoints): stop})
        if self._realtime is not None:
            if not braking:
                self._check_force()
            self._realtime.play(setpoints, openings, np.empty((0, 6)) if stop is None else stop, after_each)
            self._past = np.concatenate([self._past, setpoints])[-3:]
            self._opening = float(openings[-1]) if len(openings) else self._opening
            return
        servo = self._robot.servo
        for q, opening in zip(setpoints, openings.tolist(), strict=True):
            # Written down first: if the driver raises, the setpoint may already be on its way.
            self._past[:2] = self._past[1:]
            self._past[2] = q
            self._opening = opening
            servo(q, opening)
            if after_each is not None:
                after_each()

    def too_much_force(self, force: float) -> SafetyError:
        """The error for a tip that feels `force` N."""
        most = np.inf if self._controller is None else self._controller.force_limit
        return SafetyError(
            "force", "tip", force, most,
            f"the tip feels {force:.0f} N; allowed: {most:.0f} N",
            "look what it touches; [controller] force_limit in the rig file sets the limit",
        )  # fmt: skip

    def _check_force(self) -> None:
        if self._controller is None:
            return
        force = float(np.linalg.norm(self._robot.state().tip_force))
        if not force <= self._controller.force_limit:
            raise self.too_much_force(force)

    def _check_motion(self, past: np.ndarray, setpoints: np.ndarray) -> None:
        """Rates, workspace and tip speed of setpoints that follow the three of `past`."""
        self._check_rates(past, setpoints)
        frames, seconds = self._sampled(past, setpoints)
        self._workspace.check_frames(frames[1:])
        self._check_tip_speed(frames, seconds)

    def _sampled(
        self, past: np.ndarray, setpoints: np.ndarray
    ) -> tuple[Float[np.ndarray, "m 7 4 4"], Float[np.ndarray, " k"]]:
        """Frames at the end of `past` and every STRIDE from there, the end included, and the seconds in between."""
        rows = np.unique([*range(0, len(setpoints) + 1, STRIDE), len(setpoints)])
        frames = self._workspace.frames(np.concatenate([past[-1:], setpoints])[rows])
        return frames, np.diff(rows) * SERVO_PERIOD

    def _tip_speed(self, frames: np.ndarray, seconds: np.ndarray) -> float:
        ways = np.linalg.norm(np.diff(self._workspace.tips(frames), axis=0), axis=1)
        return float((ways / seconds).max(initial=0.0))

    def _check_tip_speed(self, frames: np.ndarray, seconds: np.ndarray) -> None:
        if self._controller is None or self._controller.full_speed:
            return
        speed = self._tip_speed(frames, seconds)
        if speed > FIRST_RUN_SPEED * (1 + _ROUNDING):
            raise SafetyError(
                "tip speed", "tip", speed, FIRST_RUN_SPEED,
                f"the tip would move at {1000 * speed:.0f} mm/s; allowed until the motions have been confirmed at "
                f"this machine: {1000 * FIRST_RUN_SPEED:.0f} mm/s",
                "watch a whole slow run, then set full_speed = true in the rig file's [controller]",
            )  # fmt: skip

    def _check_block(self, setpoints: np.ndarray, openings: np.ndarray) -> None:
        if setpoints.ndim != 2 or setpoints.shape[1] != 6 or openings.shape != setpoints.shape[:1]:
            raise SafetyError(
                "shape", "arm", float(setpoints.size), 6.0,
                f"setpoints of shape {setpoints.shape} with openings of shape {openings.shape}; allowed: (n, 6), (n,)",
            )  # fmt: skip
        self._workspace.check_joints(setpoints)
        widest = self._rig.gripper.max_opening
        if not ((openings >= 0.0) & (openings <= widest)).all():
            wrong = float(openings[~((openings >= 0.0) & (openings <= widest))][0])
            raise SafetyError(
                "opening", "gripper", wrong, widest, f"opening of {wrong:.4f} m; allowed: 0 to {widest:.3f} m"
            )

    def _check_rates(self, past: np.ndarray, setpoints: np.ndarray) -> None:
        difference = np.concatenate([past, setpoints])
        for order, (quantity, unit, limit) in enumerate(self._rates, start=1):
            difference = (difference[1:] - difference[:-1]) / SERVO_PERIOD
            # The first rows of a lower order lie in the past and were checked then.
            self._compare(quantity, unit, difference[3 - order :], limit * (1 + _ROUNDING))

    def _check_opening_speed(self, openings: np.ndarray) -> None:
        steps = np.abs(openings - np.concatenate([[self._opening], openings[:-1]])) / SERVO_PERIOD
        _, most = self._rig.gripper.facts.speed
        if steps.max(initial=0.0) > most * (1 + _ROUNDING):
            fastest = float(steps.max())
            raise SafetyError(
                "opening speed", "gripper", fastest, most,
                f"the opening would change at {fastest:.3f} m/s; allowed: {most} m/s",
            )  # fmt: skip

    def _compare(self, quantity: str, unit: str, values: np.ndarray, limit: np.ndarray) -> None:
        excess = np.abs(values) > limit
        if excess.any():
            row, joint = (int(i) for i in np.argwhere(excess)[0])
            value, allowed = float(values[row, joint]), float(limit[joint])
            raise SafetyError(
                quantity, ARM_JOINTS[joint], value, allowed,
                f"{ARM_JOINTS[joint]} would have {quantity} {value:.4g} {unit}, setpoint {row + 1} of {len(values)}; "
                f"allowed: +-{allowed:.4g} {unit}",
            )  # fmt: skip
