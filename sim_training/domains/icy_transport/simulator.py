"""The car's physics: it slides, is pushed by ice and mud, loads what it touches and unloads over the target."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.core.world import Observation
from resync_robot.sim_training.domains.icy_transport.floor_plan import SIZE, Box, gap, hits_wall, overlap
from resync_robot.sim_training.domains.icy_transport.vocabulary import (
    CAR,
    DELIVERED_WITHIN,
    ICE,
    ITEM,
    REGIONS,
    UNLOADED_WITHIN,
)

STEP = 0.02
"""s of one step of the physics, which is one action."""
MOST_FORCE, MOST_STEER = 2.0, 1.0
"""N along either axis of the car, and N of the couple that steers it."""
ARM_OF_COUPLE = 0.5 / 3
"""m."""
MASS, CARGO_MASS = 0.5, 0.2
"""kg; the car's own is what its controller believes, a task draws the true one."""
INERTIA_OF_CARGO = 1e-3
"""kg m^2."""
KEPT_A_STEP = 0.1**STEP
"""Of every speed: a tenth is left after a second."""


def inertia(mass: float, length: float, width: float) -> float:
    """Of a box about its middle, kg m^2."""
    return mass * (length**2 + width**2) / 12


@dataclass(frozen=True, slots=True)
class Motion:
    """The car: its pose, m and rad, and its speeds in the world, m/s and rad/s."""

    x: float
    y: float
    theta: float
    vx: float = 0.0
    vy: float = 0.0
    omega: float = 0.0


class Floor:
    """A car among items and regions, of which nothing else moves.

    A task's `physics` has the car's mass, kg, the push of a region and what it holds a loaded car back with, N.
    """

    def __init__(self, task: Task) -> None:
        self._car = next(o for o in task.objects if o.type is CAR)
        self._mass = float(task.physics["mass"])
        self._push, self._hold_back = float(task.physics["push"]), float(task.physics["hold_back"])
        self.reset(task.initial)

    def reset(self, state: State) -> bool:
        """Put everything where `state` has it. False where something is in a wall, or where something would be loaded
        or unloaded by itself."""
        self.time, self._given = 0.0, state
        x, y, theta, length, width, forward, sideways, turning = state[self._car].tolist()
        cos, sin = math.cos(theta), math.sin(theta)
        self._half = length / 2, width / 2
        self._inertia = inertia(self._mass, length, width)
        self._motion = Motion(x, y, theta, forward * cos - sideways * sin, forward * sin + sideways * cos, turning)
        items = {o: state[o].tolist() for o in state.of_type(ITEM)}
        self._places = {o: (row[0], row[1]) for o, row in items.items()}
        self._targets = tuple(self._places[o] for o, row in items.items() if row[4] > 0.5)
        self._radii = {o: row[3] / 2 for o, row in items.items() if row[4] <= 0.5}
        carried = [o for o, row in items.items() if row[5] > 0.5]
        self._load = carried[0] if carried else None
        regions = {o: state[o].tolist() for kind in REGIONS for o in state.of_type(kind)}
        self._boxes: dict[Object, Box] = {o: (*row[:3], row[3] / 2, row[4] / 2) for o, row in regions.items()}
        self._active = frozenset(o for o, row in regions.items() if row[5] > 0.5)
        self._touched = self._touching()
        return self._stands(carried)

    def _stands(self, carried: list[Object]) -> bool:
        middles = [*self._places.values(), *((box[0], box[1]) for box in self._boxes.values())]
        if hits_wall(self._box()) or not all(0 <= x <= SIZE and 0 <= y <= SIZE for x, y in middles):
            return False
        if any(hits_wall((*self._places[o], 0.0, r, r)) for o, r in self._radii.items() if o != self._load):
            return False
        if self._load is None:
            return not any(self._would_load(o) for o in self._radii)
        car = self._motion.x, self._motion.y
        fits = len(carried) == 1 and self._load in self._radii and math.dist(self._places[self._load], car) < 1e-6
        return fits and not self._would_unload()

    def save(self) -> Any:
        return self.time, self._motion, self._load, dict(self._places), self._active, self._touched

    def restore(self, snapshot: Any) -> None:
        self.time, self._motion, self._load, places, self._active, self._touched = snapshot
        self._places = dict(places)

    def observe(self, live: bool = False) -> Observation:
        return Observation(time=self.time, state=self.perceive())

    def perceive(self) -> State:
        m = self._motion
        cos, sin = math.cos(m.theta), math.sin(m.theta)
        features = {o: self._given[o] for o in self._given}
        speeds = (m.vx * cos + m.vy * sin, m.vy * cos - m.vx * sin, m.omega)
        features[self._car] = np.array([m.x, m.y, m.theta, *self._given[self._car][3:5].tolist(), *speeds])
        for obj in self._radii:
            row = features[obj].copy()
            row[:2], row[5] = self._places[obj], obj == self._load
            features[obj] = row
        for obj in self._boxes:
            if obj not in self._active:
                features[obj] = np.array([*features[obj][:5].tolist(), 0.0])
        return State(features)

    def contacts(self) -> Mapping[Object, float]:
        """The active regions that the car is in: 1 each."""
        return dict.fromkeys(self._touched, 1.0)

    def picture(self) -> np.ndarray:
        """(500, 500, 3) from above."""
        # Learning takes no pictures, and needs no OpenCV.
        from resync_robot.sim_training.domains.icy_transport.picture import draw

        return draw(self.perceive())

    def act(self, action: np.ndarray, duration: float) -> None:
        """`action` = (forward, sideways, steer): N ahead, to the car's left, and of a couple that turns it left."""
        forward, sideways, steer = (float(a) for a in action)
        for _ in range(max(1, round(duration / STEP))):
            self._step(
                min(max(forward, -MOST_FORCE), MOST_FORCE),
                min(max(sideways, -MOST_FORCE), MOST_FORCE),
                min(max(steer, -MOST_STEER), MOST_STEER),
            )
        self.time += duration

    # ------------------------------------------------------------------------------------------------------------------

    def _step(self, forward: float, sideways: float, steer: float) -> None:
        for region in self._touched:
            # Ice takes the car to its right, mud to its left.
            sideways += -self._push if region.type is ICE else self._push
        if self._touched and self._load is not None:
            forward -= self._hold_back
        before = self._motion
        self._motion = self._moved(before, forward, sideways, steer)
        if hits_wall(self._box()):
            self._motion = Motion(before.x, before.y, before.theta)
        self._carry()
        left = self._touched
        self._touched = self._touching()
        if left:
            self._active -= {o for o in left if o not in self._touched and self._is_behind(o)}

    def _moved(self, m: Motion, forward: float, sideways: float, steer: float) -> Motion:
        loaded = self._load is not None
        mass = self._mass + CARGO_MASS * loaded
        cos, sin = math.cos(m.theta), math.sin(m.theta)
        vx = m.vx * KEPT_A_STEP + (forward * cos - sideways * sin) / mass * STEP
        vy = m.vy * KEPT_A_STEP + (forward * sin + sideways * cos) / mass * STEP
        spin = steer * ARM_OF_COUPLE / (self._inertia + INERTIA_OF_CARGO * loaded)
        omega = m.omega * KEPT_A_STEP + spin * STEP
        theta = math.remainder(m.theta + omega * STEP, 2 * math.pi)
        return Motion(m.x + vx * STEP, m.y + vy * STEP, theta, vx, vy, omega)

    def _carry(self) -> None:
        """What is carried comes along; what is touched is loaded, and unloaded over a target."""
        if self._load is None:
            self._load = next((o for o in self._radii if self._would_load(o)), None)
        if self._load is not None:
            self._places[self._load] = self._motion.x, self._motion.y
            if self._would_unload():
                self._load = None

    def _would_load(self, item: Object) -> bool:
        x, y = self._places[item]
        if gap(self._box(), x, y) > self._radii[item]:
            return False
        return not any(math.dist(target, (x, y)) <= DELIVERED_WITHIN for target in self._targets)

    def _would_unload(self) -> bool:
        here = self._motion.x, self._motion.y
        return any(math.dist(target, here) <= UNLOADED_WITHIN for target in self._targets)

    def _touching(self) -> tuple[Object, ...]:
        box = self._box()
        return tuple(o for o, region in self._boxes.items() if o in self._active and overlap(box, region))

    def _is_behind(self, region: Object) -> bool:
        """Whether the car is on the side that the region guards."""
        x, y, theta, _, _ = self._boxes[region]
        return (self._motion.x - x) * math.cos(theta) + (self._motion.y - y) * math.sin(theta) < 0

    def _box(self) -> Box:
        return (self._motion.x, self._motion.y, self._motion.theta, *self._half)
