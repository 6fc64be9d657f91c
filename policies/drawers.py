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
from resync_robot.policies.cartesian import Blocked, Hand, Motion, Step, run_motion
from resync_robot.policies.grasp import finger_clearance, travel_height
from resync_robot.policies.scripted import RATE_HZ, ScriptedSettings, heading, reach_down

BUILT = fittings.DRAWER
PITCH = 0.015
"""m between two places along a front that are considered."""
SPARE = 0.004
"""m that fingers keep from the ends of what they hold or push."""
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
    bar, across = BUILT.bar[:2]
    apart = bar + 2 * of_drawers.clearance
    fingers = np.array([apart / 2 + rig.gripper.finger_thickness, rig.gripper.finger_width / 2])
    # Between the two posts that hold the bar.
    along = _along(across - 2 * bar, fingers[1] + SPARE)
    ways = [Way(BUILT.reach - bar / 2, y, BUILT.bar_z - of_drawers.below) for y in along]
    way = _freest(state, drawer, ways, fingers)
    yaw = hand.yaw + float(spatial.wrap(heading(state, drawer) + np.pi / 2 - hand.yaw, np.pi))
    above = travel_height(state, carried=None)
    try:
        yield from reach_down(hand, _tip_at(state, drawer, way), yaw, apart, above, s)
    except Blocked as blocked:
        yield from hand.back_off(above, s.approach_speed)
        return SkillOutcome(SkillEnd.BLOCKED, f"descending to the handle of {drawer}: {blocked}")
    yield from hand.close(0.0)
    reason = _off_the_handle(hand, of_drawers)
    if not reason:
        left = BUILT.travel - float(state.get(drawer, "opening")[0])
        end = _tip_at(state, drawer, way._replace(ahead=way.ahead + left))
        try:
            yield from _slide(hand, end, of_drawers.speed, of_drawers.pull)
            reason = _off_the_handle(hand, of_drawers)
        except Blocked as blocked:
            reason = str(blocked)
            yield from hand.give_in()
    yield from hand.open(apart)
    yield from hand.back_off(above, s.approach_speed)
    return SkillOutcome(SkillEnd.BLOCKED, f"pulling {drawer}: {reason}") if reason else SkillOutcome(SkillEnd.DONE)


def _slide(hand: Hand, tip: np.ndarray, speed: float, max_force: float) -> Step:
    """Straight to (3,) `tip`, without a turn. Raises Blocked."""
    x, y, z = tip
    yield from hand.move(x, y, z, hand.yaw, speed, max_force)


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
    way = _freest(state, drawer, _ways_to_push(state, drawer, rig, of_drawers), _closed_fingers(rig))
    far = of_drawers.before + float(state.get(drawer, "opening")[0]) + of_drawers.beyond
    start, end = (_tip_at(state, drawer, w) for w in (way, way._replace(ahead=way.ahead - far)))
    yaw = hand.yaw + float(spatial.wrap(heading(state, drawer) - hand.yaw, np.pi))
    above = travel_height(state, carried=None)
    try:
        yield from hand.retreat(above, s.approach_speed)
        yield from hand.close(0.0)
        if hand.last.opening > of_drawers.closed:
            gap = 1000 * hand.last.opening
            return SkillOutcome(SkillEnd.REFUSED, f"the pads stand {gap:.0f} mm apart: something is between them")
        yield from reach_down(hand, start, yaw, 0.0, above, s)
    except Blocked as blocked:
        yield from hand.back_off(above, s.approach_speed)
        return SkillOutcome(SkillEnd.BLOCKED, f"descending before {drawer}: {blocked}")
    reason = ""
    try:
        yield from _slide(hand, end, of_drawers.speed, of_drawers.push)
    except Blocked as blocked:
        # Closed, or in front of what is in the way.
        reason = str(blocked)
    left = float(np.linalg.norm(hand.tip() - end)) - of_drawers.beyond
    yield from hand.give_in()
    away = hand.position + of_drawers.before * (start - end) / far
    try:
        yield from _slide(hand, away, s.approach_speed, np.inf)
    except Blocked:
        # It leaves upward all the same.
        pass
    yield from hand.back_off(above, s.approach_speed)
    if left > of_drawers.shut:
        return SkillOutcome(SkillEnd.BLOCKED, f"pushing {drawer}, {1000 * left:.0f} mm from closed: {reason}")
    return SkillOutcome(SkillEnd.DONE)


def _closed_fingers(rig: Rig) -> np.ndarray:
    """(2,) half extents, m, along and across a drawer that they push."""
    return np.array([rig.gripper.finger_width / 2, rig.gripper.finger_thickness])


def _ways_to_push(state: State, drawer: Object, rig: Rig, of_drawers: DrawerSettings) -> list[Way]:
    """Before the bar, and before the front to both sides of it."""
    ahead, beside = _closed_fingers(rig) + [of_drawers.before, SPARE]
    on_bar = [Way(BUILT.reach + ahead, y, BUILT.bar_z - of_drawers.below) for y in _along(BUILT.bar[1], beside)]
    # Near the upper edge of the front, or the palm would meet the cabinet.
    z, width, height = state.get(drawer, "z", "size_y", "size_z")
    ends = [y for y in _along(width, beside) if abs(y) > BUILT.bar[1] / 2 + beside]
    return [*on_bar, *(Way(ahead, y, z + height / 2 - of_drawers.edge) for y in ends)]


def _along(width: float, margin: float) -> list[float]:
    """Distances beside the middle of something of that width, but for a margin at its ends, m; the middle first."""
    most = width / 2 - margin
    return sorted(np.linspace(-most, most, 2 * int(np.ceil(most / PITCH)) + 1).tolist(), key=abs)


def _freest(state: State, drawer: Object, ways: list[Way], fingers: np.ndarray) -> Way:
    """The first where fingers of (2,) half extents, along and across the way it is pulled, have room among the blocks;
    where none has, the one with most of it."""
    corners = fingers * np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)])
    blocks = state.project(state.of_type(BLOCK))

    def room(way: Way) -> float:
        tips = [_tip_at(state, drawer, Way(way.ahead + x, way.beside + y, way.tip_z)) for x, y in corners]
        away = finger_clearance(blocks, np.array(tips)[:, :2], way.tip_z, blocks.objects)
        return min(float(away.min()), ENOUGH)

    return max(ways, key=room)


def _tip_at(state: State, drawer: Object, way: Way) -> np.ndarray:
    """(3,) m in the world."""
    pose = spatial.pose_from_features(state[drawer][:7])
    x, y = (pose @ np.array([state.get(drawer, "size_x")[0] / 2 + way.ahead, way.beside, 0.0, 1.0]))[:2]
    return np.array([x, y, way.tip_z])
