"""What there is in Icy Transport, what can be told of a state, and what the given skills need and change."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from resync_robot.core.state import State
from resync_robot.core.symbols import SE2, Object, Operator, Predicate, Type, Variable

_BAR: Mapping[str, Any] = {"pose": SE2, "extents": ("depth", "width")}

CAR = Type(
    "car",
    ("x", "y", "theta", "length", "width", "forward", "sideways", "turning"),
    pose=SE2,
    extents=("length", "width"),
    exact=True,
)
"""x points forward; its speeds, m/s and rad/s, are along its own axes."""
ITEM = Type("item", ("x", "y", "theta", "diameter", "fixed", "carried"), pose=SE2, extents=("diameter", "diameter"))
"""Cargo, or the target (`fixed` is 1): one type, so that what is learned of the way to one holds for the way to all.
x points to the door of the room that it is in."""
ICE = Type("icy", ("x", "y", "theta", "depth", "width", "active"), **_BAR)
MUD = Type("muddy", ("x", "y", "theta", "depth", "width", "active"), **_BAR)
"""x points away from what the region guards; it is `active` until the car has crossed it."""
REGIONS = (ICE, MUD)

HAND_EMPTY = Predicate("HandEmpty", (CAR,))
HOLDING = Predicate("Holding", (CAR, ITEM))
DELIVERED = Predicate("Delivered", (ITEM, ITEM))

DELIVERED_WITHIN, UNLOADED_WITHIN = 0.2, 0.1
"""From the middle of the target, m: what counts as delivered, and where the car lets its cargo go."""

_r, _o, _t = Variable("?r", CAR), Variable("?o", ITEM), Variable("?t", ITEM)
PICK = Operator(
    "GoToPickObject", (_r, _o), frozenset({HAND_EMPTY(_r)}), frozenset({HOLDING(_r, _o)}), frozenset({HAND_EMPTY(_r)})
)
PLACE = Operator(
    "GoToPlaceObject",
    (_r, _o, _t),
    frozenset({HOLDING(_r, _o)}),
    frozenset({DELIVERED(_o, _t), HAND_EMPTY(_r)}),
    frozenset({HOLDING(_r, _o)}),
)

_FIXED, _CARRIED = ITEM.features.index("fixed"), ITEM.features.index("carried")


def is_fixed(state: State, item: Object) -> bool:
    """Whether it is a target."""
    return bool(state[item][_FIXED] > 0.5)


def is_carried(state: State, item: Object) -> bool:
    return bool(state[item][_CARRIED] > 0.5)


def holding(state: State, objects: tuple[Object, ...]) -> float:
    return float(is_carried(state, objects[1]))


def hand_empty(state: State, objects: tuple[Object, ...]) -> float:
    return float(not any(is_carried(state, item) for item in state.of_type(ITEM)))


def delivered(state: State, objects: tuple[Object, ...]) -> float:
    cargo, target = objects
    if not is_fixed(state, target) or is_fixed(state, cargo) or is_carried(state, cargo):
        return 0.0
    return float(math.dist(state[cargo][:2], state[target][:2]) <= DELIVERED_WITHIN)
