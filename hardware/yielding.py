"""An arm that yields to what it feels: setpoints that follow a path no further than the joints may press.

A servoed UR7e is a stiff position controller and caps no torque. Here the cap is made outside of it: the felt wrench
gives each joint's share of the contact, tau = J^T F. A joint that is pressed with more than PRESSED of its limit goes
on against that only slowly, more slowly the nearer tau is to the limit, not at all there, and backwards beyond it. So
it comes to rest where tau is its limit, however far ahead its path has gone, as a motor does whose torque is capped
there; the others go on. Joint by joint, because that is what an effort limit says; only velocities, because that needs
neither the contact's stiffness nor the arm's; no force is aimed at, so an arm in the air keeps to its path.

Why DAMPING is what it is: near the limit, contact (k N/m at the tip) and damping make a loop of the rate
k * max eig(J D^-1 J^T), 5.4e-4 k at home; times the delay from a setpoint to its force it has to stay below 1.5.

All motion is one jerk-limited follower of a wanted velocity, from the first setpoint to the last: there is no other
mode to begin or to end, and so no seam. It goes only where it can brake within its workspace.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from ruckig import ControlInterface, InputParameter, OutputParameter, Result, Ruckig, RuckigError, Synchronization

from resync_robot.core.errors import MotionError
from resync_robot.core.rig import Rig
from resync_robot.hardware.base import SERVO_PERIOD, SafetyError
from resync_robot.hardware.generator import Generator, Motion
from resync_robot.hardware.safety import FIRST_RUN_SPEED
from resync_robot.hardware.workspace import Workspace

PRESSED = 0.6
"""Share of a joint's limit from which it is held back. What accelerates the hand, and noise, stay below."""
TOUCHING = 0.2
"""Share of its limit below which a joint that was held back no longer touches what pressed it."""
DAMPING, DAMPED_REACH = np.array([1200.0, 1200.0, 1200.0, 400.0, 400.0, 400.0]), 0.85
"""N m s/rad of an arm with that reach in m, or less. J grows with the reach: with its square the loop's rate stays the
same. A short arm gets no less: at a third of it a UR3e chattered at 1.6 times its limit, as a UR10e did at this."""
CATCHING_UP = 15.0
"""1/s; share of its distance from the path that a joint makes good."""
SPEED = 0.3
"""rad/s of coming back to the path, on top of the path's own speed."""
RETREAT = 1.0
"""rad/s of giving way, at the most."""
BACK = 4.0
"""How many times as fast a joint may give way as it would go on, while it takes back what it ran ahead."""
FURTHEST = 0.25
"""rad; a joint yields no further from its path. A sensor that says nonsense pushes the arm no further either."""
ON_PATH = 1e-3
"""rad within which an arm that nothing presses is on its path, whose own checks stand for it."""
LIMITS_SHARE = 0.999
"""Of the rig's limits, so that rounding does not pass them."""
REMEMBERED = 0.25
"""s for which a joint goes on slowly once it touches nothing: it may have bounced off what it will touch again."""
PACE = 0.25
"""Share of SPEED until the motions have been confirmed at a machine."""


class Yielding:
    """The setpoints of one arm while its effort is limited.

    Args:
        rig: limits, mounting and gripper.
        workspace: where the arm may be; it yields no further.
        limit: (6,) N m.
        q: (6,) rad, the setpoint at which the arm rests now.
        wrench: (6,) N, N m of the world on the tip, at its point, world axes; what it says of an arm that touches
            nothing more than now.

    Attributes:
        position: (6,) rad, the last setpoint.
    """

    def __init__(
        self,
        rig: Rig,
        workspace: Workspace,
        limit: Float[np.ndarray, "6"],
        q: Float[np.ndarray, "6"],
        wrench: Float[np.ndarray, "6"],
    ) -> None:
        self._rig, self._workspace, self._limit = rig, workspace, np.asarray(limit, dtype=np.float64)
        self._free = np.where(np.isfinite(wrench), wrench, 0.0)
        self._damping = DAMPING * max(1.0, rig.arm.facts.reach / DAMPED_REACH) ** 2
        self._slow = rig.controller is not None and not rig.controller.full_speed
        self._speed = SPEED * (PACE if self._slow else 1.0)
        self._retreat = RETREAT * self._speed / SPEED
        self._fastest = LIMITS_SHARE * rig.arm.velocity_limit
        self._jerk = LIMITS_SHARE * rig.arm.jerk_limit
        self._most = LIMITS_SHARE * rig.arm.acceleration_limit
        self._pushed, self._since = np.zeros(6), np.full(6, np.inf)
        self._path = np.repeat(np.asarray(q, dtype=np.float64)[None], 3, axis=0)
        self._motion = Motion(self._path[-1].copy(), np.zeros(6), np.zeros(6))
        self._generator = Generator(rig.arm, 1.0)
        self._ruckig, self._out = Ruckig(6, SERVO_PERIOD), OutputParameter(6)
        self._plan = InputParameter(6)
        self._plan.control_interface = ControlInterface.Velocity
        self._plan.synchronization = Synchronization.No
        self._plan.max_velocity = rig.arm.velocity_limit.tolist()
        self._plan.max_acceleration, self._plan.max_jerk = self._most.tolist(), self._jerk.tolist()

    @property
    def position(self) -> Float[np.ndarray, "6"]:
        return self._motion.position.copy()

    @property
    def at_rest(self) -> bool:
        _, velocity, acceleration = self._motion
        return bool(np.abs(velocity).max() < 1e-7 and np.abs(acceleration).max() < 1e-4)

    def follow(
        self, path: Float[np.ndarray, "6"], q: Float[np.ndarray, "6"], wrench: Float[np.ndarray, "6"]
    ) -> Float[np.ndarray, "6"]:
        """The next setpoint (rad) of an arm that is asked to be at `path`, stands at `q` and feels `wrench`."""
        self._path[:2] = self._path[1:]
        self._path[2] = path
        if not (np.isfinite(q).all() and np.isfinite(wrench).all()):
            return self.brake()
        velocity, acceleration = self._wanted(self._rig.tip_jacobian(q).T @ (wrench - self._free), q)
        step = self._step(velocity, acceleration)
        if step is None or not self._allowed(step):
            return self.brake()
        self._motion = step
        return self.position

    def brake(self) -> Float[np.ndarray, "6"]:
        """The next setpoint (rad) on the way to rest. Raises MotionError: there is none, and nothing may be sent."""
        step = self._step(np.zeros(6), np.zeros(6))
        if step is None:
            raise MotionError("an arm that yields found no way to rest")
        self._motion = step
        return self.position

    def _wanted(self, torque: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocity and acceleration of each joint: along its path, back to it, and held back where it is pressed."""
        before, last, now = self._path
        acceleration = (now - 2 * last + before) / SERVO_PERIOD**2
        along = (now - last) / SERVO_PERIOD + acceleration * SERVO_PERIOD / 2
        off = last - self._motion.position
        wanted = along + CATCHING_UP * off
        wanted = np.clip(wanted, np.minimum(along, 0.0) - self._speed, np.maximum(along, 0.0) + self._speed)
        pressed = np.abs(torque) > PRESSED * self._limit
        self._pushed = np.where(pressed, np.sign(torque), self._pushed)
        held = self._since < REMEMBERED
        touching = pressed | (held & (self._pushed * torque > TOUCHING * self._limit))
        self._since = np.where(touching, 0.0, self._since + SERVO_PERIOD)
        held |= pressed
        # How fast it may go against what pushes it: a hyperbola, and its tangent where it is pushed beyond its limit.
        share = np.clip(self._pushed * torque / self._limit, TOUCHING, None)
        spare = (1.0 / np.minimum(share, 1.0) - 1.0 - np.maximum(share - 1.0, 0.0)) * self._limit / self._damping
        # What runs ahead of the arm at an impact is taken back at once, and no more than that.
        ahead = np.maximum(self._pushed * (q - self._motion.position), 0.0)
        back = np.maximum(BACK * spare, np.minimum(spare, -CATCHING_UP * ahead))
        against = np.where(spare > 0, spare, np.maximum(back, -self._retreat))
        most = np.where(held & (self._pushed < 0), against, np.inf)
        least = np.where(held & (self._pushed > 0), -against, -np.inf)
        # Not further from the path than FURTHEST, whatever is felt.
        most = np.maximum(most, CATCHING_UP * (off - FURTHEST))
        least = np.minimum(least, CATCHING_UP * (off + FURTHEST))
        free = (wanted >= least) & (wanted <= most)
        wanted = np.clip(wanted, least, most)
        acceleration = np.clip(acceleration, -self._most, self._most)
        # What still accelerates at the end of a step needs room below the limit to stop doing so.
        free &= np.abs(wanted) + acceleration**2 / (2 * self._jerk) <= self._fastest
        return np.clip(wanted, -self._fastest, self._fastest), np.where(free, acceleration, 0.0)

    def _step(self, velocity: np.ndarray, acceleration: np.ndarray) -> Motion | None:
        """The motion a tick later, on the quickest way to those; None where there is none."""
        plan = self._plan
        plan.current_position = self._motion.position.tolist()
        plan.current_velocity = self._motion.velocity.tolist()
        plan.current_acceleration = self._motion.acceleration.tolist()
        plan.target_velocity, plan.target_acceleration = velocity.tolist(), acceleration.tolist()
        try:
            result = self._ruckig.update(plan, self._out)
        except RuckigError:
            return None
        if result not in (Result.Working, Result.Finished):
            return None
        out = self._out
        return Motion(np.array(out.new_position), np.array(out.new_velocity), np.array(out.new_acceleration))

    def _allowed(self, step: Motion) -> bool:
        """Whether the arm may be there: braking from there it comes to rest where it may, and no faster than it may."""
        if np.abs(step.position - self._path[-1]).max() <= ON_PATH and self._since.min() > 0:
            return True
        if self._slow:
            # The fastest that each joint still gets on the way to rest, and were they all to push the same way.
            peak = np.abs(step.velocity + step.acceleration * np.abs(step.acceleration) / (2 * self._jerk))
            if np.linalg.norm(self._rig.tip_jacobian(step.position)[:3], axis=0) @ peak > FIRST_RUN_SPEED:
                return False
        rest = self._generator.to_rest(step)[-1:]
        try:
            self._workspace.check(rest if len(rest) else step.position[None])
        except SafetyError:
            return False
        return True
