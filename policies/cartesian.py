"""Straight, guarded motions of a downward-pointing hand, as generators of joint targets."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from resync_robot.core import spatial
from resync_robot.core.errors import MotionError
from resync_robot.core.joints import JointTarget
from resync_robot.core.ramps import ramped
from resync_robot.core.rig import Rig
from resync_robot.core.skill import SkillEnd, SkillOutcome
from resync_robot.core.world import ArmObservation

Motion = Generator[JointTarget, ArmObservation, SkillOutcome]
Step = Generator[JointTarget, ArmObservation, None]

YAW_SPEED = 1.2
"""rad/s of the hand about the vertical."""
RAMP_S = 0.3
"""s from rest to a motion's speed, and back: 1.3 m/s^2 at most where the hand travels."""
LAG_S = 0.25
"""s that an arm may be behind its targets: smoothing to its jerk limit, and the controller's own look-ahead. A UR7e by
its emulated controller is 0.2 s behind where the hand travels at 0.25 m/s."""
GIVE_IN_STEP = 0.012
"""m between two targets on the way back from where the hand could not get."""
FINGER_SPEED = 0.12
"""m/s of opening or closing."""


SLIPPED = 0.006
"""m by which pads come closer together that what they held has left."""


class Blocked(Exception):
    """A guard stopped a motion; the message says which. Caught by the skill that moved."""

    ending = SkillEnd.BLOCKED


class Dropped(Blocked):
    """What the hand held is not between the pads any more."""

    ending = SkillEnd.DROPPED


@dataclass
class GeneratorPolicy:
    """Runs a motion one step at a time, behind `core.skill.Policy`."""

    motion: Motion
    _waiting: JointTarget | SkillOutcome | None = field(default=None)

    def step(self, observation: ArmObservation) -> JointTarget | SkillOutcome:
        if self._waiting is not None:
            first, self._waiting = self._waiting, None
            return first
        try:
            return self.motion.send(observation)
        except StopIteration as ended:
            return ended.value
        except MotionError as error:
            return SkillOutcome(SkillEnd.UNREACHABLE, error.what)


def run_motion(motion: Motion, first: ArmObservation) -> GeneratorPolicy:
    """A policy whose motion was created with the observation `first`."""
    try:
        return GeneratorPolicy(motion, next(motion))
    except StopIteration as ended:
        return GeneratorPolicy(motion, ended.value)
    except MotionError as error:
        return GeneratorPolicy(motion, SkillOutcome(SkillEnd.UNREACHABLE, error.what))


class Hand:
    """Where the hand was last sent, and straight lines from there.

    Args:
        period: seconds between two steps.
        stray: m between where the tip is and the way that it was sent in the last LAG_S, at which a motion counts as
            blocked.
    """

    def __init__(self, rig: Rig, first: ArmObservation, period: float, stray: float) -> None:
        self.rig, self.period, self.stray = rig, period, stray
        self.last = first
        self._base_T_world = spatial.inverse(rig.arm.world_T_base)
        self._tip_T_flange = spatial.inverse(rig.gripper.flange_T_tip)
        self._q = first.arm.copy()
        self._branch = rig.arm.kinematics.branch_of(first.arm)
        tip = rig.tip_pose(first.arm)
        self.position = tip[:3, 3].copy()
        self.yaw = float(np.arctan2(tip[1, 0], tip[0, 0]))
        # Not where a block stopped the pads: commanded that, they would let go of it.
        self.opening = first.commanded_opening
        self._held_apart: float | None = None
        # An arm that is late is somewhere on its way, at whatever speed; one that is held is not.
        self._way = deque([self.position.copy()], maxlen=1 + round(LAG_S / period))

    @staticmethod
    def rotation(yaw: float) -> np.ndarray:
        """(3, 3) of a tool that points down, its x axis at `yaw`."""
        return spatial.rotation_about("z", yaw) @ spatial.rotation_about("x", np.pi)

    def target(self) -> JointTarget:
        self._way.append(self.position.copy())
        tip = spatial.transform(self.rotation(self.yaw), self.position)
        base_T_flange = self._base_T_world @ tip @ self._tip_T_flange
        self._q = self.rig.arm.kinematics.inverse_along(base_T_flange, self._q, self._branch)
        return JointTarget(self._q, self.opening)

    def reaches(self, tips: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n"]:
        """Whether the arm can put the tip to each of these positions, m, without another heading or another elbow; in
        the workspace, where the rig has one."""
        poses = np.broadcast_to(spatial.transform(self.rotation(self.yaw), np.zeros(3)), (len(tips), 4, 4)).copy()
        poses[:, :3, 3] = tips
        with np.errstate(invalid="ignore"):
            q = self.rig.arm.kinematics.inverse_branch(self._base_T_world @ poses @ self._tip_T_flange, self._branch)
        reached = np.isfinite(q).all(-1)
        if (controller := self.rig.controller) is not None:
            reached &= np.all((tips > controller.workspace_low) & (tips < controller.workspace_high), axis=1)
        return np.asarray(reached)

    def move(
        self,
        x: float,
        y: float,
        z: float,
        yaw: float,
        speed: float,
        max_force: float = np.inf,
        opening: float | None = None,
    ) -> Step:
        """Straight to a tip pose with smooth ends; returns when the tip has arrived.

        Args:
            max_force: N.
            opening: m between the pads at its end, which open or close on the way.

        Raises:
            Blocked: the tip strayed, or more than `max_force` N pushed against it (beyond what it felt at the start).
            Dropped: what the hand held has left it.
        """
        begin, goal = self.position.copy(), np.array([x, y, z], dtype=np.float64)
        yaw_begin, turn = self.yaw, self._turn(yaw)
        wide, widen = self.opening, 0.0 if opening is None else self._within(opening) - self.opening
        cruise = max(float(np.linalg.norm(goal - begin)) / speed, abs(turn) / YAW_SPEED, abs(widen) / FINGER_SPEED)
        at_rest = self.last.tip_force
        for s in ramped(cruise, RAMP_S, self.period):
            self.position, self.yaw = begin + s * (goal - begin), yaw_begin + s * turn
            self.opening = self._within(wide + s * widen)
            self.last = yield self.target()
            self._guard(at_rest, max_force)
        yield from self.settle(at_rest, max_force)

    def _turn(self, yaw: float) -> float:
        """The way round to `yaw`, rad: the short one, unless it would wind the last wrist joint up to its limit."""
        turn = float(spatial.wrap(yaw - self.yaw))
        # The tool points down: a turn to the left is one to the right for the joint above it.
        wound = self._q[5] - turn - self.rig.arm.home[5]
        return turn if abs(wound) < np.pi + 0.2 else turn + 2 * np.pi * float(np.sign(wound))

    def settle(self, at_rest: np.ndarray, max_force: float, seconds: float = 0.4) -> Step:
        """Wait until the tip stands within 1 mm of where it was sent, or for `seconds`."""
        for _ in range(int(seconds / self.period)):
            if np.linalg.norm(self.tip() - self.position) < 0.001:
                return
            self.last = yield self.target()
            self._guard(at_rest, max_force)

    def retreat(self, z: float, speed: float) -> Step:
        """Straight up to at least `z`, from where the tip is."""
        if self.position[2] < z - 0.002:
            yield from self.move(self.position[0], self.position[1], z, self.yaw, speed)

    def give_in(self) -> Step:
        """Send the tip to where it stands; at once would be a jump where it was sent far into something."""
        begin, tip = self.position.copy(), self.tip()
        steps = int(np.ceil(np.linalg.norm(tip - begin) / GIVE_IN_STEP))
        for i in range(1, steps + 1):
            self.position = begin + (tip - begin) * i / steps
            self.last = yield self.target()

    def back_off(self, z: float, speed: float) -> Step:
        """Up and away after a guard; whatever still touches on the way is left to the world."""
        yield from self.give_in()
        stray, self.stray = self.stray, np.inf
        yield from self.retreat(z, speed)
        self.stray = stray

    def hold(self) -> None:
        """From now on, until the fingers are moved, something is between the pads, and motions end once it is not."""
        self._held_apart = self.last.opening

    def open(self, opening: float) -> Step:
        """Open or close to `opening` m at the gripper's speed."""
        self._held_apart = None
        opening = self._within(opening)
        steps = max(1, int(np.ceil(abs(opening - self.opening) / FINGER_SPEED / self.period)))
        begin = self.opening
        for i in range(1, steps + 1):
            self.opening = begin + (opening - begin) * (i / steps)  # Ends exactly there: closed is not -1e-18 m.
            self.last = yield self.target()
        for _ in range(int(0.15 / self.period)):
            self.last = yield self.target()

    def _within(self, opening: float) -> float:
        return float(np.clip(opening, 0.0, self.rig.gripper.max_opening))

    def close(self, opening: float) -> Step:
        """Close on something: as `open`, then wait until the pads stand still."""
        yield from self.open(opening)
        before = np.inf
        for _ in range(int(0.6 / self.period)):
            if abs(self.last.opening - before) < 1e-5:
                return
            before = self.last.opening
            self.last = yield self.target()

    def tip(self) -> np.ndarray:
        return self.rig.tip_pose(self.last.arm)[:3, 3].copy()

    def _guard(self, at_rest: np.ndarray, max_force: float) -> None:
        if self._held_apart is not None and self.last.opening < self._held_apart - SLIPPED:
            # It is said once; what the hand does about it is no matter of holding any more.
            self._held_apart = None
            raise Dropped("what was held has left the hand")
        away = float(np.linalg.norm(np.array(self._way) - self.tip(), axis=1).min())
        if away > self.stray:
            raise Blocked(f"the tip is held {1000 * away:.0f} mm from where it was sent")
        force = float(np.linalg.norm(self.last.tip_force - at_rest))
        if force > max_force:
            raise Blocked(f"{force:.0f} N against the hand")
