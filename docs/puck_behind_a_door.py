"""A puck behind a door: a whole domain in one file, as `docs/own-domain.md` explains it.

A round robot fetches pucks from the room next door and brings them to pads. Its given skill drives gently, and a closed
door or a stone in the doorway stops it. What it has to learn is to push: the door turns about its hinge and stays where
it is left, the stone gives way.

    resync-robot check-domain docs/puck_behind_a_door.py
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from resync_robot.core.embodiment import Embodiment, Stage
from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import ROUND, SE2, Object, Operator, Predicate, Type, Variable
from resync_robot.core.task import Domain, Scenario, Task
from resync_robot.core.world import Observation

# -- what there is ----------------------------------------------------------------------------------------------------

_DISC: Mapping[str, Any] = {"pose": SE2, "extents": ("diameter", "diameter"), "symmetry": ROUND}
ROBOT = Type("robot", ("x", "y", "theta", "diameter", "grip"), exact=True, **_DISC)
PUCK = Type("puck", ("x", "y", "theta", "diameter"), **_DISC)
PAD = Type("pad", ("x", "y", "theta", "diameter"), **_DISC)
DOOR = Type("door", ("x", "y", "theta", "length", "thickness"), pose=SE2, extents=("length", "thickness"))
"""The pose is that of the middle of its leaf, x along it from the hinge. The wall stands where the hinge is."""
STONE = Type("stone", ("x", "y", "theta", "diameter"), **_DISC)

WIDTH, HEIGHT = 3.0, 1.6
"""Of both rooms together, m."""
CLOSED, WIDE_OPEN = math.pi / 2, -0.3
"""Headings of a leaf: it closes a doorway upwards of its hinge, and turns away from the robot."""
MOST_SPEED, MOST_FORCE = 1.0, 20.0
"""m/s that the robot drives at most, and N with which it then pushes; half as fast, it pushes half as hard."""
GENTLE = 0.2
"""m/s at which it fetches and brings; with 4 N it moves a puck, but neither door nor stone."""
REACH = 0.01
"""Gap to a puck at which it can be gripped, m."""
RATE_HZ = 10.0
STRIDE = 0.03
"""m that the robot moves at once; less than the radius of anything."""

HAND_EMPTY = Predicate("HandEmpty", (ROBOT,))
HOLDING = Predicate("Holding", (ROBOT, PUCK))
AT = Predicate("At", (PUCK, PAD))

_r, _p, _pad = Variable("?r", ROBOT), Variable("?p", PUCK), Variable("?pad", PAD)
FETCH = Operator(
    "Fetch", (_r, _p), frozenset({HAND_EMPTY(_r)}), frozenset({HOLDING(_r, _p)}), frozenset({HAND_EMPTY(_r)})
)
BRING = Operator(
    "Bring",
    (_r, _p, _pad),
    frozenset({HOLDING(_r, _p)}),
    frozenset({AT(_p, _pad), HAND_EMPTY(_r)}),
    frozenset({HOLDING(_r, _p)}),
)


def holding(state: State, objects: tuple[Object, ...]) -> float:
    robot, puck = objects
    return float(state.get(robot, "grip")[0] > 0.5 and _gap(state, robot, puck) < 1.5 * REACH)


def hand_empty(state: State, objects: tuple[Object, ...]) -> float:
    return 1.0 - max((holding(state, (objects[0], puck)) for puck in state.of_type(PUCK)), default=0.0)


def at(state: State, objects: tuple[Object, ...]) -> float:
    puck, pad = objects
    return float(math.dist(state[puck][:2], state[pad][:2]) < 0.04)


def _gap(state: State, a: Object, b: Object) -> float:
    """Between two round things, m."""
    return math.dist(state[a][:2], state[b][:2]) - float(state[a][3] + state[b][3]) / 2


# -- how it moves -----------------------------------------------------------------------------------------------------


@dataclass
class Disc:
    x: float
    y: float
    radius: float


@dataclass
class Leaf:
    """A door that is hinged at (x, y), in a wall that has no other opening."""

    x: float
    y: float
    length: float
    half: float
    theta: float

    def nearest(self, x: float, y: float) -> tuple[float, float, float]:
        """The point of the leaf nearest to (x, y), and how far it is from the hinge."""
        cos, sin = math.cos(self.theta), math.sin(self.theta)
        along = min(max((x - self.x) * cos + (y - self.y) * sin, 0.0), self.length)
        return self.x + along * cos, self.y + along * sin, along


class Rooms:
    """Two rooms, in which nothing moves but what is pushed.

    The robot and what it holds move in strides. What they overlap then is pushed on where the robot's force is more
    than its friction; by the overlap that is left they are pushed back, and so slide along whatever stands.
    """

    def __init__(self, task: Task) -> None:
        self._types = {o: o.type for o in task.objects}
        self._robot = next(o for o in task.objects if o.type is ROBOT)
        self._friction: Mapping[Type, float] = {PUCK: task.physics["puck"], STONE: task.physics["stone"]}
        self._door_friction = float(task.physics["door"])
        self.reset(task.initial)

    def reset(self, state: State) -> bool:
        self.time, self._given, self._touched = 0.0, state, {}
        self._grip, self._held = bool(state[self._robot][4] > 0.5), None
        self._discs = {o: Disc(*map(float, state[o][:2]), float(state[o][3] / 2)) for o in state if o.type is not DOOR}
        self._pads = {o: self._discs.pop(o) for o in state.of_type(PAD)}
        self._doors: dict[Object, Leaf] = {}
        for door in state.of_type(DOOR):
            x, y, theta, length, thickness = map(float, state[door])
            hinge = x - length / 2 * math.cos(theta), y - length / 2 * math.sin(theta)
            self._doors[door] = Leaf(*hinge, length, thickness / 2, min(max(theta, WIDE_OPEN), CLOSED))
        for puck in state.of_type(PUCK):
            if holding(state, (self._robot, puck)):
                self._held = puck
        far = max((abs(float(state[o][2]) - door.theta) for o, door in self._doors.items()), default=0.0)
        for _ in range(3):
            last = 0.0
            for obj, disc in self._discs.items():
                x, y = disc.x, disc.y
                self._push_out((obj,), (0.0, 0.0), 0.0, set())
                last = max(last, math.hypot(disc.x - x, disc.y - y))
            far = max(far, last)
        return far < 0.05 and last < 1e-6

    def save(self) -> Any:
        return (
            self.time,
            self._grip,
            self._held,
            {o: (d.x, d.y) for o, d in self._discs.items()},
            {o: d.theta for o, d in self._doors.items()},
            dict(self._touched),
        )

    def restore(self, snapshot: Any) -> None:
        self.time, self._grip, self._held, places, angles, touched = snapshot
        for obj, (x, y) in places.items():
            self._discs[obj].x, self._discs[obj].y = x, y
        for obj, theta in angles.items():
            self._doors[obj].theta = theta
        self._touched = dict(touched)

    def observe(self, live: bool = False) -> Observation:
        return Observation(time=self.time, state=self.perceive())

    def perceive(self) -> State:
        features = {o: self._given[o] for o in self._given}
        for obj, disc in self._discs.items():
            features[obj] = np.array([disc.x, disc.y, *features[obj][2:]])
        for obj, leaf in self._doors.items():
            x, y = leaf.length / 2 * math.cos(leaf.theta), leaf.length / 2 * math.sin(leaf.theta)
            features[obj] = np.array([leaf.x + x, leaf.y + y, leaf.theta, *features[obj][3:]])
        features[self._robot][4] = float(self._grip)
        return State(features)

    def contacts(self) -> Mapping[Object, float]:
        return dict(self._touched)

    def act(self, action: np.ndarray, duration: float) -> None:
        """`action` = (vx, vy, grip): m/s, and whether the gripper is closed (above 0)."""
        vx, vy, grip = map(float, action)
        speed = math.hypot(vx, vy)
        if speed > MOST_SPEED:
            vx, vy, speed = vx * MOST_SPEED / speed, vy * MOST_SPEED / speed, MOST_SPEED
        self._grasp(grip > 0)
        self._touched = {}
        body = (self._robot,) if self._held is None else (self._robot, self._held)
        strides = max(1, math.ceil(speed * duration / STRIDE))
        for _ in range(strides if speed > 0 else 0):
            for obj in body:
                self._discs[obj].x += vx * duration / strides
                self._discs[obj].y += vy * duration / strides
            self._push_out(body, (vx / speed, vy / speed), MOST_FORCE * speed / MOST_SPEED, self._touched)
        self.time += duration

    def _grasp(self, closed: bool) -> None:
        self._grip = closed
        if not closed:
            self._held = None
        elif self._held is None:
            robot = self._discs[self._robot]
            for obj, disc in self._discs.items():
                gap = math.hypot(disc.x - robot.x, disc.y - robot.y) - disc.radius - robot.radius
                if obj.type is PUCK and gap < REACH:
                    self._held = obj
                    return

    def _push_out(self, body: tuple[Object, ...], way: tuple[float, float], force: float, touched: Any) -> None:
        """Push what `body` overlaps on, with up to `force` N along `way`, and the body back by what is left.

        Args:
            touched: a dictionary takes up what was run into; a set holds what stands behind the body.
        """
        first = isinstance(touched, dict)
        for _ in range(2):
            overlapped = False
            for member in body:
                disc = self._discs[member]
                for x, y in self._walls(disc):
                    overlapped |= self._back(body, disc, x, y, 0.0)
                for door, leaf in self._doors.items():
                    x, y, lever = leaf.nearest(disc.x, disc.y)
                    nx, ny, overlap = _overlap(disc, x, y, leaf.half)
                    pressed = force * (way[0] * nx + way[1] * ny)
                    if overlap > 0 and pressed > 0:
                        if first:
                            touched[door] = max(pressed, touched.get(door, 0.0))
                        self._turn(leaf, nx, ny, lever, overlap, pressed)
                        x, y, _ = leaf.nearest(disc.x, disc.y)
                    overlapped |= self._back(body, disc, x, y, leaf.half)
                for obj, other in self._discs.items():
                    if obj in body or (obj is self._robot and not first) or (obj is self._held and self._grip):
                        continue
                    nx, ny, overlap = _overlap(disc, other.x, other.y, other.radius)
                    pressed = force * (way[0] * nx + way[1] * ny)
                    if overlap > 0 and pressed > 0 and first:
                        touched[obj] = max(pressed, touched.get(obj, 0.0))
                        if pressed > self._friction[obj.type]:
                            other.x, other.y = other.x + overlap * nx, other.y + overlap * ny
                            self._push_out((obj,), (nx, ny), pressed - self._friction[obj.type], set())
                    overlapped |= self._back(body, disc, other.x, other.y, other.radius)
            if not overlapped:
                return

    def _walls(self, disc: Disc) -> list[tuple[float, float]]:
        """The nearest point of each wall."""
        points = [(0.0, disc.y), (WIDTH, disc.y), (disc.x, 0.0), (disc.x, HEIGHT)]
        for leaf in self._doors.values():
            points += [(leaf.x, min(disc.y, leaf.y)), (leaf.x, max(disc.y, leaf.y + leaf.length))]
        return points

    def _back(self, body: tuple[Object, ...], disc: Disc, x: float, y: float, radius: float) -> bool:
        nx, ny, overlap = _overlap(disc, x, y, radius)
        if overlap > 0:
            for obj in body:
                self._discs[obj].x -= overlap * nx
                self._discs[obj].y -= overlap * ny
        return overlap > 0

    def _turn(self, leaf: Leaf, nx: float, ny: float, lever: float, overlap: float, pressed: float) -> None:
        """Turn a door out of the way, if the torque is more than its friction and nothing stands behind it."""
        across = nx * math.sin(leaf.theta) - ny * math.cos(leaf.theta)
        if lever < 1e-6 or pressed * abs(across) * lever <= self._door_friction * leaf.length:
            return
        before = leaf.theta
        leaf.theta = min(max(before - overlap / (lever * across), WIDE_OPEN), CLOSED)
        for obj, disc in self._discs.items():
            if obj is not self._robot and obj is not self._held and self._jams(leaf, disc, math.copysign(1.0, across)):
                leaf.theta = before
                return

    def _jams(self, leaf: Leaf, disc: Disc, side: float) -> bool:
        """Whether the leaf has turned into a disc on the side to which it turns."""
        x, y, _ = leaf.nearest(disc.x, disc.y)
        ahead = (disc.x - x) * math.sin(leaf.theta) - (disc.y - y) * math.cos(leaf.theta)
        return side * ahead > 0 and _overlap(disc, x, y, leaf.half)[2] > 0

    def picture(self) -> np.ndarray:
        """(256, 480, 3) the rooms from above, y up."""
        scale = 160.0
        y, x = (a / scale for a in np.mgrid[int(HEIGHT * scale) : 0 : -1, 0 : int(WIDTH * scale)])
        image = np.full((*x.shape, 3), 245, dtype=np.uint8)
        for pad in self._pads.values():
            image[np.hypot(x - pad.x, y - pad.y) < pad.radius] = (190, 225, 190)
        for leaf in self._doors.values():
            image[(np.abs(x - leaf.x) < 0.012) & ((y < leaf.y) | (y > leaf.y + leaf.length))] = (60, 60, 60)
            cos, sin = math.cos(leaf.theta), math.sin(leaf.theta)
            along = np.clip((x - leaf.x) * cos + (y - leaf.y) * sin, 0, leaf.length)
            image[np.hypot(x - leaf.x - along * cos, y - leaf.y - along * sin) < 0.016] = (170, 110, 50)
        colours = {ROBOT: (70, 110, 190), PUCK: (200, 60, 60), STONE: (130, 130, 130)}
        for obj, disc in self._discs.items():
            image[np.hypot(x - disc.x, y - disc.y) < disc.radius] = colours[obj.type]
        if self._grip:
            robot = self._discs[self._robot]
            image[np.hypot(x - robot.x, y - robot.y) < robot.radius / 3] = (255, 255, 255)
        return image


def _overlap(disc: Disc, x: float, y: float, radius: float) -> tuple[float, float, float]:
    """The direction from a disc to a round thing, and by how much they overlap, m."""
    dx, dy = x - disc.x, y - disc.y
    apart = math.hypot(dx, dy)
    if apart < 1e-9:
        return 1.0, 0.0, disc.radius + radius
    return dx / apart, dy / apart, disc.radius + radius - apart


# -- what it can do ---------------------------------------------------------------------------------------------------


class Drive:
    """Drives gently until `done`; gives up where it is held up."""

    def __init__(self, robot: Object, aim: Callable[[State], np.ndarray], grip: float, done: Callable[[State], bool]):
        self._robot, self._aim, self._grip, self._done = robot, aim, grip, done
        self._last, self._held_up = np.full(2, np.inf), 0

    def step(self, seen: Observation) -> np.ndarray | SkillOutcome:
        state, here = seen.state, seen.state[self._robot][:2]
        if self._done(state):
            return SkillOutcome(SkillEnd.DONE)
        self._held_up = self._held_up + 1 if math.dist(here, self._last) < 0.002 else 0
        if self._held_up > 5:
            return SkillOutcome(SkillEnd.BLOCKED, "something is in the way")
        self._last = here
        way = self._aim(state) - here
        far = float(np.hypot(*way))
        return np.array([*(way / max(far, 1e-9) * min(GENTLE, far * RATE_HZ)), self._grip])


def via(state: State, robot: Object, goal: np.ndarray) -> np.ndarray:
    """(2,) where to drive next on the way to `goal`: straight on, but through the doorway to the other room."""
    (x, y), radius = state[robot][:2], state[robot][3] / 2
    for door in state.of_type(DOOR):
        hinge = state[door][:2] - state[door][3] / 2 * np.array([np.cos(state[door][2]), np.sin(state[door][2])])
        middle, side = hinge[1] + state[door][3] / 2, np.sign(goal[0] - hinge[0])
        passed = side * (x - hinge[0])
        if passed > radius + 0.03:
            continue
        aligned = abs(y - middle) < 0.02 or passed > -radius
        return np.array([hinge[0] + side * (radius + 0.05) * (1 if aligned else -1), middle])
    return goal


class Fetch:
    """Drives to a puck with an open gripper, and grips it."""

    def __init__(self, objects: tuple[Object, ...], first: Observation) -> None:
        self._robot, self._puck = objects
        self._drive = Drive(self._robot, lambda s: via(s, self._robot, s[self._puck][:2]), -1.0, lambda s: False)

    def step(self, seen: Observation) -> np.ndarray | SkillOutcome:
        if holding(seen.state, (self._robot, self._puck)):
            return SkillOutcome(SkillEnd.DONE)
        if _gap(seen.state, self._robot, self._puck) < 0.8 * REACH:
            return np.array([0.0, 0.0, 1.0])
        return self._drive.step(seen)


class Bring:
    """Drives until the puck in its gripper lies on a pad, opens, and backs off a little."""

    def __init__(self, objects: tuple[Object, ...], first: Observation) -> None:
        robot, puck, pad = objects
        self._robot, self._puck = robot, puck
        self._offset = first.state[puck][:2] - first.state[robot][:2]
        self._held = holding(first.state, (robot, puck)) > 0
        self._drive = Drive(
            robot,
            lambda s: via(s, robot, s[pad][:2] - self._offset),
            1.0,
            lambda s: math.dist(s[puck][:2], s[pad][:2]) < 0.01,
        )
        self._leaving = 0

    def step(self, seen: Observation) -> np.ndarray | SkillOutcome:
        if not self._held:
            return SkillOutcome(SkillEnd.REFUSED, f"{self._puck} is not held")
        if not self._leaving:
            answer = self._drive.step(seen)
            if not (isinstance(answer, SkillOutcome) and answer.done):
                return answer
        self._leaving += 1
        if self._leaving > 4:
            return SkillOutcome(SkillEnd.DONE)
        return np.array([*(-self._offset / np.hypot(*self._offset) * GENTLE), -1.0])


def skills() -> tuple[Skill, ...]:
    return (
        Skill("Fetch", (ROBOT, PUCK), Fetch, RATE_HZ, time_limit_s=40, live_state=True),
        Skill("Bring", (ROBOT, PUCK, PAD), Bring, RATE_HZ, time_limit_s=40, live_state=True),
    )


# -- tasks ------------------------------------------------------------------------------------------------------------

USUAL, UNSEEN = {"robot": (0.24, 0.28), "door": (0.50, 0.60)}, {"robot": (0.21, 0.23), "door": (0.62, 0.66)}
"""Sizes, m: what training sees, and what it never sees."""


def draw(
    rng: np.random.Generator,
    seed: int,
    *,
    pucks: int = 1,
    goal: tuple[int, ...] = (0,),
    opened: tuple[float, float] = (1.4, 1.7),
    stone: str = "",
    doors: int = 1,
    stones: int = 0,
    sizes: Mapping[str, tuple[float, float]] = USUAL,
) -> Task:
    """A task: the robot in the left room, pucks and pads in the right one.

    Args:
        goal: the pucks that shall come to their pads.
        opened: by how much the door is open, rad.
        stone: where a stone lies: "in" the doorway, or "before" it.
        stones: how many more lie in corners, where they are in nobody's way.
    """
    robot, length = rng.uniform(*sizes["robot"]), rng.uniform(*sizes["door"])
    hinge, theta = np.array([rng.uniform(1.0, 1.2), rng.uniform(0.4, 0.55)]), CLOSED - rng.uniform(*opened)
    middle = hinge + length / 2 * np.array([math.cos(theta), math.sin(theta)])
    features: dict[Object, list[float]] = {
        ROBOT("r"): [rng.uniform(0.25, 0.6), rng.uniform(0.45, 1.15), 0.0, robot, 0.0]
    }
    if doors:
        features[DOOR("door")] = [*middle, theta, length, 0.02]
    spread = 0.15 if pucks < 3 else 0.05
    heights = rng.permutation(np.linspace(0.4, 1.2, max(pucks, 2)))
    for i in range(pucks):
        x = hinge[0] + length + rng.uniform(0.15, 0.3)
        features[PUCK(f"p{i}")] = [x, heights[i] + rng.uniform(-spread, spread), 0.0, rng.uniform(0.10, 0.13)]
    heights = rng.permutation(np.linspace(0.4, 1.2, max(pucks, 2)))
    for i in range(pucks):
        features[PAD(f"pad{i}")] = [rng.uniform(2.5, 2.6), heights[i] + rng.uniform(-spread, spread), 0.0, 0.16]
    if stone:
        # Large enough that nobody slips past, whatever the doorway.
        size = max(2 * (length / 2 - robot + rng.uniform(0.05, 0.08)), 0.2)
        x = hinge[0] + (rng.uniform(-0.03, 0.01) if stone == "in" else -size / 2 - 0.02)
        features[STONE("stone")] = [x, hinge[1] + length / 2 + rng.uniform(-0.02, 0.02), 0.0, size]
    for i, (x, y) in enumerate(((0.15, 0.15), (0.15, 1.45), (0.45, 0.12), (0.45, 1.48))[:stones]):
        features[STONE(f"stone{i}" if i or stone else "stone")] = [x, y, 0.0, 0.2]
    physics = {"door": rng.uniform(4.2, 4.6), "stone": rng.uniform(6.0, 7.0), "puck": 1.0}
    wanted = frozenset(AT(PUCK(f"p{i}"), PAD(f"pad{i}")) for i in goal)
    state = State({o: np.array(v) for o, v in features.items()})
    return Task(state.objects, state, wanted, physics, seed)


def free(rng: np.random.Generator, seed: int, counts: Mapping[Type, int]) -> Task:
    """Nothing in the way: the door wide open, stones in corners."""
    pucks = max(counts.get(PUCK, 1), counts.get(PAD, 1))
    return draw(rng, seed, pucks=pucks, doors=counts.get(DOOR, 1), stones=counts.get(STONE, 0))


def _scenario(name: str, description: str, after_stage: int, training: bool = False, **how: Any) -> Scenario:
    goal = frozenset(AT(PUCK(f"p{i}"), PAD(f"pad{i}")) for i in how.get("goal", (0,)))
    return Scenario(
        name,
        description,
        lambda _domain: goal,
        lambda rng, seed: draw(rng, seed, **how),
        sample_unseen=lambda rng, seed: draw(rng, seed, sizes=UNSEEN, **how),
        training=training,
        after_stage=after_stage,
    )


SHUT, BOTH = (0.0, 0.1), {"pucks": 2, "goal": (0, 1)}
SCENARIOS = (
    _scenario("door", "training: the puck is behind a closed door", 1, training=True, opened=SHUT),
    _scenario("open", "test: the door is open", 0),
    _scenario("ajar", "test: the door is ajar, and not open enough", 1, opened=(0.1, 0.6)),
    _scenario("two-pucks", "test: two pucks behind a closed door", 1, opened=SHUT, **BOTH),
    _scenario("stone", "training: a stone lies in the open doorway", 2, training=True, stone="in"),
    _scenario("stone-and-two-pucks", "test: the same, and two pucks behind it", 2, stone="in", **BOTH),
    _scenario("stone-and-door", "test: a stone lies before the closed door", 2, stone="before", opened=SHUT),
    _scenario("stone-aside", "test: the door is closed, and a stone is in nobody's way", 1, stones=1, opened=SHUT),
)

DOMAIN = Domain(
    name="puck-behind-a-door",
    types=(ROBOT, PUCK, PAD, DOOR, STONE),
    predicates=(HAND_EMPTY, HOLDING, AT),
    classifiers={"HandEmpty": hand_empty, "Holding": holding, "At": at},
    operators=(FETCH, BRING),
    scenarios={s.name: s for s in SCENARIOS},
    embodiment=Embodiment(
        actions={"vx": (-MOST_SPEED, MOST_SPEED), "vy": (-MOST_SPEED, MOST_SPEED), "grip": (-1.0, 1.0)},
        rate_hz=RATE_HZ,
        simulate=Rooms,
        skills=skills,
    ),
    stages=(
        Stage(recovery="OpenDoor", scenario="door", horizon=30),
        Stage(recovery="Shove", scenario="stone", horizon=30),
    ),
    free=free,
)
