"""The given skills: Pick, Insert and Place as guarded Cartesian motions through closed-form inverse kinematics.

A skill reads the scene once, at its start, chooses the yaw that leaves the fingers most room, and moves. It does not
know what a corner is: where no yaw clears the walls it tries the best one, and its guards say what happened.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from resync_robot.core.rig import Rig
from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.spatial import inverse, pose_from_features, wrap, yaw_of
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, ROBOT
from resync_robot.core.world import ArmObservation
from resync_robot.policies.cartesian import Blocked, Dropped, Hand, Motion, Step, run_motion
from resync_robot.policies.grasp import best_approach, best_yaw, carried_with, finger_corners, travel_height
from resync_robot.policies.placing import Places, free_places

RATE_HZ = 50.0
GRASPED = 0.008
"""m by which the pads may stand wider or narrower than a block is believed to be that they hold."""


@dataclass(frozen=True, kw_only=True)
class ScriptedSettings:
    """Speeds in m/s, lengths in m, forces in N."""

    travel_speed: float = 0.25
    approach_speed: float = 0.10
    descent_speed: float = 0.06
    """Towards things: what is met at twice this speed is hit with 200 N before a 50 Hz guard can stop the arm."""
    contact_speed: float = 0.02
    seat_speed: float = 0.008
    """A stud finds its socket at 8 mm/s; twice that jams."""
    approach_clearances: tuple[float, ...] = (0.012, 0.008, 0.005)
    """Free space a side between an open finger and the block; less of it only where more does not fit."""
    release_clearance: float = 0.008
    squeeze: float = 0.020
    """How much narrower than the block the pads are told to close."""
    grasp_depth: float = 0.004
    """How far below the block's centre the finger tips reach."""
    touch_force: float = 25.0
    """A descent through free space that meets more than this is stopped."""
    seat_force: float = 15.0
    contact_range: float = 0.008
    """How much higher or lower the ground may be than it is believed, where a block is put down."""
    places: int = 3
    """How many places are tried where something is in the way of putting a block down."""
    stray: float = 0.025
    """A tip that is this far from where it was sent is held by something."""


def scripted_skills(rig: Rig, settings: ScriptedSettings | None = None) -> tuple[Skill, ...]:
    """Pick(robot, block), Insert(robot, held block, base block) and Place(robot, held block)."""
    s = settings or ScriptedSettings()
    return (
        Skill(
            "Pick", (ROBOT, BLOCK), lambda objects, first: run_motion(_pick(objects, first, rig, s), first), RATE_HZ, 40
        ),
        Skill(
            "Insert",
            (ROBOT, BLOCK, BLOCK),
            lambda objects, first: run_motion(_insert(objects, first, rig, s), first),
            RATE_HZ,
            40,
        ),
        Skill(
            "Place",
            (ROBOT, BLOCK),
            lambda objects, first: run_motion(_place(objects, first, rig, s), first),
            RATE_HZ,
            60,
        ),
    )


LEAST_OVER_GROUND = 0.003
"""m that the tips keep from the ground where something is put down, at the lowest that they are sent."""


def _pick(objects: tuple[Object, ...], first: ArmObservation, rig: Rig, s: ScriptedSettings) -> Motion:
    _, block = objects
    hand = Hand(rig, first, 1.0 / RATE_HZ, s.stray)
    z, height = first.state.get(block, "z", "size_z")
    tip_z = z - min(s.grasp_depth, height / 2 - 0.008)
    return (yield from pick_up(hand, first.state, block, tip_z, s))


def pick_up(hand: Hand, state: State, block: Object, tip_z: float, s: ScriptedSettings) -> Motion:
    """Grasp a block with the tips at the height `tip_z` m, and lift it with what stands on it."""
    gripper = hand.rig.gripper
    x, y, width = *state.get(block, "x", "y"), float(state.get(block, "size_x", "size_y").max())
    openings = [min(width + 2 * clearance, gripper.max_opening) for clearance in s.approach_clearances]
    yaw, opening = best_approach(state, block, heading(state, block), tip_z, openings, gripper, hand.yaw)
    above = travel_height(state, carried=None)
    try:
        yield from reach_down(hand, np.array([x, y, tip_z]), yaw, opening, above, s)
    except Blocked as blocked:
        yield from hand.back_off(above, s.approach_speed)
        return SkillOutcome(blocked.ending, f"descending to {block}: {blocked}")
    yield from hand.close(width - s.squeeze)
    if abs(hand.last.opening - width) <= GRASPED:
        hand.hold()
    try:
        yield from hand.move(x, y, above, yaw, s.approach_speed)
    except Blocked as blocked:
        return SkillOutcome(blocked.ending, f"lifting {block}: {blocked}")
    if abs(hand.last.opening - width) > GRASPED:
        gap = 1000 * hand.last.opening
        yield from hand.open(opening)
        return SkillOutcome(SkillEnd.BLOCKED, f"the pads are {gap:.0f} mm apart, not on {block}")
    return SkillOutcome(SkillEnd.DONE)


def reach_down(hand: Hand, tip: np.ndarray, yaw: float, opening: float, above: float, s: ScriptedSettings) -> Step:
    """Bring the tip to (3,) `tip` from over it, with the pads `opening` m apart once they are there. Raises Blocked."""
    x, y, z = tip
    yield from hand.retreat(above, s.approach_speed)
    yield from hand.move(x, y, above, yaw, s.travel_speed, opening=opening)
    yield from hand.move(x, y, z, yaw, s.descent_speed, max_force=s.touch_force)


def _insert(objects: tuple[Object, ...], first: ArmObservation, rig: Rig, s: ScriptedSettings) -> Motion:
    robot, held, base = objects
    state = first.state
    hand = Hand(rig, first, 1.0 / RATE_HZ, s.stray)
    tip_T_held = pose_in_hand(state, robot, held)
    if tip_T_held is None:
        return SkillOutcome(SkillEnd.REFUSED, f"{held} is not in the hand")
    hand.hold()
    width = float(state.get(held, "size_x", "size_y").max())
    x, y, z, base_height = state.get(base, "x", "y", "z", "size_z")
    seated = z + (base_height + state.get(held, "size_z")[0]) / 2
    # The tip points down, so a turn of the block in the hand is a turn of the tip the other way round.
    turned = heading(state, held) - yaw_tip(state, robot)
    opening = width + 2 * s.release_clearance
    tip_z = seated + tip_T_held[2, 3]
    yaw = best_yaw(state, base, heading(state, base) - turned, tip_z, opening, rig.gripper, hand.yaw, ignore=held)
    offset = hand.rotation(yaw) @ tip_T_held[:3, 3]
    goal_x, goal_y, goal_z = np.array([x, y, seated]) - offset
    above = travel_height(state, carried=held)

    def back_off() -> Motion:
        yield from hand.back_off(above, s.approach_speed)
        return SkillOutcome(SkillEnd.DONE)

    try:
        yield from hand.retreat(above, s.approach_speed)
        yield from hand.move(goal_x, goal_y, above, yaw, s.travel_speed)
        yield from hand.move(goal_x, goal_y, goal_z + 0.030, yaw, s.descent_speed, max_force=s.touch_force)
        yield from hand.move(goal_x, goal_y, goal_z + 0.016, yaw, s.contact_speed, max_force=s.seat_force)
    except Blocked as blocked:
        yield from back_off()
        return SkillOutcome(blocked.ending, f"over {base}: {blocked}")
    try:
        yield from hand.move(goal_x, goal_y, goal_z - 0.001, yaw, s.seat_speed, max_force=s.seat_force)
    except Blocked:
        # On the stud: the block may still drop in when the pads let go, so release and let the state decide.
        pass
    yield from hand.open(opening)
    try:
        yield from hand.move(goal_x, goal_y, above, yaw, s.approach_speed)
    except Blocked as blocked:
        return SkillOutcome(blocked.ending, f"leaving {base}: {blocked}")
    return SkillOutcome(SkillEnd.DONE)


def _place(objects: tuple[Object, ...], first: ArmObservation, rig: Rig, s: ScriptedSettings) -> Motion:
    robot, held = objects
    state = first.state
    hand = Hand(rig, first, 1.0 / RATE_HZ, s.stray)
    tip_T_held = pose_in_hand(state, robot, held)
    if tip_T_held is None:
        return SkillOutcome(SkillEnd.REFUSED, f"{held} is not in the hand")
    hand.hold()
    carried = carried_with(state, held)
    width = float(state.get(held, "size_x", "size_y").max())
    above = travel_height(state, carried=held)
    # The hand keeps its heading, and with it what its fingers need.
    opening = width + 2 * max(s.release_clearance, s.approach_clearances[-1])
    fingers = finger_corners(np.zeros(2), hand.yaw, opening, rig.gripper)
    body = width / 2 * np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), -1).reshape(-1, 2)
    needs = np.vstack([fingers, body @ hand.rotation(hand.yaw)[:2, :2].T])
    block_to_tip = np.array([0.0, 0.0, state.get(held, "size_z")[0] / 2]) - hand.rotation(hand.yaw) @ tip_T_held[:3, 3]
    places = free_places(
        state, carried, width, needs, hand.position[:2], lambda p: reached(p + block_to_tip, above, hand)
    )
    if not places:
        return SkillOutcome(SkillEnd.REFUSED, f"no free place within reach to put {held} down")
    reason = ""
    for place in places[: s.places]:
        tip = place + block_to_tip
        # A block that is held by its lower end is let fall: the tips reach further down than it does.
        tip[2] = max(tip[2], place[2] + s.contact_range + LEAST_OVER_GROUND)
        try:
            yield from bring_over(hand, tip, hand.yaw, above, s)
        except Dropped as dropped:
            yield from hand.back_off(above, s.approach_speed)
            return SkillOutcome(dropped.ending, f"carrying {held}: {dropped}")
        except Blocked as blocked:
            reason = str(blocked)
            yield from hand.back_off(above, s.approach_speed)
            continue
        return (yield from stand_down(hand, tip, held, width + 2 * s.release_clearance, above, s))
    return SkillOutcome(SkillEnd.BLOCKED, f"putting {held} down: {reason}")


def bring_over(hand: Hand, tip: np.ndarray, yaw: float, above: float, s: ScriptedSettings) -> Step:
    """Bring what is held to just over where it is to stand, the tip to (3,) `tip` when it does. Raises Blocked."""
    x, y, z = tip
    yield from hand.retreat(above, s.approach_speed)
    yield from hand.move(x, y, above, yaw, s.travel_speed)
    yield from hand.move(x, y, z + s.contact_range, yaw, s.descent_speed, max_force=s.touch_force)


def stand_down(hand: Hand, tip: np.ndarray, held: Object, opening: float, above: float, s: ScriptedSettings) -> Motion:
    """From there, lower it until it stands, open the pads to `opening` m, and leave."""
    x, y, z = tip
    try:
        yield from hand.move(x, y, z - s.contact_range, hand.yaw, s.contact_speed, max_force=s.seat_force)
    except Blocked:
        # It stands on something.
        pass
    yield from hand.open(opening)
    try:
        yield from hand.move(x, y, above, hand.yaw, s.approach_speed)
    except Blocked as blocked:
        return SkillOutcome(blocked.ending, f"leaving {held}: {blocked}")
    return SkillOutcome(SkillEnd.DONE)


def reached(tips: Places, above: float, hand: Hand) -> np.ndarray:
    """(n,) whether the hand reaches these tip positions (n, 3), and those at the height `above` over them, as it is
    turned now."""
    over = tips.copy()
    over[:, 2] = above
    return hand.reaches(tips) & hand.reaches(over)


def pose_in_hand(state: State, robot: Object, block: Object) -> np.ndarray | None:
    """(4, 4) tip_T_block, or None where the block is somewhere else."""
    tip_T_block = inverse(pose_from_features(state[robot][:7])) @ pose_from_features(state[block][:7])
    return tip_T_block if np.linalg.norm(tip_T_block[:3, 3]) < 0.06 else None


def heading(state: State, obj: Object) -> float:
    """Of an object's x axis in the world, rad."""
    return float(yaw_of(state.get(obj, "qw", "qx", "qy", "qz")))


def yaw_tip(state: State, robot: Object) -> float:
    """Heading of the tip's x axis, rad; the tool points down."""
    rotation = pose_from_features(state[robot][:7])[:3, :3]
    return float(wrap(np.arctan2(rotation[1, 0], rotation[0, 0])))
