"""The simulator of Blocked Stacking: what moves, what is held, and which scenes can be.

An action with which nothing can touch anything is only arithmetic; all others are `physics`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.core.world import Observation
from resync_robot.sim_training.domains.blocked_stacking.body import (
    FINGER,
    FINGER_AHEAD,
    GAP,
    LIMITS,
    Bounds,
    Configuration,
    Polygon,
    bounds,
    box,
    overlap,
    together,
)
from resync_robot.sim_training.domains.blocked_stacking.physics import NEAR, Action, Moving, Thing
from resync_robot.sim_training.domains.blocked_stacking.picture import draw
from resync_robot.sim_training.domains.blocked_stacking.vocabulary import (
    BENCH,
    BLOCK,
    CRATE,
    OBSTRUCTIONS,
    ROBOT,
    SLAB,
    WALL,
    WORLD,
)

OVERLAP = 0.006
"""m that things may overlap in a state that can be: a little more than what contacts leave behind."""
STAYS = 0.01
"""m and rad that something may move by itself in a scene that stands."""
STILL = (0.0,) * len(LIMITS)
"""An action that moves nothing."""
MARGIN = 0.02
"""m between two things up to which they may come to touch within an action that does not lead them so far."""
TOUCH = 0.002
"""m from a block's side at which a finger touches it."""
GRASP_TILT, GRASP_DEPTH, GRASP_OFF = 0.15, 0.04, 0.1
"""A block can be grasped that is so square to the hand, rad, so deep between its fingers, and so near its middle, m."""


@dataclass(frozen=True, kw_only=True)
class Felt(Observation):
    """What the robot notices besides.

    Attributes:
        run_into: whether it, or what it holds, has just run into an obstruction.
    """

    run_into: bool


class Bench:
    """One world."""

    def __init__(self, task: Task) -> None:
        self._physics = {k: float(v) for k, v in task.physics.items()}
        self._robot = next(o for o in task.objects if o.type == ROBOT)
        self.reset(task.initial)

    # -- what learning relies on --------------------------------------------------------------------------------------

    def reset(self, state: State) -> bool:
        self.time, self._resting = 0.0, False
        self._touched: dict[Object, float] = {}
        self._furnish(state)
        self._at = Configuration.of(state[self._robot])
        self._places = {o: Moving(*map(float, state[o][:3])) for o in self._things}
        self._held: Object | None = None
        self._grip = (0.0, 0.0, 0.0)
        held = [o for o in state.of_type(BLOCK) if state.get(o, "held")[0] > 0.5]
        if len(held) > 1 or (held and not self._holds(held[0], self._at.gap)):
            return False
        if held:
            self._hold(held[0])
        return self._apart() and self._stands()

    def _furnish(self, state: State) -> None:
        """What there is, how large, and where all that is fixed."""
        self._given = state
        self._size = {o: (float(state[o][3]), float(state[o][4])) for o in state if o != self._robot}
        physics = self._physics
        self._things = {
            o: Thing(*size, physics[f"{o.type.name}_mass"], physics["friction"])
            for o, size in self._size.items()
            if o.type in (BLOCK, CRATE)
        }
        self._fixed = {o: box(*map(float, state[o][:5])) for o in state if o.type in (SLAB, WALL)}

    def save(self) -> Any:
        moving = replace(self._at), dict(self._places), self._held, self._grip, self._resting
        return self._given, self.time, self._touched, moving

    def restore(self, snapshot: Any) -> None:
        given, self.time, touched, (at, places, self._held, self._grip, self._resting) = snapshot
        if given is not self._given:
            self._furnish(given)
        self._at, self._places, self._touched = replace(at), dict(places), dict(touched)

    def observe(self, live: bool = False) -> Felt:
        return Felt(time=self.time, state=self.perceive(), run_into=bool(self._touched))

    def perceive(self) -> State:
        features = {o: self._given[o] for o in self._given}
        features[self._robot] = self._at.features()
        for obj, thing in self._places.items():
            place = (thing.x, thing.y, _upright(thing.theta) if obj.type == BLOCK else thing.theta)
            rest = self._size[obj] if obj.type == CRATE else (*self._size[obj], float(obj == self._held))
            features[obj] = np.array([*place, *rest])
        return State(features)

    def contacts(self) -> Mapping[Object, float]:
        """The obstructions that the robot, or the block that it holds, ran into during the last action: 1 each."""
        return dict(self._touched)

    def act(self, action: np.ndarray, duration: float) -> None:
        """`action` = (dx, dy, dtheta, darm, dgap): by how much the robot moves within `duration`, m and rad."""
        step = [min(max(float(a), -most), most) for a, most in zip(action, LIMITS.values(), strict=True)]
        self.time, self._touched = self.time + duration, {}
        # However little: where it took hold of a block with the fingers far apart, little more is left to open.
        opens = self._held is not None and step[4] > 1e-6
        if self._held is None and step[4] < -0.001:
            self._close(self._at.gap + step[4])
        if self._held is not None and not opens:
            step[4] = 0.0
        parts = self._may_touch(step)
        if self._resting and not parts:
            self._at = self._at.moved(step)
            self._carry()
        else:
            self._do(step, duration, parts)
        if opens:
            self._held, self._resting = None, False

    def _do(self, step: Sequence[float], duration: float, parts: Sequence[int], near: float = NEAR) -> None:
        """Move the robot by physics, and what these parts of it push, or what moves anyway."""
        held = self._held
        free = {o: place for o, place in self._places.items() if o != held}
        carried = None if held is None else box(*self._grip, *self._size[held])
        grip = self._physics["grip"] / self._physics["friction"]
        action = Action(self._at, free, self._things, self._fixed, grip, carried, parts, near)
        action.run(step, duration)
        self._at = action.at
        self._places.update(action.places)
        self._carry()
        self._touched = {o: 1.0 for o in action.touched if o.type in OBSTRUCTIONS}
        self._resting = all(place.rests for o, place in self._places.items() if o != held)

    def picture(self) -> np.ndarray:
        """(320, 724, 3) the scene from the side."""
        return draw(self.perceive(), self._at, {o.name for o in self._touched})

    # -- grasping -----------------------------------------------------------------------------------------------------

    def _close(self, gap: float) -> None:
        """Take hold of a block that the fingers, closing to that gap, come to touch."""
        for obj in [o for o in self._things if o.type == BLOCK]:
            if self._holds(obj, max(gap, GAP[0])):
                self._hold(obj)
                return

    def _holds(self, obj: Object, gap: float) -> bool:
        """Do fingers with that gap hold the block?"""
        thing, (width, height) = self._places[obj], self._size[obj]
        ahead, aside = self._at.local((thing.x, thing.y))
        # What the palm has before it.
        between = self._at.arm + FINGER_AHEAD + FINGER[0] / 2 - (ahead - height / 2)
        square = abs(_upright(self._at.theta - thing.theta)) < GRASP_TILT
        touched = (gap - FINGER[1]) / 2 < abs(aside) + width / 2 + TOUCH
        return square and touched and between > GRASP_DEPTH and ahead > self._at.arm and abs(aside) < GRASP_OFF

    def _hold(self, obj: Object) -> None:
        thing, width = self._places[obj], self._size[obj][0]
        self._held, self._grip = obj, (*self._at.local((thing.x, thing.y)), thing.theta - self._at.theta)
        self._grip = (self._grip[0] - self._at.arm, *self._grip[1:])
        self._at.gap = min(max(2 * abs(self._grip[1]) + width + FINGER[1], GAP[0]), self._at.gap)

    def _carry(self) -> None:
        if self._held is None:
            return
        self._places[self._held] = Moving(*self._carried_by(self._at))

    def _carried_by(self, at: Configuration) -> tuple[float, float, float]:
        """Where the held block is in that configuration."""
        ahead, aside, turned = self._grip
        return *at.at(at.arm + ahead, aside), at.theta + turned

    # -- scenes -------------------------------------------------------------------------------------------------------

    def _apart(self) -> bool:
        """Nothing overlaps that cannot, and nothing lies beyond the walls or in the bench."""
        shapes = {o: box(t.x, t.y, t.theta, *self._size[o]) for o, t in self._places.items()} | self._fixed
        inside = all(-OVERLAP <= x <= WORLD[0] + OVERLAP for p in shapes.values() for x, _ in p)
        above = all(y > BENCH - OVERLAP for o in self._things for _, y in shapes[o])
        parts = self._at.parts()
        above = above and all(y > BENCH - OVERLAP for part in parts for _, y in part)
        pairs: list[tuple[Polygon, Polygon]] = [(shapes[a], shapes[b]) for a, b in combinations(shapes, 2)]
        pairs += [(part, shape) for o, shape in shapes.items() if o != self._held for part in parts]
        return inside and above and all(overlap(a, b) < OVERLAP for a, b in pairs)

    def _stands(self) -> bool:
        """Let everything come to rest; whether it was about where it rests."""
        before = dict(self._places)
        for _ in range(5):
            self._do(STILL, 0.2, self._may_touch(STILL), near=math.inf)
            if self._resting:
                break
        self._touched = {}
        moved = [
            max(abs(a.x - b.x), abs(a.y - b.y), abs(a.theta - b.theta))
            for a, b in zip(before.values(), self._places.values(), strict=True)
        ]
        return self._resting and max(moved, default=0.0) < STAYS

    def _may_touch(self, step: Sequence[float]) -> tuple[int, ...]:
        """Which parts of the robot could touch something on the way: base, palm, left and right finger."""
        then = self._at.moved(step)
        ways = [together(a, b) for a, b in zip(self._at.bounds(), then.bounds(), strict=True)]
        if self._held is not None:
            place, size = self._places[self._held], self._size[self._held]
            carried = bounds(place.x, place.y, place.theta, *size), bounds(*self._carried_by(then), *size)
            ways[1] = together(ways[1], together(*carried))
        low, x0, x1 = min(w[1] for w in ways), min(w[0] for w in ways), max(w[2] for w in ways)
        near = []
        for obj, size in self._size.items():
            at = self._places.get(obj)
            x, y, theta = map(float, self._given[obj][:3]) if at is None else (at.x, at.y, at.theta)
            reach = (size[0] + size[1]) / 2 + MARGIN
            if obj != self._held and x0 - reach < x < x1 + reach and low < y + reach:
                near.append(bounds(x, y, theta, *size))
        if not near and low > BENCH + MARGIN:
            return ()
        return tuple(i for i, way in enumerate(ways) if way[1] < BENCH + MARGIN or any(_meet(way, b) for b in near))


def _meet(a: Bounds, b: Bounds) -> bool:
    return a[0] < b[2] + MARGIN and b[0] < a[2] + MARGIN and a[1] < b[3] + MARGIN and b[1] < a[3] + MARGIN


def _upright(theta: float) -> float:
    """The heading of a square, as the side that it stands on has it: within an eighth of a turn of level."""
    return math.remainder(theta, math.pi / 2)
