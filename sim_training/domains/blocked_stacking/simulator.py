"""The physics of Blocked Stacking, by pymunk: a robot that moves as it is told, among things that it pushes.

What cannot give way pushes the robot back, so that it slides along and never squeezes anything. A space lives for one
action only and takes nothing over from the last one but places and velocities: the same actions from the same
snapshot lead to exactly the same state. An action with which nothing can touch anything needs no space at all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
import pymunk

from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.core.world import Observation
from resync_robot.sim_training.domains.blocked_stacking import body as robot_body
from resync_robot.sim_training.domains.blocked_stacking.body import FINGER, GAP, LIMITS, Configuration, box, overlap
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

STEPS = 12
"""Of physics, for an action."""
GRAVITY = 9.8
GIVE = 0.002
"""m that the robot may be pressed into something."""
OVERLAP = 0.006
"""m that things may overlap in a state that can be: a little more than what contacts leave behind."""
STAYS = 0.01
"""m and rad that something may move by itself in a scene that stands."""
AT_REST = 0.01
"""m/s and rad/s below which a thing comes to rest."""
ROBOT_PART, THING, FIXED = 1, 2, 3
GRASP_TILT, GRASP_DEPTH, GRASP_OFF = 0.15, 0.04, 0.1
"""A block can be grasped that is so square to the hand, rad, so deep between its fingers, and so near its middle, m."""


@dataclass(frozen=True, kw_only=True)
class Felt(Observation):
    """What the robot notices besides.

    Attributes:
        run_into: whether it, or what it holds, has just run into an obstruction.
    """

    run_into: bool


@dataclass(frozen=True, slots=True)
class Moving:
    """Where a thing is, and how it moves: m, rad, m/s, rad/s."""

    x: float
    y: float
    theta: float
    vx: float = 0.0
    vy: float = 0.0
    omega: float = 0.0


class Bench:
    """One world."""

    def __init__(self, task: Task) -> None:
        self._physics = {k: float(v) for k, v in task.physics.items()}
        self._robot = next(o for o in task.objects if o.type == ROBOT)
        self.reset(task.initial)

    # -- what learning relies on --------------------------------------------------------------------------------------

    def reset(self, state: State) -> bool:
        self._given, self.time, self._touched = state, 0.0, {}
        self._size = {o: tuple(map(float, state[o][3:5])) for o in state if o != self._robot}
        self._at = Configuration.of(state[self._robot])
        self._things = {o: Moving(*map(float, state[o][:3])) for o in state if o.type in (BLOCK, CRATE)}
        self._fixed = {o: box(*map(float, state[o][:5])) for o in state if o.type in (SLAB, WALL)}
        self._held: Object | None = None
        self._grip = (0.0, 0.0, 0.0)
        self._resting = False
        held = [o for o in state.of_type(BLOCK) if state.get(o, "held")[0] > 0.5]
        if len(held) > 1 or (held and not self._holds(held[0], self._at.gap)):
            return False
        if held:
            self._hold(held[0])
        return self._apart() and self._stands()

    def save(self) -> Any:
        return self.time, replace(self._at), dict(self._things), self._held, self._grip, self._resting, self._touched

    def restore(self, snapshot: Any) -> None:
        self.time, at, things, self._held, self._grip, self._resting, touched = snapshot
        self._at, self._things, self._touched = replace(at), dict(things), dict(touched)

    def observe(self, live: bool = False) -> Felt:
        return Felt(time=self.time, state=self.perceive(), run_into=bool(self._touched))

    def perceive(self) -> State:
        features = {o: self._given[o] for o in self._given}
        features[self._robot] = self._at.features()
        for obj, thing in self._things.items():
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
        opens = self._held is not None and step[4] > 0.001
        if self._held is None and step[4] < -0.001:
            self._close(self._at.gap + step[4])
        if self._held is not None and not opens:
            step[4] = 0.0
        if self._resting and not self._may_touch():
            self._at = self._at.moved(step)
        else:
            _Episode(self, step, duration).run()
        if self._held is not None:
            self._carry()
            if opens:
                self._held, self._resting = None, False

    def picture(self) -> np.ndarray:
        """(320, 720, 3) the scene from the side."""
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
        thing, (width, height) = self._things[obj], self._size[obj]
        ahead, aside = self._at.local((thing.x, thing.y))
        # What the palm has before it.
        between = self._at.arm + robot_body.FINGER_AHEAD + FINGER[0] / 2 - (ahead - height / 2)
        square = abs(_upright(self._at.theta - thing.theta)) < GRASP_TILT
        touched = (gap - FINGER[1]) / 2 < abs(aside) + width / 2 + GIVE
        return square and touched and between > GRASP_DEPTH and ahead > self._at.arm and abs(aside) < GRASP_OFF

    def _hold(self, obj: Object) -> None:
        thing, width = self._things[obj], self._size[obj][0]
        self._held, self._grip = obj, (*self._at.local((thing.x, thing.y)), thing.theta - self._at.theta)
        self._grip = (self._grip[0] - self._at.arm, *self._grip[1:])
        self._at.gap = min(max(2 * abs(self._grip[1]) + width + FINGER[1], GAP[0]), self._at.gap)

    def _carry(self) -> None:
        ahead, aside, turned = self._grip
        place = self._at.at(self._at.arm + ahead, aside)
        self._things[self._held] = Moving(*place, self._at.theta + turned)

    # -- scenes -------------------------------------------------------------------------------------------------------

    def _apart(self) -> bool:
        """Nothing overlaps that cannot, and nothing lies beyond the walls or in the bench."""
        shapes = {o: box(t.x, t.y, t.theta, *self._size[o]) for o, t in self._things.items()} | self._fixed
        inside = all(-OVERLAP <= x <= WORLD[0] + OVERLAP for p in shapes.values() for x, _ in p)
        above = all(y > BENCH - OVERLAP for o in self._things for _, y in shapes[o])
        parts = self._at.parts()
        above = above and all(y > BENCH - OVERLAP for part in parts for _, y in part)
        pairs = [(shapes[a], shapes[b]) for a, b in combinations(shapes, 2)]
        pairs += [(part, shape) for o, shape in shapes.items() if o != self._held for part in parts]
        return inside and above and all(overlap(a, b) < OVERLAP for a, b in pairs)

    def _stands(self) -> bool:
        """Let everything come to rest; whether it was about where it rests."""
        before = dict(self._things)
        for _ in range(5):
            _Episode(self, (0.0,) * 5, 0.2).run()
            if self._resting:
                break
        self._touched = {}
        moved = [
            max(abs(a.x - b.x), abs(a.y - b.y), abs(a.theta - b.theta))
            for a, b in zip(before.values(), self._things.values(), strict=True)
        ]
        return self._resting and max(moved, default=0.0) < STAYS

    def _may_touch(self) -> bool:
        """Could the robot, with any one action, come to touch something?"""
        at = self._at
        ahead = at.arm + robot_body.FINGER_AHEAD
        x, y = at.at(ahead)
        low = min(y, at.y)
        reach = 0.25 + 0.2 * (self._held is not None) + 0.18
        if low < BENCH + reach:
            return True
        dx, dy = (x - at.x) / ahead, (y - at.y) / ahead
        for obj, (w, h) in self._size.items():
            if obj == self._held:
                continue
            if obj in self._things:
                ox, oy = self._things[obj].x, self._things[obj].y
            else:
                ox, oy = map(float, self._given[obj][:2])
            along = min(max((ox - at.x) * dx + (oy - at.y) * dy, -0.2), ahead)
            if math.hypot(ox - at.x - along * dx, oy - at.y - along * dy) < reach + math.hypot(w, h) / 2:
                return True
        return False


class _Episode:
    """One action of a world, with physics."""

    def __init__(self, world: Bench, step: Any, duration: float) -> None:
        self._world, self._step, self._dt = world, step, duration / STEPS
        self._space = pymunk.Space()
        self._space.gravity = 0.0, -GRAVITY
        self._space.collision_slop = 5e-4
        self._space.iterations = 15
        self._named: dict[pymunk.Shape, Object] = {}
        self._add_fixed()
        self._bodies = {o: self._thing(o) for o in world._things if o != world._held}
        self._robot = self._kinematic()
        self._push = (0.0, 0.0)
        for other, when in ((THING, "post_solve"), (FIXED, "pre_solve")):
            self._space.on_collision(ROBOT_PART, other, **{when: self._touch})

    def run(self) -> None:
        world = self._world
        for _ in range(STEPS):
            now, self._push = world._at, (0.0, 0.0)
            then = now.moved(self._step, 1 / STEPS)
            self._drive(now, then)
            self._space.step(self._dt)
            if self._push != (0.0, 0.0):
                then = then.moved((*self._push, 0.0, 0.0, 0.0))
            world._at = then
        still = True
        for obj, body in self._bodies.items():
            (x, y), (vx, vy), omega = body.position, body.velocity, body.angular_velocity
            if max(abs(vx), abs(vy), abs(omega)) < AT_REST:
                vx = vy = omega = 0.0
            else:
                still = False
            world._things[obj] = Moving(x, y, body.angle, vx, vy, omega)
        world._resting = still

    def _touch(self, arbiter: pymunk.Arbiter, _space: Any, _data: Any) -> None:
        """The robot touches something: note what, and how far that pushes it back."""
        shape = arbiter.shapes[1]
        obj = self._named.get(shape)
        if obj is not None and obj.type in OBSTRUCTIONS:
            self._world._touched[obj] = 1.0
        if shape.collision_type == FIXED:
            arbiter.process_collision = False
        met = arbiter.contact_point_set
        depth = -min((p.distance for p in met.points), default=0.0) - GIVE
        nx, ny = met.normal
        (px, py) = self._push
        more = depth - (-px * nx - py * ny)
        if more > 0:
            self._push = px - nx * more, py - ny * more

    def _add_fixed(self) -> None:
        world, ground = self._world, self._space.static_body
        width, height = WORLD
        for obj, polygon in (
            (None, [(-1, -1), (width + 1, -1), (width + 1, BENCH), (-1, BENCH)]),
            (None, [(-1, 0), (0, 0), (0, height), (-1, height)]),
            (None, [(width, 0), (width + 1, 0), (width + 1, height), (width, height)]),
            *world._fixed.items(),
        ):
            shape = pymunk.Poly(ground, polygon)
            shape.friction, shape.collision_type = 1.0, FIXED
            self._space.add(shape)
            if obj is not None:
                self._named[shape] = obj

    def _thing(self, obj: Object) -> pymunk.Body:
        world, (w, h) = self._world, self._world._size[obj]
        thing, mass = world._things[obj], world._physics[f"{obj.type.name}_mass"]
        body = pymunk.Body(mass, pymunk.moment_for_box(mass, (w, h)))
        body.position, body.angle = (thing.x, thing.y), thing.theta
        body.velocity, body.angular_velocity = (thing.vx, thing.vy), thing.omega
        shape = pymunk.Poly(body, box(0.0, 0.0, 0.0, w, h))
        # Frictions multiply.
        shape.friction, shape.collision_type = world._physics["friction"], THING
        self._space.add(body, shape)
        self._named[shape] = obj
        return body

    def _kinematic(self) -> tuple[pymunk.Body, ...]:
        """Base, palm with its bar (and what is held), left and right finger."""
        world = self._world
        friction = world._physics["grip"] / world._physics["friction"]
        bodies = tuple(pymunk.Body(body_type=pymunk.Body.KINEMATIC) for _ in range(4))
        shapes: list[pymunk.Shape] = [
            pymunk.Circle(bodies[0], robot_body.BASE_RADIUS),
            pymunk.Poly(bodies[1], box(0.0, 0.0, 0.0, *robot_body.PALM)),
            pymunk.Poly(bodies[1], box(-robot_body.BAR_BEHIND, 0.0, 0.0, *robot_body.BAR)),
            *(pymunk.Poly(body, box(0.0, 0.0, 0.0, *FINGER)) for body in bodies[2:]),
        ]
        if world._held is not None:
            shapes.append(pymunk.Poly(bodies[1], box(*world._grip, *world._size[world._held])))
        for shape in shapes:
            shape.friction, shape.collision_type, shape.filter = friction, ROBOT_PART, pymunk.ShapeFilter(group=1)
        for body, (x, y) in zip(bodies, self._places(world._at), strict=True):
            body.position, body.angle = (x, y), world._at.theta
        self._space.add(*bodies, *shapes)
        return bodies

    @staticmethod
    def _places(at: Configuration) -> tuple[tuple[float, float], ...]:
        ahead = at.arm + robot_body.FINGER_AHEAD
        return (at.x, at.y), at.at(at.arm), at.at(ahead, at.gap / 2), at.at(ahead, -at.gap / 2)

    def _drive(self, now: Configuration, then: Configuration) -> None:
        """Let the next step of physics bring the robot from one configuration to the other."""
        turn = math.remainder(then.theta - now.theta, 2 * math.pi) / self._dt
        for body, (x0, y0), (x1, y1) in zip(self._robot, self._places(now), self._places(then), strict=True):
            body.position, body.angle = (x0, y0), now.theta
            body.velocity, body.angular_velocity = ((x1 - x0) / self._dt, (y1 - y0) / self._dt), turn


def _upright(theta: float) -> float:
    """The heading of a square, as the side that it stands on has it: within an eighth of a turn of level."""
    return math.remainder(theta, math.pi / 2)
