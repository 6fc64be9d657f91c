"""What the car can do from the beginning: drive from room to room, turning where it stands, and stop in ice and mud."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.world import Observation
from resync_robot.sim_training.domains.icy_transport.floor_plan import Point, centre, overlap, room_of, way
from resync_robot.sim_training.domains.icy_transport.simulator import (
    ARM_OF_COUPLE,
    CARGO_MASS,
    MASS,
    MOST_FORCE,
    MOST_STEER,
    STEP,
    inertia,
)
from resync_robot.sim_training.domains.icy_transport.vocabulary import (
    CAR,
    ITEM,
    REGIONS,
    delivered,
    is_carried,
    is_fixed,
)

RATE_HZ = 1 / STEP
_TO_PLACE, _BRAKE, _TO_HEADING, _TURN_BRAKE = 100.0, 20.0, 50.0, 10.0
"""Gains: 1/s^2 and 1/s, along and about."""
_AT, _FACING = 0.03, 0.02
"""m and rad from where a leg shall end."""
_PATIENCE = 150
"""Actions after which a leg is given up, and the next one begins."""
_STILL = 0.01
"""m/s and rad/s."""
_IN_THE_MIDDLE, _AIM_FROM = 0.2, 0.15
"""m: nearer than that to the middle of a room a car need not go there first, and no longer steers at where it goes."""


class _Drive:
    """Drives to an item until `done` and the car stands; gives up where it is caught in a region."""

    def __init__(self, car: Object, goal: Object, done: Callable[[State], bool], first: State) -> None:
        self._car, self._done = car, done
        x, y = first[car][:2].tolist()
        goal_x, goal_y = first[goal][:2].tolist()
        here, there = room_of(x, y), room_of(goal_x, goal_y)
        begun: list[Point] = [] if math.dist((x, y), centre(here)) < _IN_THE_MIDDLE else [centre(here)]
        self._points = [*begun, *way(here, there), (goal_x, goal_y)]
        self._facing, self._spent, self._arrived = True, 0, False
        self._heading = 0.0

    def step(self, seen: Observation) -> np.ndarray | SkillOutcome:
        row = seen.state[self._car].tolist()
        caught = caught_in(seen.state, self._car)
        if caught is not None:
            return SkillOutcome(SkillEnd.BLOCKED, f"the car is caught in {caught}")
        self._arrived = self._arrived or self._done(seen.state)
        if self._arrived:
            if max(map(abs, row[5:8])) < _STILL:
                return SkillOutcome(SkillEnd.DONE)
            return _braking(row)
        if not self._points:
            return SkillOutcome(SkillEnd.BLOCKED, "the car came there, and nothing happened")
        return self._driving(row, MASS + CARGO_MASS * any(is_carried(seen.state, o) for o in seen.state.of_type(ITEM)))

    def _driving(self, row: list[float], mass: float) -> np.ndarray:
        x, y, theta, length, width, forward, _, turning = row
        dx, dy = self._points[0][0] - x, self._points[0][1] - y
        far = math.hypot(dx, dy)
        if far > _AIM_FROM:
            self._heading = math.atan2(dy, dx)
        off = math.remainder(self._heading - theta, 2 * math.pi)
        self._spent += 1
        if self._facing:
            if abs(off) < _FACING or far <= _AIM_FROM or self._spent > _PATIENCE:
                self._facing, self._spent = False, 0
            return np.array([*_braking(row)[:2], _steer(off, turning, length, width)])
        ahead = dx * math.cos(theta) + dy * math.sin(theta)
        if far < _AT or (far < _AIM_FROM and abs(ahead) < _AT) or self._spent > _PATIENCE:
            self._points.pop(0)
            self._facing, self._spent = True, 0
        force = mass * (_TO_PLACE * ahead - _BRAKE * forward)
        return np.array([_within(force, MOST_FORCE), 0.0, _steer(off, turning, length, width)])


class _Refused:
    """Makes no sense here."""

    def __init__(self, reason: str) -> None:
        self._reason = reason

    def step(self, seen: Observation) -> SkillOutcome:
        return SkillOutcome(SkillEnd.REFUSED, self._reason)


def caught_in(state: State, car: Object) -> Object | None:
    """An active region that the car is in."""
    x, y, theta, length, width = state[car][:5].tolist()
    for kind in REGIONS:
        for region in state.of_type(kind):
            rx, ry, turned, depth, across, active = state[region].tolist()
            if active > 0.5 and overlap((x, y, theta, length / 2, width / 2), (rx, ry, turned, depth / 2, across / 2)):
                return region
    return None


def _braking(row: list[float]) -> np.ndarray:
    forward, sideways, turning = row[5:8]
    along, across = (_within(-MASS * _BRAKE * v, MOST_FORCE) for v in (forward, sideways))
    return np.array([along, across, _steer(0.0, turning, row[3], row[4])])


def _steer(off: float, turning: float, length: float, width: float) -> float:
    torque = inertia(MASS, length, width) * (_TO_HEADING * off - _TURN_BRAKE * turning)
    return _within(torque / ARM_OF_COUPLE, MOST_STEER)


def _within(value: float, most: float) -> float:
    return min(max(value, -most), most)


def _pick(objects: tuple[Object, ...], first: Observation) -> _Drive | _Refused:
    car, item = objects
    if any(is_carried(first.state, o) for o in first.state.of_type(ITEM)):
        return _Refused("something is carried already")
    return _Drive(car, item, lambda state: is_carried(state, item), first.state)


def _place(objects: tuple[Object, ...], first: Observation) -> _Drive | _Refused:
    car, item, target = objects
    if not is_carried(first.state, item):
        return _Refused(f"{item} is not carried")
    if not is_fixed(first.state, target):
        return _Refused(f"{target} is no target")
    return _Drive(car, target, lambda state: delivered(state, (item, target)) > 0.5, first.state)


def skills() -> tuple[Skill, ...]:
    return (
        Skill("GoToPickObject", (CAR, ITEM), _pick, RATE_HZ, time_limit_s=40, live_state=True),
        Skill("GoToPlaceObject", (CAR, ITEM, ITEM), _place, RATE_HZ, time_limit_s=40, live_state=True),
    )
