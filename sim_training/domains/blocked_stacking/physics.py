"""The physics of one action, by pymunk: a robot that moves as it is told, among things that it pushes.

What does not give way holds the robot up, so that it slides along and squeezes nothing. A space lives for one action
and takes nothing over from the last one but places and velocities: the same actions from the same snapshot lead to
exactly the same state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pymunk

from resync_robot.core.symbols import Object
from resync_robot.sim_training.domains.blocked_stacking.body import (
    BAR,
    BAR_BEHIND,
    BASE_RADIUS,
    FINGER,
    PALM,
    Configuration,
    Point,
    Polygon,
    box,
)
from resync_robot.sim_training.domains.blocked_stacking.vocabulary import BENCH, WORLD

STEPS = 8
"""Of an action."""
ITERATIONS = 12
GRAVITY = 9.8
SLOP = 5e-4
"""m that things may overlap without being pushed apart."""
BIAS = 1e-6
"""Share of an overlap that is left after a second."""
WEIGHT = 3.0
"""kg of each part of the robot, as what it runs into feels it. It presses with no more than what stops that within a
step: 30 N where it goes at 0.2 m/s."""
AT_REST, SETTLED = 0.01, 5e-4
"""m/s and rad/s below which a thing comes to rest at the end of an action, and m that it moved meanwhile at most."""
NEAR = 1.2
"""m aside of the robot up to which something at rest can be moved within one action, be it by something else."""
ROBOT_PART, THING, FIXED = 1, 2, 3
BASE, HELD_BY = 0, 1
"""The parts that are no fingers: the base, and the palm with its bar and what it holds."""

# What `body.velocity = ...` does, without what pymunk's type checking costs.
_set_velocity, _set_turning = pymunk.Body.velocity.fset, pymunk.Body.angular_velocity.fset
_set_force = pymunk.Body.force.fset


@dataclass(frozen=True, slots=True)
class Moving:
    """Where a thing is, and how it moves: m, rad, m/s, rad/s."""

    x: float
    y: float
    theta: float
    vx: float = 0.0
    vy: float = 0.0
    omega: float = 0.0

    @property
    def rests(self) -> bool:
        return self.vx == self.vy == self.omega == 0.0


@dataclass(frozen=True, slots=True)
class Thing:
    """Something that can be pushed: its size, m, mass, kg, and friction; that of two things is the product."""

    width: float
    height: float
    mass: float
    friction: float


class Action:
    """One action among things.

    Args:
        fixed: what does not move.
        grip: the friction of the robot's parts.
        carried: the block that it holds, in the frame of its palm.
        parts: of the robot, that could touch something: 0 the base, 1 palm and bar, 2 and 3 the fingers.
        near: m aside of the robot up to which things at rest are looked at.
    """

    def __init__(
        self,
        at: Configuration,
        places: Mapping[Object, Moving],
        things: Mapping[Object, Thing],
        fixed: Mapping[Object, Polygon],
        grip: float,
        carried: Polygon | None,
        parts: Sequence[int],
        near: float,
    ) -> None:
        self.at, self.places, self.touched = at, dict(places), set[Object]()
        space = self._space = pymunk.Space()
        space.collision_slop, space.collision_bias, space.iterations = SLOP, BIAS, ITERATIONS
        self._named: dict[pymunk.Shape, Object] = {}
        self._add_fixed(fixed, near)
        self._bodies = {
            obj: self._thing(obj, things[obj], place)
            for obj, place in places.items()
            if not place.rests or abs(place.x - at.x) < near
        }
        self._robot = self._parts(grip, carried, parts)
        self._touches = False
        for other in (THING, FIXED):
            space.on_collision(ROBOT_PART, other, post_solve=self._touch)

    def run(self, step: Sequence[float], duration: float) -> None:
        """Move the robot by (dx, dy, dtheta, darm, dgap) within `duration`, and whatever it pushes."""
        dt = duration / STEPS
        for body in self._robot.values():
            _set_turning(body, step[2] / duration)
        weights = [(body, (0.0, -GRAVITY * body.mass)) for body in self._bodies.values()]
        before: Sequence[Point] = self.at.middles()
        for _ in range(STEPS):
            self.at = self.at.moved(step, 1 / STEPS)
            after, wanted = self.at.middles(), {}
            for part, body in self._robot.items():
                (x0, y0), (x1, y1) = before[part], after[part]
                wanted[part] = (x1 - x0) / dt, (y1 - y0) / dt
                _set_velocity(body, wanted[part])
            for body, weight in weights:
                _set_force(body, weight)
            self._touches = False
            self._space.step(dt)
            before = self._give_way(after, wanted, dt) if self._touches else after
        for obj, body in self._bodies.items():
            (x, y), (vx, vy), omega = body.position, body.velocity, body.angular_velocity
            was = self.places[obj]
            if max(abs(vx), abs(vy), abs(omega)) < AT_REST and max(abs(x - was.x), abs(y - was.y)) < SETTLED:
                vx = vy = omega = 0.0
            self.places[obj] = Moving(x, y, body.angle, vx, vy, omega)

    def _give_way(self, places: Sequence[Point], wanted: Mapping[int, Point], dt: float) -> Sequence[Point]:
        """Let all of the robot follow that of its parts which was held up most. Returns where its parts are then."""
        most = 0.0, 0.0
        for part, body in self._robot.items():
            # pymunk first moves, then looks for contacts and says how fast to go on.
            (x, y), (vx, vy), here, speed = places[part], wanted[part], body.position, body.velocity
            off = here.x - x + (speed.x - vx) * dt, here.y - y + (speed.y - vy) * dt
            most = max(most, off, key=lambda d: math.hypot(*d))
        self.at = self.at.moved((*most, 0.0, 0.0, 0.0))
        middles = self.at.middles()
        for part, body in self._robot.items():
            body.position = middles[part]
        return middles

    def _touch(self, arbiter: pymunk.Arbiter, _space: Any, _data: Any) -> None:
        self._touches = True
        obj = self._named.get(arbiter.shapes[1])
        if obj is not None:
            self.touched.add(obj)

    def _add_fixed(self, fixed: Mapping[Object, Polygon], near: float) -> None:
        width, height = WORLD
        around: list[Polygon] = [[(-1, -1), (width + 1, -1), (width + 1, BENCH), (-1, BENCH)]]
        if self.at.x < near:
            around.append([(-1, 0), (0, 0), (0, height), (-1, height)])
        if self.at.x > width - near:
            around.append([(width, 0), (width + 1, 0), (width + 1, height), (width, height)])
        beside = {o: polygon for o, polygon in fixed.items() if abs(polygon[0][0] - self.at.x) < near}
        for obj, polygon in (*((None, p) for p in around), *beside.items()):
            shape = pymunk.Poly(self._space.static_body, polygon)
            shape.friction, shape.collision_type = 1.0, FIXED
            self._space.add(shape)
            if obj is not None:
                self._named[shape] = obj

    def _thing(self, obj: Object, thing: Thing, place: Moving) -> pymunk.Body:
        size = thing.width, thing.height
        body = pymunk.Body(thing.mass, pymunk.moment_for_box(thing.mass, size))
        body.position, body.angle = (place.x, place.y), place.theta
        body.velocity, body.angular_velocity = (place.vx, place.vy), place.omega
        shape = pymunk.Poly(body, box(0.0, 0.0, 0.0, *size))
        shape.friction, shape.collision_type = thing.friction, THING
        self._space.add(body, shape)
        self._named[shape] = obj
        return body

    def _parts(self, grip: float, carried: Polygon | None, parts: Sequence[int]) -> dict[int, pymunk.Body]:
        bodies, middles = {part: pymunk.Body(WEIGHT, math.inf) for part in parts}, self.at.middles()
        shapes: list[pymunk.Shape] = []
        for part, body in bodies.items():
            body.position, body.angle = middles[part], self.at.theta
            if part == BASE:
                shapes.append(pymunk.Circle(body, BASE_RADIUS))
            elif part == HELD_BY:
                shapes.append(pymunk.Poly(body, box(0.0, 0.0, 0.0, *PALM)))
                shapes.append(pymunk.Poly(body, box(-BAR_BEHIND, 0.0, 0.0, *BAR)))
                if carried is not None:
                    shapes.append(pymunk.Poly(body, carried))
            else:
                shapes.append(pymunk.Poly(body, box(0.0, 0.0, 0.0, *FINGER)))
        itself = pymunk.ShapeFilter(group=1)
        for shape in shapes:
            shape.friction, shape.collision_type, shape.filter = grip, ROBOT_PART, itself
        self._space.add(*bodies.values(), *shapes)
        return bodies
