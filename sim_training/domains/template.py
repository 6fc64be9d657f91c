"""my-domain: a robot drives to a flag, and a crate stands on it.

A small complete domain to start from. Change one part after the other, and run now and then:

    resync-robot check-domain THIS_FILE
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from resync_robot.core.embodiment import Embodiment, Stage
from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import ROUND, SE2, Object, Operator, Predicate, Type, Variable
from resync_robot.core.task import Domain, Scenario, Task
from resync_robot.core.world import Observation

# What there is: types with a pose first, then sizes. SI units.
ROUND_BODY = ("diameter", "diameter")
ROBOT = Type("robot", ("x", "y", "theta", "diameter"), pose=SE2, extents=ROUND_BODY, symmetry=ROUND, exact=True)
CRATE = Type("crate", ("x", "y", "theta", "diameter"), pose=SE2, extents=ROUND_BODY, symmetry=ROUND)
FLAG = Type("flag", ("x", "y", "theta"), pose=SE2, symmetry=ROUND)

# What can be told of a state.
REACHED = Predicate("Reached", (ROBOT, FLAG))


def reached(state: State, objects: tuple[Object, ...]) -> float:
    robot, flag = objects
    return float(math.dist(state[robot][:2], state[flag][:2]) < 0.03)


# What the given skill needs and changes; it does not know of crates.
_r, _f = Variable("?r", ROBOT), Variable("?f", FLAG)
GO_TO = Operator("GoTo", (_r, _f), add=frozenset({REACHED(_r, _f)}))

SIZE = 2.0
"""Of the floor, m."""
GENTLE, FULL = 0.2, 1.0
"""m/s of the given skill, and at most."""
MOVES_A_CRATE = 0.6
"""m/s from which on the robot pushes hard enough to move a crate."""
RATE_HZ = 10.0


class Floor:
    """The simulator: the robot stops at what it cannot push."""

    def __init__(self, task: Task) -> None:
        self._robot = next(o for o in task.objects if o.type is ROBOT)
        self.reset(task.initial)

    def reset(self, state: State) -> bool:
        """Everything where the state has it; False where things overlap or lie outside."""
        self.time, self._state = 0.0, state
        self._touched: dict[Object, float] = {}
        self._at = {o: np.array(state[o][:2]) for o in state}
        solid = [o for o in state if o.type is not FLAG]
        apart = all(self._gap(a, b) > -1e-6 for i, a in enumerate(solid) for b in solid[i + 1 :])
        return apart and all(((place >= 0) & (place <= SIZE)).all() for place in self._at.values())

    def save(self) -> Any:
        return self.time, {o: place.copy() for o, place in self._at.items()}, dict(self._touched)

    def restore(self, snapshot: Any) -> None:
        self.time, places, touched = snapshot
        self._at, self._touched = {o: place.copy() for o, place in places.items()}, dict(touched)

    def observe(self, live: bool = False) -> Observation:
        return Observation(time=self.time, state=self.perceive())

    def perceive(self) -> State:
        return State({o: np.array([*self._at[o], *self._state[o][2:]]) for o in self._state})

    def act(self, action: np.ndarray, duration: float) -> None:
        """`action` = (vx, vy), m/s."""
        self.time, self._touched = self.time + duration, {}
        speed = math.hypot(*action)
        way = np.asarray(action, dtype=float) * min(1.0, FULL / max(speed, 1e-9)) * duration
        for _ in range(4):
            before = self._at[self._robot]
            self._at[self._robot] = np.clip(before + way / 4, 0.0, SIZE)
            for crate in [o for o in self._at if o.type is CRATE and self._gap(self._robot, o) < 0]:
                self._touched[crate] = speed
                if speed < MOVES_A_CRATE or not self._pushed(crate):
                    self._at[self._robot] = before

    def _pushed(self, crate: Object) -> bool:
        """Push a crate out of the robot, unless something is behind it."""
        robot, before = self._at[self._robot], self._at[crate]
        apart = before - robot
        pushed = before - apart / np.hypot(*apart) * self._gap(self._robot, crate)
        self._at[crate] = np.clip(pushed, 0.0, SIZE)
        others = (o for o in self._at if o.type is CRATE and o is not crate)
        if (self._at[crate] == pushed).all() and all(self._gap(crate, o) >= 0 for o in others):
            return True
        self._at[crate] = before
        return False

    def _gap(self, a: Object, b: Object) -> float:
        return math.dist(self._at[a], self._at[b]) - float(self._state[a][3] + self._state[b][3]) / 2

    def contacts(self) -> Mapping[Object, float]:
        """What the robot runs into, by how fast."""
        return dict(self._touched)

    def picture(self) -> np.ndarray:
        """(200, 200, 3) from above, y up."""
        y, x = (a / 100 for a in np.mgrid[200:0:-1, 0:200])
        image = np.full((200, 200, 3), 245, dtype=np.uint8)
        for obj, colour in ((o, {ROBOT: (70, 110, 190), CRATE: (170, 110, 50)}.get(o.type)) for o in self._at):
            radius = 0.03 if colour is None else self._state[obj][3] / 2
            image[np.hypot(x - self._at[obj][0], y - self._at[obj][1]) < radius] = colour or (60, 160, 60)
        return image


class GoTo:
    """The given skill: drives straight and gently, and gives up where it is held up."""

    def __init__(self, objects: tuple[Object, ...], first: Observation) -> None:
        self._objects, self._last, self._held_up = objects, np.full(2, np.inf), 0

    def step(self, seen: Observation) -> np.ndarray | SkillOutcome:
        robot, flag = self._objects
        here, way = seen.state[robot][:2], seen.state[flag][:2] - seen.state[robot][:2]
        far = float(np.hypot(*way))
        if far < 0.01:
            return SkillOutcome(SkillEnd.DONE)
        self._held_up = self._held_up + 1 if math.dist(here, self._last) < 0.001 else 0
        if self._held_up > 3:
            return SkillOutcome(SkillEnd.BLOCKED, "something is in the way")
        self._last = here
        return way / far * min(GENTLE, far * RATE_HZ)


def draw(rng: np.random.Generator, seed: int, covered: bool, crates_aside: int = 0) -> Task:
    """The robot on the left, the flag on the right, a crate on it if it is covered, others in nobody's way."""
    robot, flag = np.array([0.3, rng.uniform(0.8, 1.2)]), np.array([1.4, rng.uniform(0.8, 1.2)])
    features = {ROBOT("r"): [*robot, 0.0, rng.uniform(0.2, 0.24)], FLAG("flag"): [*flag, 0.0]}
    places = [flag + rng.uniform(-0.04, 0.04, 2)] if covered else []
    places += [np.array([rng.uniform(0.5, 1.5), y]) for y in (0.2, 1.8)[:crates_aside]]
    features |= {CRATE(f"c{i}"): [*place, 0.0, rng.uniform(0.2, 0.26)] for i, place in enumerate(places)}
    state = State({o: np.array(values) for o, values in features.items()})
    return Task(state.objects, state, frozenset({REACHED(ROBOT("r"), FLAG("flag"))}), {}, seed)


def free(rng: np.random.Generator, seed: int, counts: Mapping[Type, int]) -> Task:
    """Nothing is in the way."""
    return draw(rng, seed, False, min(counts.get(CRATE, 0), 2))


GOAL = frozenset({REACHED(ROBOT("r"), FLAG("flag"))})
SCENARIOS = (
    Scenario(
        "crate",
        "training: a crate stands on the flag",
        lambda _domain: GOAL,
        lambda rng, seed: draw(rng, seed, True),
        training=True,
    ),
    Scenario(
        "clear",
        "test: a crate is aside",
        lambda _domain: GOAL,
        lambda rng, seed: draw(rng, seed, False, 1),
        after_stage=0,
    ),
    Scenario(
        "two-crates",
        "test: a crate stands on the flag, another one aside",
        lambda _domain: GOAL,
        lambda rng, seed: draw(rng, seed, True, 1),
    ),
)

DOMAIN = Domain(
    name="my-domain",
    types=(ROBOT, CRATE, FLAG),
    predicates=(REACHED,),
    classifiers={"Reached": reached},
    operators=(GO_TO,),
    scenarios={s.name: s for s in SCENARIOS},
    stages=(Stage(recovery="Clear", scenario="crate", horizon=30),),
    embodiment=Embodiment(
        actions={"vx": (-FULL, FULL), "vy": (-FULL, FULL)},
        rate_hz=RATE_HZ,
        simulate=Floor,
        skills=lambda: (Skill("GoTo", (ROBOT, FLAG), GoTo, RATE_HZ, time_limit_s=30, live_state=True),),
    ),
    free=free,
)
