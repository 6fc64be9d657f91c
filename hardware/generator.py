"""Jerk-limited motions of the arm, each the fastest within the rig's limits, by ruckig."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from ruckig import ControlInterface, InputParameter, Result, Ruckig, RuckigError, Trajectory

from resync_robot.core.errors import MotionError
from resync_robot.core.rig import ArmRig
from resync_robot.hardware.base import SERVO_PERIOD

JERK_SHARES = (1.0, 0.999, 0.99, 0.9)
"""Of the jerk limit, tried in turn: ruckig's root finding fails where two kinds of profile meet exactly
(from rest over 2 a^3 / j^2, for one: 0.16 rad here), and another jerk moves that point away."""


class Motion(NamedTuple):
    """Attributes: (6,) each; rad, rad/s, rad/s^2."""

    position: Float[np.ndarray, "6"]
    velocity: Float[np.ndarray, "6"]
    acceleration: Float[np.ndarray, "6"]


class Way:
    """A motion over time, in ticks of SERVO_PERIOD after its beginning."""

    def __init__(self, trajectory: Trajectory) -> None:
        self._trajectory = trajectory

    @property
    def duration(self) -> float:
        """s until it arrives."""
        return float(self._trajectory.duration)

    def at(self, tick: int) -> Motion:
        return Motion(*(np.array(part) for part in self._trajectory.at_time(tick * SERVO_PERIOD)))

    def setpoints(self, count: int) -> Float[np.ndarray, "n 6"]:
        """The positions after ticks 1 to `count`, rad."""
        at_time = self._trajectory.at_time
        return np.array([at_time(k * SERVO_PERIOD)[0] for k in range(1, count + 1)])


class Generator:
    """Plans for one arm.

    Args:
        pace: share of every speed, but in braking. The same path in 1 / pace of the time.
    """

    def __init__(self, arm: ArmRig, pace: float) -> None:
        self._arm, self._pace = arm, pace
        self._ruckig = Ruckig(6, SERVO_PERIOD)
        self._input = InputParameter(6)
        self._input.target_acceleration = [0.0] * 6

    def towards(
        self, begin: Motion, q: Float[np.ndarray, "6"], arrival: Float[np.ndarray, "6"], at_least: float
    ) -> Way:
        """To `q` (rad) with the speed `arrival` (rad/s), `at_least` so many s long. Raises MotionError."""
        self._input.control_interface = ControlInterface.Position
        return self._calculate(begin, q, arrival, at_least, self._pace)

    def to_rest(self, begin: Motion) -> Float[np.ndarray, "n 6"]:
        """Setpoints to rest, as fast as the limits allow; none where it is at rest already. Raises MotionError."""
        if not (np.any(begin.velocity) or np.any(begin.acceleration)):
            return np.empty((0, 6))
        self._input.control_interface = ControlInterface.Velocity
        way = self._calculate(begin, np.zeros(6), np.zeros(6), 0.0, 1.0)
        return way.setpoints(int(np.ceil(way.duration / SERVO_PERIOD)) + 1)

    def halt(self, past: Float[np.ndarray, "3 6"]) -> Float[np.ndarray, "n 6"]:
        """Setpoints (rad) to rest after the last three that were sent, as fast as the limits allow. Raises MotionError.

        Of a motion that is only known by its setpoints. Speeds are planned and added up, so that differences of
        setpoints are what ruckig limits; an acceleration by differences lags by half a tick of jerk.
        """
        arm = self._arm
        (before, velocity), late = np.diff(past, axis=0) / SERVO_PERIOD, arm.jerk_limit * SERVO_PERIOD / 2
        acceleration = (velocity - before) / SERVO_PERIOD
        acceleration = np.sign(acceleration) * np.clip(np.abs(acceleration) - late, 0.0, arm.acceleration_limit)
        velocity = np.clip(velocity, -arm.velocity_limit, arm.velocity_limit)
        self._input.control_interface = ControlInterface.Velocity
        way = self._calculate(Motion(past[-1], velocity, acceleration), np.zeros(6), np.zeros(6), 0.0, 1.0)
        speeds = [way.at(k).velocity for k in range(1, int(np.ceil(way.duration / SERVO_PERIOD)) + 2)]
        return past[-1] + SERVO_PERIOD * np.cumsum(speeds, axis=0)

    def _calculate(self, begin: Motion, q: np.ndarray, arrival: np.ndarray, at_least: float, pace: float) -> Way:
        plan, trajectory = self._input, Trajectory(6)
        plan.current_position = begin.position.tolist()
        plan.current_velocity = begin.velocity.tolist()
        plan.current_acceleration = begin.acceleration.tolist()
        plan.target_position = q.tolist()
        plan.target_velocity = arrival.tolist()
        plan.minimum_duration = at_least
        plan.max_velocity = (pace * self._arm.velocity_limit).tolist()
        plan.max_acceleration = (pace**2 * self._arm.acceleration_limit).tolist()
        failure = ""
        for share in JERK_SHARES:
            plan.max_jerk = (share * pace**3 * self._arm.jerk_limit).tolist()
            try:
                result = self._ruckig.calculate(plan, trajectory)
            except RuckigError as error:
                failure = str(error).strip().splitlines()[0]
                continue
            if result in (Result.Working, Result.Finished):
                return Way(trajectory)
            failure = result.name
        raise MotionError(f"no trajectory to the target {np.array2string(q, precision=4)} rad: {failure}")
