"""What there is in Blocked Stacking, and what can be told of it: types, predicates, and what the given skills need.

A vertical plane: x to the right, y up, gravity down. The bench's top is at y = `BENCH`.
"""

from __future__ import annotations

import math

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

GRASP_ASIDE, GRASP_ABOVE = 0.08, 0.13
"""A hand is ready to grasp that is so near to a block's middle, and so far above it at most, m."""
UPRIGHT = 0.15
"""rad by which its heading is off at most."""
PLACE_ASIDE, PLACE_ABOVE = 0.075, 0.05
"""A held block is ready to be placed that is so far from above the other one's middle, with such a gap, m."""
ON_ASIDE, ON_GAP = 0.075, 0.015
"""The same of one that lies upon another."""


def holding(state: State, objects: tuple[Object, ...]) -> float:
    return float(state.get(objects[1], "held")[0] > 0.5)


def ready_grasp(state: State, objects: tuple[Object, ...]) -> float:
    robot, block = objects
    (x, y, theta), (bx, by) = state[robot][:3], state[block][:2]
    around = abs(x - bx) < GRASP_ASIDE and 0.0 < y - by < GRASP_ABOVE and abs(theta - DOWN) < UPRIGHT
    return float(around and not any(holding(state, (robot, b)) for b in state.of_type(BLOCK)))


def ready_place(state: State, objects: tuple[Object, ...]) -> float:
    robot, block, below = objects
    aside, gap = above(state, block, below)
    return float(holding(state, (robot, block)) > 0 and aside < PLACE_ASIDE and 0.0 <= gap < PLACE_ABOVE)


def on(state: State, objects: tuple[Object, ...]) -> float:
    aside, gap = above(state, *objects)
    return float(state.get(objects[0], "held")[0] < 0.5 and aside < ON_ASIDE and abs(gap) < ON_GAP)


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
