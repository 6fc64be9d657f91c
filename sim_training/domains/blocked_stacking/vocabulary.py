"""What there is in Blocked Stacking, and what can be told of it: types, predicates, and what the given skills need.

A vertical plane: x to the right, y up, gravity down. The bench's top is at y = `BENCH`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from resync_robot.core.state import State
from resync_robot.core.symbols import SE2, Object, Operator, Predicate, Type, Variable

SIZE = ("width", "height")
ROBOT = Type(
    "robot", ("x", "y", "theta", "length", "spread", "arm"), pose=SE2, extents=("length", "spread"), exact=True
)
"""The pose is of the middle of its hand, x towards the tips; `spread` is from outside to outside of its two fingers,
`arm` how far the hand is from the middle of the base."""
BLOCK = Type("block", ("x", "y", "theta", *SIZE, "held"), pose=SE2, extents=SIZE)
"""A square, which stands on one of its sides; which one nobody can tell, so `theta` is within a quarter turn. It has no
symmetry all the same: beside it is not above it."""
SLAB = Type("slab", ("x", "y", "theta", *SIZE), pose=SE2, extents=SIZE)
"""Small, fixed in mid-air."""
CRATE = Type("crate", ("x", "y", "theta", *SIZE), pose=SE2, extents=SIZE)
"""Large; stands on the bench and can be pushed."""
WALL = Type("wall", ("x", "y", "theta", *SIZE), pose=SE2, extents=SIZE)
"""Thin, fixed, its foot in the bench."""

TYPES = (ROBOT, BLOCK, SLAB, CRATE, WALL)
OBSTRUCTIONS = (SLAB, CRATE, WALL)

BENCH = 0.1
"""Height of the bench, m."""
WORLD = (4.53, 2.0)
"""Width and height of the world, m."""
DOWN = -math.pi / 2
"""Heading of a hand that points down."""

READY_GRASP = Predicate("ReadyGrasp", (ROBOT, BLOCK))
HOLDING = Predicate("Holding", (ROBOT, BLOCK))
READY_PLACE = Predicate("ReadyPlace", (ROBOT, BLOCK, BLOCK))
ON = Predicate("On", (BLOCK, BLOCK))
PREDICATES = (READY_GRASP, HOLDING, READY_PLACE, ON)


@dataclass(frozen=True)
class Limits:
    """Where the given predicates change from true to false; lengths in m.

    Attributes:
        grasp_aside, grasp_above: a hand is ready to grasp that is so near to a block's middle, and so far above it.
        upright: rad by which its heading is off at most.
        place_aside, place_above: a held block is ready to be placed that is so far from above the other one's middle,
            with such a gap.
        on_aside, on_gap: the same of one that lies upon another.
        held: the share of a block that is held.
    """

    grasp_aside: float = 0.08
    grasp_above: float = 0.13
    upright: float = 0.15
    place_aside: float = 0.075
    place_above: float = 0.05
    on_aside: float = 0.075
    on_gap: float = 0.015
    held: float = 0.5


LIMITS = Limits()


def holding(state: State, objects: tuple[Object, ...], limits: Limits = LIMITS) -> float:
    return float(_held(state, objects[1], limits))


def ready_grasp(state: State, objects: tuple[Object, ...], limits: Limits = LIMITS) -> float:
    robot, block = objects
    (x, y, theta), (bx, by) = state[robot][:3], state[block][:2]
    near = abs(x - bx) < limits.grasp_aside and 0.0 < y - by < limits.grasp_above
    empty = not any(_held(state, b, limits) for b in state.of_type(BLOCK))
    return float(near and abs(theta - DOWN) < limits.upright and empty)


def ready_place(state: State, objects: tuple[Object, ...], limits: Limits = LIMITS) -> float:
    _, block, below = objects
    aside, gap = above(state, block, below)
    return float(_held(state, block, limits) and aside < limits.place_aside and 0.0 <= gap < limits.place_above)


def on(state: State, objects: tuple[Object, ...], limits: Limits = LIMITS) -> float:
    aside, gap = above(state, *objects)
    return float(not _held(state, objects[0], limits) and aside < limits.on_aside and abs(gap) < limits.on_gap)


def _held(state: State, block: Object, limits: Limits) -> bool:
    return bool(state.get(block, "held")[0] > limits.held)


def above(state: State, block: Object, below: Object) -> tuple[float, float]:
    """How far a block is aside of the middle of another one, and the gap between its underside and the other's top."""
    (x, y), (bx, by) = state[block][:2], state[below][:2]
    half = (state.get(block, "height")[0] + state.get(below, "height")[0]) / 2
    return abs(float(x - bx)), float(y - by - half)


CLASSIFIERS = {"ReadyGrasp": ready_grasp, "Holding": holding, "ReadyPlace": ready_place, "On": on}

_r, _b, _below = Variable("?r", ROBOT), Variable("?b", BLOCK), Variable("?below", BLOCK)
OPERATORS = (
    Operator("ReachToGrasp", (_r, _b), add=frozenset({READY_GRASP(_r, _b)})),
    Operator(
        "Grasp",
        (_r, _b),
        frozenset({READY_GRASP(_r, _b)}),
        frozenset({HOLDING(_r, _b)}),
        frozenset({READY_GRASP(_r, _b)}),
    ),
    Operator(
        "ReachToPlace",
        (_r, _b, _below),
        frozenset({HOLDING(_r, _b)}),
        frozenset({READY_PLACE(_r, _b, _below)}),
    ),
    Operator(
        "Place",
        (_r, _b, _below),
        frozenset({READY_PLACE(_r, _b, _below), HOLDING(_r, _b)}),
        frozenset({ON(_b, _below)}),
        frozenset({READY_PLACE(_r, _b, _below), HOLDING(_r, _b)}),
    ),
)
