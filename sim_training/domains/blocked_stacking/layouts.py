"""Where things stand at the beginning: two blocks, and what obstructs one or the other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from resync_robot.core.state import State
from resync_robot.core.symbols import Object, Type
from resync_robot.core.task import Task
from resync_robot.sim_training.domains.blocked_stacking.body import ARM, GAP, Configuration
from resync_robot.sim_training.domains.blocked_stacking.vocabulary import (
    BENCH,
    BLOCK,
    CRATE,
    ON,
    ROBOT,
    SLAB,
    WALL,
    WORLD,
)

ROBOT_NAME, TOP, BASE = ROBOT("r"), BLOCK("b1"), BLOCK("b0")
GOAL = frozenset({ON(TOP, BASE)})
"""One block upon the other."""
HOSTS: Mapping[str, Object] = {"grasp": TOP, "place": BASE}
"""Which block is obstructed: the one to be grasped, or the one to be placed upon."""

Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """What is drawn anew for each task: sizes in m, masses in kg, and friction.

    Attributes:
        friction: of blocks and crates on the bench.
        grip: of the hand on them.
    """

    block: Range = (0.216, 0.230)
    slab: tuple[Range, Range] = ((0.125, 0.140), (0.060, 0.070))
    crate: tuple[Range, Range] = ((0.34, 0.37), (0.43, 0.46))
    wall: tuple[Range, Range] = ((0.055, 0.062), (0.44, 0.455))
    friction: Range = (0.22, 0.30)
    grip: Range = (0.9, 1.1)
    mass: Range = (0.9, 1.1)

    def physics(self, rng: np.random.Generator) -> dict[str, float]:
        return {
            "friction": rng.uniform(*self.friction),
            "grip": rng.uniform(*self.grip),
            "block_mass": rng.uniform(*self.mass),
            "crate_mass": rng.uniform(*self.mass),
        }


USUAL = Sizes()
UNSEEN = Sizes(
    block=(0.206, 0.214),
    slab=((0.142, 0.150), (0.052, 0.058)),
    crate=((0.31, 0.33), (0.40, 0.42)),
    wall=((0.048, 0.053), (0.456, 0.462)),
    friction=(0.31, 0.36),
    mass=(1.12, 1.25),
)
"""Beyond what training draws."""


@dataclass(frozen=True)
class Layout:
    """What obstructs which block: type -> "grasp" or "place"."""

    obstructed: Mapping[Type, str] = field(default_factory=dict)

    def draw(self, rng: np.random.Generator, seed: int, sizes: Sizes = USUAL) -> Task:
        """A task with two blocks far enough apart that nothing obstructs both."""
        while True:
            x = rng.uniform(1.344, 3.97, 2)
            if abs(x[0] - x[1]) >= 1.792:
                break
        side = rng.uniform(*sizes.block)
        features = {
            ROBOT_NAME: _hovering(rng),
            TOP: _block(float(x[0]), side),
            BASE: _block(float(x[1]), side),
        }
        for kind, host in self.obstructed.items():
            features[kind(kind.name)] = _BESIDE[kind](rng, float(features[HOSTS[host]][0]), side, sizes)
        state = State(features)
        return Task(state.objects, state, GOAL, sizes.physics(rng), seed)


def free(rng: np.random.Generator, seed: int, counts: Mapping[Type, int]) -> Task:
    """Everything in a place of its own, where it is in nobody's way."""
    blocks = [BLOCK(f"b{i}") for i in range(max(2, counts.get(BLOCK, 0)))]
    others = [kind(kind.name if i == 0 else f"{kind.name}{i}") for kind in _ALONE for i in range(counts.get(kind, 0))]
    side = rng.uniform(*USUAL.block)
    features = {ROBOT_NAME: _hovering(rng)}
    places = np.linspace(0.5, WORLD[0] - 0.5, max(6, len(blocks) + len(others)))
    for obj, x in zip(
        (*blocks, *others), rng.permutation(places) + rng.uniform(-0.04, 0.04, len(places)), strict=False
    ):
        features[obj] = _block(float(x), side) if obj.type == BLOCK else _ALONE[obj.type](rng, float(x), USUAL)
    state = State(features)
    return Task(state.objects, state, GOAL, USUAL.physics(rng), seed)


def _hovering(rng: np.random.Generator) -> np.ndarray:
    x, y, theta = rng.uniform(0.56, 3.97), rng.uniform(1.2, 1.5), rng.uniform(-math.pi, 0.0)
    return Configuration(x, y, theta, ARM[0], GAP[1]).features()


def _block(x: float, side: float) -> np.ndarray:
    return np.array([x, BENCH + side / 2, 0.0, side, side, 0.0])


def _slab(rng: np.random.Generator, x: float, side: float, sizes: Sizes) -> np.ndarray:
    """Above the right edge of a block, so low that no finger gets between."""
    width, height = (rng.uniform(*size) for size in sizes.slab)
    above = BENCH + side + height / 2 + rng.uniform(0.026, 0.038)
    tilt = math.pi / 12
    return np.array([x + side / 2 + rng.uniform(0.05, 0.06), above, rng.uniform(-tilt, tilt), width, height])


def _crate(rng: np.random.Generator, x: float, side: float, sizes: Sizes) -> np.ndarray:
    """Close to the left side of a block."""
    width, height = (rng.uniform(*size) for size in sizes.crate)
    return np.array([x - side / 2 - rng.uniform(0.0045, 0.011) - width / 2, BENCH + height / 2, 0.0, width, height])


def _wall(rng: np.random.Generator, x: float, side: float, sizes: Sizes) -> np.ndarray:
    """Leaning over a block from its left."""
    width, height = (rng.uniform(*size) for size in sizes.wall)
    tilt = -math.pi / 6 - rng.uniform(0.0, 0.05)
    return np.array([x - side / 2 - rng.uniform(0.127, 0.138), BENCH + rng.uniform(0.12, 0.131), tilt, width, height])


_BESIDE = {SLAB: _slab, CRATE: _crate, WALL: _wall}
_ALONE = {
    SLAB: lambda rng, x, sizes: _slab(rng, x - 0.16, 0.224, sizes),
    CRATE: lambda rng, x, sizes: _crate(rng, x + 0.3, 0.224, sizes),
    WALL: lambda rng, x, sizes: _wall(rng, x + 0.245, 0.224, sizes),
}
