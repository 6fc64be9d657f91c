"""The given skills: waypoints, one after the other, until what they are for is reached or something is in the way."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.sim_training.domains.blocked_stacking.body import ARM, GAP, LIMITS, MIDDLE, Configuration
from resync_robot.sim_training.domains.blocked_stacking.vocabulary import (
    BLOCK,
    DOWN,
    ROBOT,
    above,
    holding,
    on,
    ready_grasp,
)

if TYPE_CHECKING:
    from resync_robot.sim_training.domains.blocked_stacking.simulator import Felt

RATE_HZ = 5.0
GENTLE = 0.8
"""Share of what an action can change that is used."""
TRAVEL = 1.2
"""Height of the base at which it goes from one place to another, m."""
GRASP_BELOW = 0.11
"""m that the middle of the hand stays above a block's middle."""
LOWERED = 0.03
"""Gap between a held block and the one below at which it is let go, m."""
SETTLES = 2
"""Actions that a block is given to come to rest."""

Done = Callable[[State], bool]


class Waypoints:
    """Straight lines between configurations; blocked where an obstruction is run into, or where they end short."""

    def __init__(self, robot: Object, first: Felt, corners: Sequence[Configuration], done: Done) -> None:
        self._robot, self._done, self._begun = robot, done, False
        self._points = list(_between(Configuration.of(first.state[robot]), corners))

    def step(self, seen: Felt) -> np.ndarray | SkillOutcome:
        if self._done(seen.state):
            return SkillOutcome(SkillEnd.DONE)
        # What was run into before this skill began is not its own failure.
        if self._begun and seen.run_into:
            return SkillOutcome(SkillEnd.BLOCKED, "something is in the way")
        if not self._points:
            return SkillOutcome(SkillEnd.BLOCKED, "it did not get where it wanted")
        self._begun = True
        return _change(Configuration.of(seen.state[self._robot]), self._points.pop(0))


class Refused:
    """A skill that makes no sense."""

    def __init__(self, why: str) -> None:
        self._why = why

    def step(self, seen: Felt) -> SkillOutcome:
        return SkillOutcome(SkillEnd.REFUSED, self._why)


def reach_to_grasp(objects: tuple[Object, ...], first: Felt) -> Waypoints:
    """Draw in the arm and open; up, over the block, and down around it."""
    robot, block = objects
    at = Configuration.of(first.state[robot])
    x, y = map(float, first.state[block][:2])
    drawn_in = replace(at, arm=ARM[0], gap=GAP[1])
    up = replace(drawn_in, y=TRAVEL)
    over = replace(up, x=x, theta=DOWN)
    around = replace(over, y=y + GRASP_BELOW + ARM[0] + MIDDLE)
    low = around.y + 0.01

    def done(state: State) -> bool:
        hand = Configuration.of(state[robot])
        return ready_grasp(state, objects) > 0 and hand.y < low and abs(hand.x - x) < 0.02

    return Waypoints(robot, first, (drawn_in, up, over, around), done)


def grasp(objects: tuple[Object, ...], first: Felt) -> Waypoints:
    robot, _ = objects
    at = Configuration.of(first.state[robot])
    return Waypoints(robot, first, (replace(at, gap=GAP[0]),), lambda state: holding(state, objects) > 0)


def reach_to_place(objects: tuple[Object, ...], first: Felt) -> Waypoints | Refused:
    """Up, over the other block, and down until nearly upon it."""
    robot, block, below = objects
    if not holding(first.state, (robot, block)):
        return Refused(f"{block} is not held")
    at = Configuration.of(first.state[robot])
    up = replace(at, y=TRAVEL)
    upright = replace(up, theta=DOWN, arm=ARM[0])
    # Where the base is, once the block hangs over the other one.
    hangs = at.local(tuple(first.state[block][:2]))
    aside, beneath = -hangs[1], hangs[0] - at.arm + ARM[0]
    x, y = map(float, first.state[below][:2])
    over = replace(upright, x=x + aside)
    half = float(first.state.get(block, "height")[0] + first.state.get(below, "height")[0]) / 2
    lowered = replace(over, y=y + half + LOWERED + beneath)
    return Waypoints(robot, first, (up, upright, over, lowered), lambda s: _lowered(s, block, below))


def _lowered(state: State, block: Object, below: Object) -> bool:
    aside, gap = above(state, block, below)
    return aside < 0.02 and 0.0 <= gap < LOWERED + 0.005


class Place:
    """Opens the hand, and waits until the block lies."""

    def __init__(self, objects: tuple[Object, ...], first: Felt) -> None:
        robot, block, below = objects
        self._objects, self._waited = (block, below), 0
        at = Configuration.of(first.state[robot])
        self._opening = Waypoints(robot, first, (replace(at, gap=GAP[1]),), lambda state: False)

    def step(self, seen: Felt) -> np.ndarray | SkillOutcome:
        answer = self._opening.step(seen)
        if not isinstance(answer, SkillOutcome) or seen.run_into:
            return answer
        if self._waited >= SETTLES:
            lies = on(seen.state, self._objects) > 0
            return (
                SkillOutcome(SkillEnd.DONE)
                if lies
                else SkillOutcome(SkillEnd.BLOCKED, "the block does not lie where it should")
            )
        self._waited += 1
        return np.zeros(len(LIMITS))


def skills() -> tuple[Skill, ...]:
    kinds = (
        ("ReachToGrasp", (ROBOT, BLOCK), reach_to_grasp),
        ("Grasp", (ROBOT, BLOCK), grasp),
        ("ReachToPlace", (ROBOT, BLOCK, BLOCK), reach_to_place),
        ("Place", (ROBOT, BLOCK, BLOCK), Place),
    )
    return tuple(Skill(name, types, start, RATE_HZ, time_limit_s=60, live_state=True) for name, types, start in kinds)


def _between(start: Configuration, corners: Sequence[Configuration]) -> list[Configuration]:
    """Points on the way, so near to each other that one action leads from each to the next."""
    points, here = [], np.array(start.values())
    most = GENTLE * np.array(list(LIMITS.values()))
    for corner in corners:
        there = np.array(corner.values())
        way = there - here
        way[2] = math.remainder(way[2], 2 * math.pi)
        count = math.ceil(float(np.max(np.abs(way) / most)) - 1e-6)
        points += [Configuration(*(here + way * (i + 1) / count)) for i in range(count)]
        here = there
    return points


def _change(here: Configuration, there: Configuration) -> np.ndarray:
    """(5,) the action that leads from one to the other, as far as it may."""
    way = [b - a for a, b in zip(here.values(), there.values(), strict=True)]
    way[2] = math.remainder(way[2], 2 * math.pi)
    return np.array([min(max(d, -GENTLE * most), GENTLE * most) for d, most in zip(way, LIMITS.values(), strict=True)])
