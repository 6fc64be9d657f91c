"""Which way to turn the hand, and how high to travel, from the geometry of the scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.fittings import LID as LID_SHAPE
from resync_robot.core.rig import GripperRig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, BOX, LID
from resync_robot.policies.fittings import footprints

ENOUGH = 0.010
"""Clearance in m beyond which more of it is worth no extra turn of the wrist."""
SPARE = 0.002
"""m that a finger must keep from what it goes down beside: poses are known no better."""
SEATED = 0.015
"""m that a block may be off its place on another one and still rides on it."""


def best_yaw(
    state: State,
    block: Object,
    along: float,
    tip_z: float,
    opening: float,
    gripper: GripperRig,
    current: float,
    ignore: Object | None = None,
) -> float:
    """The hand's yaw among `along` + k * 90 degrees that leaves the fingers most room around `block`.

    Args:
        along: heading in rad of one axis on which the pads may close.
        tip_z: height in m at which the finger tips will be.
        opening: free distance between the pads on the way down, m.
        current: the hand's yaw; among equally free ones the smallest turn wins.
        ignore: a block that is in the hand, and so no obstacle.
    """

    def score(yaw: float) -> float:
        return min(_room(state, block, yaw, tip_z, opening, gripper, ignore), ENOUGH) - 0.001 * abs(yaw - current)

    # A parallel gripper turned by 180 degrees is the same gripper: stay within a quarter turn of straight ahead.
    candidates = [float(spatial.wrap(along + k * np.pi / 2, np.pi)) for k in range(2)]
    return max(candidates, key=score)


def best_approach(
    state: State,
    block: Object,
    along: float,
    tip_z: float,
    openings: Sequence[float],
    gripper: GripperRig,
    current: float,
) -> tuple[float, float]:
    """The hand's yaw, as of `best_yaw`, and the first of `openings` with which the fingers keep SPARE from everything.

    Where none does, the one that leaves them most room; where something is in the way of all, the first.
    """
    ways = [(best_yaw(state, block, along, tip_z, opening, gripper, current), opening) for opening in openings]
    return max(ways, key=lambda way: np.clip(_room(state, block, way[0], tip_z, way[1], gripper, None), 0.0, SPARE))


def _room(
    state: State, block: Object, yaw: float, tip_z: float, opening: float, gripper: GripperRig, ignore: Object | None
) -> float:
    """Distance in m from the fingers around `block` to what is nearest; negative where they would be inside it."""
    others = [b for b in state.of_type(BLOCK) if b not in (block, ignore)]
    corners = finger_corners(state.get(block, "x", "y"), yaw, opening, gripper)
    return float(finger_clearance(state, corners, tip_z, others).min())


def finger_corners(centre: np.ndarray, yaw: float, opening: float, gripper: GripperRig) -> np.ndarray:
    """(8, 2) corners of both fingers' footprints, world frame; they close along y of the hand."""
    near, far, half = opening / 2, opening / 2 + gripper.finger_thickness, gripper.finger_width / 2
    local = np.array([(sx * half, sy * d) for sy in (-1, 1) for d in (near, far) for sx in (-1, 1)])
    c, s = np.cos(yaw), np.sin(yaw)
    return centre + local @ np.array([[c, s], [-s, c]])


def finger_clearance(
    state: State, points: Float[np.ndarray, "*n 2"], tip_z: float, others: Sequence[Object]
) -> Float[np.ndarray, "*n"]:
    """Distances in m from points of a finger to the nearest wall, lid, drawer or block of `others` that reaches up to
    it; negative inside."""
    room = np.full(points.shape[:-1], np.inf)
    for box in state.of_type(BOX):
        inner_x, inner_y, wall_z, thickness = state.get(box, "inner_x", "inner_y", "wall_z", "wall_thickness")
        pose = spatial.pose_from_features(state[box][:7])
        if tip_z > pose[2, 3] + wall_z + 0.005:
            continue
        local = np.abs((points - pose[:2, 3]) @ pose[:2, :2])
        half = np.array([inner_x, inner_y]) / 2
        inside, outside = (half - local).min(-1), (local - half - thickness).max(-1)
        room = np.minimum(room, np.maximum(inside, outside))
    for other in others:
        x, y, z, width, height = state.get(other, "x", "y", "z", "size_x", "size_z")
        if tip_z > z + height / 2:
            continue
        yaw = float(spatial.yaw_of(state.get(other, "qw", "qx", "qy", "qz")))
        c, s = np.cos(yaw), np.sin(yaw)
        local = np.abs((points - np.array([x, y])) @ np.array([[c, -s], [s, c]]))
        room = np.minimum(room, (local - width / 2).max(-1))
    for solid in footprints(state):
        if tip_z <= solid.top:
            room = np.minimum(room, solid.away(points))
    return room


def carried_with(state: State, held: Object) -> tuple[Object, ...]:
    """What a hand that holds a block carries: that block, and what is seated on it, from below up."""
    found = [held]
    for block in sorted(state.of_type(BLOCK), key=lambda b: float(state.get(b, "z")[0])):
        gap = state.get(block, "x", "y", "z") - state.get(found[-1], "x", "y", "z")
        seated = (state.get(block, "size_z")[0] + state.get(found[-1], "size_z")[0]) / 2
        if block != held and abs(gap[2] - seated) < SEATED and np.hypot(gap[0], gap[1]) < SEATED:
            found.append(block)
    return tuple(found)


def travel_height(state: State, carried: Object | None) -> float:
    """Tip height in m at which the hand and what it carries, with what rides on that, pass over everything that stands.

    Args:
        carried: a block or a lid.
    """
    in_hand = () if carried is None else (carried,) if carried.type == LID else carried_with(state, carried)
    tops = [0.0, *(solid.top for solid in footprints(state, ignore=in_hand))]
    for box in state.of_type(BOX):
        tops.append(float(state.get(box, "z", "wall_z").sum()))
    for block in state.of_type(BLOCK):
        if block not in in_hand:
            tops.append(float(state.get(block, "z")[0] + state.get(block, "size_z")[0] / 2 + 0.012))
    hanging = 0.0 if carried is None else float(state.get(carried, "size_z")[0])
    if carried is not None and carried.type == LID:
        hanging += LID_SHAPE.knob[2]
    return max(tops) + hanging + 0.03
