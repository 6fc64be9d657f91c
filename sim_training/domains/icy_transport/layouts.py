"""Tasks of Icy Transport: who stands where, and before which doorways ice and mud lie."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from resync_robot.core.errors import ConfigError
from resync_robot.core.state import State
from resync_robot.core.symbols import Object, Type
from resync_robot.core.task import Task
from resync_robot.sim_training.domains.icy_transport.floor_plan import SIZE, Point, Room, centre, room_of, way
from resync_robot.sim_training.domains.icy_transport.vocabulary import CAR, DELIVERED, ICE, ITEM, MUD

ROBOT, O1, O2, TARGET = CAR("robot"), ITEM("o1"), ITEM("o2"), ITEM("target")
GOAL = frozenset({DELIVERED(O1, TARGET), DELIVERED(O2, TARGET)})

CAR_SIZE, ITEM_SIZE = (0.5, 0.3), 0.2
DEPTH, WIDTH = 0.1, 0.8
"""Of a region, m: as wide as a doorway."""
BEFORE = 2.1
"""From an item to the region that lies before its door, m."""
USUAL: Mapping[str, tuple[float, float]] = {"mass": (0.47, 0.53), "push": (0.7, 0.9), "hold_back": (1.35, 1.65)}
UNSEEN: Mapping[str, tuple[float, float]] = {"mass": (0.54, 0.56), "push": (0.95, 1.05), "hold_back": (1.7, 1.75)}
"""Physics: kg, and N; what training sees, and what it never sees."""

_TOP_LEFT, _BOTTOM_RIGHT, _TOP_RIGHT = (0, 1), (1, 0), (1, 1)
_OTHERS: Mapping[Room, tuple[Room, Room]] = {
    _BOTTOM_RIGHT: (_TOP_LEFT, _TOP_RIGHT),
    _TOP_RIGHT: (_BOTTOM_RIGHT, _TOP_LEFT),
    _TOP_LEFT: (_BOTTOM_RIGHT, _TOP_RIGHT),
}
"""Room of the target -> those of the first and the second cargo."""
_CORNERS: tuple[Point, ...] = ((0.4, 4.45), (2.1, 4.45), (2.9, 4.45), (4.6, 4.45), (4.6, 0.4), (4.6, 2.1))
"""Where more cargo lies that nobody asked for."""
_FREE_WAY = 0.42
"""m from the line that the middle of a car drives on: what is farther away is in nobody's way."""


def draw(
    rng: np.random.Generator,
    seed: int,
    *,
    ice: str = "",
    mud: str = "",
    physics: Mapping[str, tuple[float, float]] = USUAL,
) -> Task:
    """A task: the car in the lower left room, cargo and target in the others.

    Args:
        ice, mud: "o1", "o2" or "target": what lies behind the doorway before which the region is; "" for none.
    """
    features = _furnished(rng)
    for kind, name, guarded in ((ICE, "ice", ice), (MUD, "mud", mud)):
        if guarded:
            features[kind(name)] = _before(features[ITEM(guarded)])
    return _task(features, rng, seed, physics)


def free(rng: np.random.Generator, seed: int, counts: Mapping[Type, int]) -> Task:
    """Nothing in the way: ice and mud lie where nobody drives.

    Raises:
        ConfigError: more is asked for than has room.
    """
    features = _furnished(rng)
    more = counts.get(ITEM, 0) - 3
    if more > len(_CORNERS) or counts.get(CAR, 1) > 1:
        raise ConfigError(
            f"{counts.get(CAR, 1)} cars and {counts.get(ITEM, 0)} items have no room on the floor",
            f"ask for 1 car and at most {3 + len(_CORNERS)} items",
        )
    for i, corner in enumerate(rng.permutation(_CORNERS)[: max(more, 0)]):
        features[ITEM(f"o{i + 3}")] = [*corner, 0.0, ITEM_SIZE, 0.0, 0.0]
    lines = _lines([(row[0], row[1]) for o, row in features.items() if o.type is ITEM])
    for kind, name in ((ICE, "ice"), (MUD, "mud")):
        for i in range(counts.get(kind, 0)):
            features[kind(f"{name}{i}" if i else name)] = _aside(rng, lines)
    return _task(features, rng, seed, USUAL)


def _furnished(rng: np.random.Generator) -> dict[Object, list[float]]:
    """The car, two cargoes and the target."""
    target = list(_OTHERS)[int(rng.integers(len(_OTHERS)))]
    x, y = (centre((0, 0))[i] + rng.uniform(-0.1, 0.1) for i in range(2))
    features = {ROBOT: [x, y, rng.uniform(-math.pi, math.pi), *CAR_SIZE, 0.0, 0.0, 0.0]}
    for item, room in ((O1, _OTHERS[target][0]), (O2, _OTHERS[target][1]), (TARGET, target)):
        features[item] = [*_berth(rng, room), ITEM_SIZE, float(item is TARGET), 0.0]
    return features


def _berth(rng: np.random.Generator, room: Room) -> tuple[float, float, float]:
    """A pose at the far end of a room, looking at its doorway."""
    far, along = rng.uniform(4.3, 4.5), rng.uniform(-0.1, 0.1)
    if room == _BOTTOM_RIGHT:
        return far, centre(room)[1] + along, math.pi
    return centre(room)[0] + along, far, -math.pi / 2


def _before(item: Sequence[float]) -> list[float]:
    """A region before the doorway behind which an item lies."""
    x, y, theta = item[:3]
    return [x + BEFORE * math.cos(theta), y + BEFORE * math.sin(theta), theta, DEPTH, WIDTH, 1.0]


def _aside(rng: np.random.Generator, lines: np.ndarray) -> list[float]:
    """A region that lies nowhere near where anybody drives."""
    while True:
        x, y = rng.uniform(0.1, SIZE - 0.1, 2)
        theta = float(rng.integers(-1, 3)) * math.pi / 2
        reach = np.linspace(-WIDTH / 2, WIDTH / 2, 9)
        bar = np.stack([x - reach * math.sin(theta), y + reach * math.cos(theta)], -1)
        inside = (bar > DEPTH / 2).all() and (bar < SIZE - DEPTH / 2).all()
        if inside and np.hypot(*(bar[:, None] - lines).T).min() > _FREE_WAY:
            return [float(x), float(y), theta, DEPTH, WIDTH, 1.0]


def _lines(items: Sequence[Point]) -> np.ndarray:
    """(n, 2) points, closely spaced, on every line that a car drives along."""
    legs: list[tuple[Point, Point]] = []
    for start, goal in ((_TOP_LEFT, _TOP_RIGHT), (_TOP_RIGHT, _TOP_LEFT)):
        points = [centre(start), *way(start, goal)]
        legs += pairwise(points)
    legs += [(centre(room_of(*item)), item) for item in items]
    share = np.linspace(0.0, 1.0, 30)[:, None]
    return np.concatenate([np.array(a) + share * (np.array(b) - np.array(a)) for a, b in legs])


def _task(
    features: Mapping[Object, Sequence[float]],
    rng: np.random.Generator,
    seed: int,
    physics: Mapping[str, tuple[float, float]],
) -> Task:
    state = State({o: np.array(row) for o, row in features.items()})
    return Task(state.objects, state, GOAL, {name: rng.uniform(*ends) for name, ends in physics.items()}, seed)
