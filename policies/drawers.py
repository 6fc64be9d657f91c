"""The given skills for drawers: OpenDrawer pulls at the handle, CloseDrawer pushes with closed fingers.

Both look for the place along the front where nothing stands in the way of the fingers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from resync_robot.core import fittings, spatial
from resync_robot.core.rig import Rig
from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, DRAWER, ROBOT
from resync_robot.core.world import ArmObservation
from resync_robot.policies.cartesian import Blocked, Hand, Motion, run_motion
from resync_robot.policies.grasp import finger_clearance, travel_height
from resync_robot.policies.scripted import RATE_HZ, ScriptedSettings, heading

BUILT = fittings.DRAWER
ENOUGH = 0.008
"""m of room beside the fingers beyond which more of it is worth nothing."""


class Way(NamedTuple):
    """Where fingers go down: m ahead of a front's outer face, m beside its middle, and the height of the tips, m."""

    ahead: float
    beside: float
    tip_z: float


@dataclass(frozen=True, kw_only=True)
class DrawerSettings:
    """Lengths in m, speeds in m/s, forces in N.

    Attributes:
        speed: of pulling and pushing; a tower in the tray stands at several times as much.
        pull, push: what a drawer may resist. At its end it resists more.
        below: how far below the middle of the handle the finger tips reach.
        clearance: free space a side between an open finger and the handle.
        edge: how far below the upper edge of the front the tips reach that push there.
        slipped: by how much narrower than the handle the pads may be that hold it.
        before: room between fingers and front before they push.
        beyond: how much further than closed they are sent.
        shut: how far from closed they may be stopped.
        closed: between the pads, below which the hand counts as closed.
        margin: from the ends of the handle, or of the front, to the middle of the fingers.
    """

    speed: float = 0.06
    pull: float = 40.0
    push: float = 30.0
    below: float = 0.012
    clearance: float = 0.014
    edge: float = 0.020
    slipped: float = 0.005
    before: float = 0.02
    beyond: float = 0.004
    shut: float = 0.008
    closed: float = 0.010
    margin: float = 0.018


def drawer_skills(
    rig: Rig, settings: ScriptedSettings | None = None, drawers: DrawerSettings | None = None
) -> tuple[Skill, ...]:
    """OpenDrawer(robot, drawer) and CloseDrawer(robot, drawer)."""
    s, of_drawers = settings or ScriptedSettings(), drawers or DrawerSettings()
    return (
        Skill(
            "OpenDrawer",
            (ROBOT, DRAWER),
            lambda objects, first: run_motion(_open(objects, first, rig, s, of_drawers), first),
            RATE_HZ,
            40,
        ),
        Skill(
            "CloseDrawer",
            (ROBOT, DRAWER),
            lambda objects, first: run_motion(_close(objects, first, rig, s, of_drawers), first),
            RATE_HZ,
            40,
        ),
    )


def _open(
    objects: tuple[Object, ...], first: ArmObservation, rig: Rig, s: ScriptedSettings, of_drawers: DrawerSettings
) -> Motion:
    _, drawer = objects
    state = first.state
    hand = Hand(rig, first, 1.0 / RATE_HZ, s.stray)
    bar, opening = BUILT.bar[0], float(state.get(drawer, "opening")[0])
    apart = bar + 2 * of_drawers.clearance
    half = np.array([apart / 2 + rig.gripper.finger_thickness, rig.gripper.finger_width / 2])
    along = _along(BUILT.bar[1], of_drawers.margin)
    ways = [Way(BUILT.reach - bar / 2, y, BUILT.bar_z - of_drawers.below) for y in along]
    ahead, beside, tip_z = _freest(state, drawer, ways, half)
    x, y = _at(state, drawer, ahead, beside)
    end = _at(state, drawer, ahead + BUILT.travel - opening, beside)
    yaw = hand.yaw + float(spatial.wrap(heading(state, drawer) + np.pi / 2 - hand.yaw, np.pi))
    above = travel_height(state, carried=None)
    try:
        yield from hand.retreat(above, s.approach_speed)
        yield from hand.open(apart)
        yield from hand.move(x, y, above, yaw, s.travel_speed)
        yield from hand.move(x, y, tip_z, yaw, s.descent_speed, max_force=s.touch_force)
    except Blocked as blocked:
        yield from hand.back_off(above, s.approach_speed)
        return SkillOutcome(SkillEnd.BLOCKED, f"descending to the handle of {drawer}: {blocked}")
    yield from hand.close(0.0)
    reason = _off_the_handle(hand, of_drawers)
    if not reason:
        try:
            yield from hand.move(*end, tip_z, yaw, of_drawers.speed, max_force=of_drawers.pull)
            reason = _off_the_handle(hand, of_drawers)
        except Blocked as blocked:
            reason = str(blocked)
    yield from hand.give_in()
    yield from hand.open(apart)
    yield from hand.back_off(above, s.approach_speed)
    return SkillOutcome(SkillEnd.BLOCKED, f"pulling {drawer}: {reason}") if reason else SkillOutcome(SkillEnd.DONE)


def _off_the_handle(hand: Hand, of_drawers: DrawerSettings) -> str:
    """What is wrong where the pads do not hold a handle; else nothing."""
    gap = hand.last.opening
    return "" if abs(gap - BUILT.bar[0]) < of_drawers.slipped else f"the pads are {1000 * gap:.0f} mm apart"


def _close(
    objects: tuple[Object, ...], first: ArmObservation, rig: Rig, s: ScriptedSettings, of_drawers: DrawerSettings
) -> Motion:
    _, drawer = objects
    state = first.state
    hand = Hand(rig, first, 1.0 / RATE_HZ, s.stray)
    opening, width = state.get(drawer, "opening", "size_y")
    half = np.array([rig.gripper.finger_width / 2, rig.gripper.finger_thickness])
    start, past = half[0] + of_drawers.before, BUILT.bar[1] / 2 + of_drawers.margin
    on_bar = [
        Way(BUILT.reach + start, y, BUILT.bar_z - of_drawers.below) for y in _along(BUILT.bar[1], of_drawers.margin)
    ]
    # Near its upper edge, or the palm would meet the cabinet.
    edge = float(state.get(drawer, "z", "size_z") @ [1.0, 0.5]) - of_drawers.edge
    on_front = [Way(start, y, edge) for y in _along(width, of_drawers.margin) if abs(y) > past]
    ahead, beside, tip_z = _freest(state, drawer, [*on_bar, *on_front], half)
    x, y = _at(state, drawer, ahead, beside)
    end = _at(state, drawer, ahead - of_drawers.before - opening - of_drawers.beyond, beside)
    yaw = hand.yaw + float(spatial.wrap(heading(state, drawer) - hand.yaw, np.pi))
    above = travel_height(state, carried=None)
    try:
        yield from hand.retreat(above, s.approach_speed)
        yield from hand.close(0.0)
        if hand.last.opening > of_drawers.closed:
            gap = 1000 * hand.last.opening
            return SkillOutcome(SkillEnd.REFUSED, f"the pads stand {gap:.0f} mm apart: something is between them")
        yield from hand.move(x, y, above, yaw, s.travel_speed)
        yield from hand.move(x, y, tip_z, yaw, s.descent_speed, max_force=s.touch_force)
    except Blocked as blocked:
        yield from hand.back_off(above, s.approach_speed)
        return SkillOutcome(SkillEnd.BLOCKED, f"descending before {drawer}: {blocked}")
    reason = ""
    try:
        yield from hand.move(*end, tip_z, yaw, of_drawers.speed, max_force=of_drawers.push)
    except Blocked as blocked:
        reason = str(blocked)
    left = float(np.linalg.norm(hand.tip()[:2] - end)) - of_drawers.beyond
    yield from hand.give_in()
    outward = (np.array([x, y]) - end) / np.linalg.norm(np.array([x, y]) - end)
    try:
        away = hand.position[:2] + of_drawers.before * outward
        yield from hand.move(*away, tip_z, yaw, s.approach_speed)
    except Blocked:
        # It leaves upward all the same.
        pass
    yield from hand.back_off(above, s.approach_speed)
    if left > of_drawers.shut:
        return SkillOutcome(SkillEnd.BLOCKED, f"pushing {drawer}, {1000 * left:.0f} mm from closed: {reason}")
    return SkillOutcome(SkillEnd.DONE)


def _along(width: float, margin: float) -> np.ndarray:
    """Distances beside the middle of something of that width, m; the middle first."""
    most = width / 2 - margin
    return np.array(sorted(np.linspace(-most, most, 2 * int(np.ceil(most / 0.015)) + 1), key=abs))


def _freest(state: State, drawer: Object, ways: list[Way], half: np.ndarray) -> Way:
    """The first where fingers of (2,) half extents, along and across the way it is pulled, have room among the blocks;
    where none has, the one with most of it."""
    corners = np.array([(sx * half[0], sy * half[1]) for sx in (-1, 0, 1) for sy in (-1, 0, 1)])
    blocks = state.project(state.of_type(BLOCK))

    def room(way: Way) -> float:
        points = np.array([_at(state, drawer, way.ahead + x, way.beside + y) for x, y in corners])
        return min(float(finger_clearance(blocks, points, way.tip_z, blocks.objects).min(initial=np.inf)), ENOUGH)

    return max(ways, key=room)


def _at(state: State, drawer: Object, ahead: float, beside: float) -> tuple[float, float]:
    """x, y in the world, m: so far ahead of the outer face of a drawer's front, and beside its middle."""
    pose = spatial.pose_from_features(state[drawer][:7])
    x, y = (pose @ np.array([state.get(drawer, "size_x")[0] / 2 + ahead, beside, 0.0, 1.0]))[:2]
    return float(x), float(y)
