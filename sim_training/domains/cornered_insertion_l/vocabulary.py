"""What can be told of a scene with a lid and a drawer, and what the given skills are believed to need and to change.

The given operators know lid, drawer and towers. They do not know what a corner is.
"""

from __future__ import annotations

import numpy as np

from resync_robot.core import fittings, spatial
from resync_robot.core.state import State
from resync_robot.core.symbols import Object, Operator, Predicate, Variable
from resync_robot.core.vocabulary import BLOCK, BOX, DRAWER, LID, ROBOT
from resync_robot.sim_training.domains.cornered_insertion_s import domain as small
from resync_robot.sim_training.domains.cornered_insertion_s.corner import half_width
from resync_robot.sim_training.domains.cornered_insertion_s.domain import HAND_EMPTY, HOLDING, ON

OPEN = 0.14
"""m from which on a drawer is open: what a tower and the fingers around it need, and a little more."""
CLOSED = 0.006
"""m up to which it is closed."""
PADS = 0.03
"""m above the tips up to which the pads hold something by its lower end."""
ON_THE_FLOOR = 0.006
"""m that the underside of a block in a drawer may be from its floor."""

HOLDING_TOWER = Predicate("HoldingTower", (ROBOT, BLOCK, BLOCK))
LID_ON = Predicate("LidOn", (LID,))
LID_OFF = Predicate("LidOff", ())
DRAWER_OPEN = Predicate("DrawerOpen", (DRAWER,))
DRAWER_CLOSED = Predicate("DrawerClosed", (DRAWER,))
IN = Predicate("In", (BLOCK, DRAWER))
OUTSIDE = Predicate("Outside", (BLOCK,))

PREDICATES = (HAND_EMPTY, HOLDING, HOLDING_TOWER, ON, LID_ON, LID_OFF, DRAWER_OPEN, DRAWER_CLOSED, IN, OUTSIDE)


def holding(state: State, objects: tuple[Object, ...]) -> float:
    """Is the block between pads that are closed on it? Where a tower has come apart in the hand, its lower block is
    gone, and the pads, which reach up past that, hold the next one by its lower end."""
    robot, block = objects
    if small.holding(state, objects):
        return 1.0
    lowest = not any(small.holding(state, (robot, other)) for other in state.of_type(BLOCK))
    return float(lowest and _hangs_between_pads(state, robot, block))


def _hangs_between_pads(state: State, robot: Object, block: Object) -> bool:
    width, height = state.get(block, "size_x", "size_y").max(), state.get(block, "size_z")[0]
    if state.get(robot, "opening")[0] >= width + 0.008:
        return False
    tip_T_world = spatial.inverse(spatial.pose_from_features(state[robot][:7]))
    x, y, down = spatial.apply(tip_T_world, state[block][None, :3].astype(np.float64))[0]
    return bool(abs(x) < 0.03 and abs(y) < 0.02 and 0 <= -down - height / 2 < PADS)


def holding_tower(state: State, objects: tuple[Object, ...]) -> float:
    """Is the lower block between the pads, and the upper one seated on it?"""
    robot, upper, lower = objects
    return min(holding(state, (robot, lower)), small.on(state, (upper, lower)))


def hand_empty(state: State, objects: tuple[Object, ...]) -> float:
    """Is neither a block nor the knob of a lid between the pads?"""
    robot = objects[0]
    of_blocks = max((holding(state, (robot, block)) for block in state.of_type(BLOCK)), default=0.0)
    of_lids = max((_holding_knob(state, robot, lid) for lid in state.of_type(LID)), default=0.0)
    return 1.0 - max(of_blocks, of_lids)


def _holding_knob(state: State, robot: Object, lid: Object) -> float:
    if state.get(robot, "opening")[0] >= fittings.LID.knob[0] + 0.008:
        return 0.0
    tip_T_lid = spatial.inverse(spatial.pose_from_features(state[robot][:7])) @ spatial.pose_from_features(
        state[lid][:7]
    )
    knob = tip_T_lid @ np.array([0.0, 0.0, (state.get(lid, "size_z")[0] + fittings.LID.knob[2]) / 2, 1.0])
    return float(np.all(np.abs(knob[:3]) < [0.02, 0.02, 0.04]))


def lid_on(state: State, objects: tuple[Object, ...]) -> float:
    """Does the lid cover any of the inside of a box?"""
    (lid,) = objects
    side = float(state.get(lid, "size_x", "size_y").max())
    for box in state.of_type(BOX):
        local = spatial.inverse(spatial.pose_from_features(state[box][:7])) @ spatial.pose_from_features(state[lid][:7])
        heading = np.arctan2(local[1, 0], local[0, 0])
        between = np.abs(local[:2, 3]) - state.get(box, "inner_x", "inner_y") / 2 - half_width(side, heading)
        if np.all(between < 0):
            return 1.0
    return 0.0


def lid_off(state: State, objects: tuple[Object, ...]) -> float:
    """Is every box uncovered?"""
    return 1.0 - max((lid_on(state, (lid,)) for lid in state.of_type(LID)), default=0.0)


def drawer_open(state: State, objects: tuple[Object, ...]) -> float:
    return float(state.get(objects[0], "opening")[0] >= OPEN)


def drawer_closed(state: State, objects: tuple[Object, ...]) -> float:
    return float(state.get(objects[0], "opening")[0] <= CLOSED)


def in_drawer(state: State, objects: tuple[Object, ...]) -> float:
    """Does the block stand on the floor of the drawer? What stands on it is in the drawer with it."""
    block, drawer = objects
    z, height = state.get(block, "z", "size_z")
    upright = spatial.pose_from_features(state[block][:7])[2, 2] > 0.95
    stands = abs(z - height / 2 - fittings.DRAWER.floor) < ON_THE_FLOOR and upright
    return float(stands and _over_tray(state, block, drawer))


def _over_tray(state: State, block: Object, drawer: Object) -> bool:
    """Is its middle, seen from above, within the walls of the drawer?"""
    x, y, *_ = spatial.apply(
        spatial.inverse(spatial.pose_from_features(state[drawer][:7])), state[block][None, :3].astype(np.float64)
    )[0]
    deep, wide, _ = fittings.DRAWER.tray
    behind = -x - state.get(drawer, "size_x")[0] / 2
    return bool(0 < behind < deep and abs(y) < wide / 2)


def outside(state: State, objects: tuple[Object, ...]) -> float:
    """Is the block in no drawer, be it on another block? Hand and fingers reach into none for a single block."""
    return 1.0 - any(_over_tray(state, objects[0], drawer) for drawer in state.of_type(DRAWER))


CLASSIFIERS = {
    "HandEmpty": hand_empty,
    "Holding": holding,
    "HoldingTower": holding_tower,
    "On": small.on,
    "LidOn": lid_on,
    "LidOff": lid_off,
    "DrawerOpen": drawer_open,
    "DrawerClosed": drawer_closed,
    "In": in_drawer,
    "Outside": outside,
}

_r, _l, _d = Variable("?r", ROBOT), Variable("?l", LID), Variable("?d", DRAWER)
_b, _b0, _b1 = (Variable(n, BLOCK) for n in ("?b", "?b0", "?b1"))
_EMPTY, _UNCOVERED = HAND_EMPTY(_r), LID_OFF()

OPERATORS = (
    Operator(
        "RemoveLid",
        (_r, _l),
        frozenset({_EMPTY, LID_ON(_l)}),
        frozenset({_UNCOVERED}),
        frozenset({LID_ON(_l)}),
    ),
    Operator(
        "Pick",
        (_r, _b),
        frozenset({_EMPTY, _UNCOVERED, OUTSIDE(_b)}),
        frozenset({HOLDING(_r, _b)}),
        frozenset({_EMPTY}),
    ),
    Operator(
        "Insert",
        (_r, _b0, _b1),
        frozenset({HOLDING(_r, _b0), _UNCOVERED, OUTSIDE(_b1)}),
        frozenset({ON(_b0, _b1), _EMPTY}),
        frozenset({HOLDING(_r, _b0)}),
    ),
    small.PLACE,
    Operator(
        "OpenDrawer",
        (_r, _d),
        frozenset({_EMPTY}),
        frozenset({DRAWER_OPEN(_d)}),
        frozenset({DRAWER_CLOSED(_d)}),
    ),
    Operator(
        "PickTower",
        (_r, _b0, _b1),
        frozenset({_EMPTY, ON(_b0, _b1), _UNCOVERED, OUTSIDE(_b1)}),
        frozenset({HOLDING(_r, _b1), HOLDING_TOWER(_r, _b0, _b1)}),
        frozenset({_EMPTY}),
    ),
    Operator(
        "PlaceTower",
        (_r, _b0, _b1, _d),
        frozenset({HOLDING(_r, _b1), HOLDING_TOWER(_r, _b0, _b1), DRAWER_OPEN(_d)}),
        frozenset({IN(_b1, _d), _EMPTY}),
        frozenset({HOLDING(_r, _b1), HOLDING_TOWER(_r, _b0, _b1), OUTSIDE(_b0), OUTSIDE(_b1)}),
    ),
    Operator(
        "CloseDrawer",
        (_r, _d),
        frozenset({_EMPTY}),
        frozenset({DRAWER_CLOSED(_d)}),
        frozenset({DRAWER_OPEN(_d)}),
    ),
)
"""All that is given; of a drawer that is ajar both ways are open."""
