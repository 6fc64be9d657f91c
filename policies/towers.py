"""The given skills for towers: PickTower lifts one by its lowest block, PlaceTower stands it in a drawer.

Studs hold a tower together as long as it is held below: whoever lifts the upper block of two lifts one.
"""

from __future__ import annotations

import numpy as np

from resync_robot.core import fittings, spatial
from resync_robot.core.rig import Rig
from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, DRAWER, ROBOT
from resync_robot.core.world import ArmObservation
from resync_robot.policies.cartesian import Blocked, Hand, Motion, run_motion
from resync_robot.policies.grasp import carried_with, travel_height
from resync_robot.policies.scripted import (
    RATE_HZ,
    ScriptedSettings,
    bring_over,
    heading,
    pick_up,
    pose_in_hand,
    stand_down,
)

STUD = 0.012
"""m that a stud stands out of its block."""
UNDER_THE_PALM = 0.130
"""m from the tips of the fingers up to what a tower may reach between them."""
LEAST_GRASP = 0.008
"""m of the lowest block that the pads must at least have between them."""


def tower_skills(rig: Rig, settings: ScriptedSettings | None = None) -> tuple[Skill, ...]:
    """PickTower(robot, upper, lower block) and PlaceTower(robot, upper, lower block, drawer)."""
    s = settings or ScriptedSettings()
    return (
        Skill(
            "PickTower",
            (ROBOT, BLOCK, BLOCK),
            lambda objects, first: run_motion(_pick_tower(objects, first, rig, s), first),
            RATE_HZ,
            40,
        ),
        Skill(
            "PlaceTower",
            (ROBOT, BLOCK, BLOCK, DRAWER),
            lambda objects, first: run_motion(_place_tower(objects, first, rig, s), first),
            RATE_HZ,
            60,
        ),
    )


def _pick_tower(objects: tuple[Object, ...], first: ArmObservation, rig: Rig, s: ScriptedSettings) -> Motion:
    _, upper, lower = objects
    state = first.state
    if upper not in carried_with(state, lower):
        return SkillOutcome(SkillEnd.REFUSED, f"{upper} does not stand on {lower}")
    z, height = state.get(lower, "z", "size_z")
    lowest, highest = z - min(s.grasp_depth, height / 2 - LEAST_GRASP), z + height / 2 - LEAST_GRASP
    tip_z = max(lowest, _top(state, lower) - UNDER_THE_PALM)
    if tip_z > highest:
        return SkillOutcome(SkillEnd.REFUSED, f"the tower on {lower} is too high for the hand")
    return (yield from pick_up(Hand(rig, first, 1.0 / RATE_HZ, s.stray), state, lower, tip_z, s))


def _place_tower(objects: tuple[Object, ...], first: ArmObservation, rig: Rig, s: ScriptedSettings) -> Motion:
    robot, upper, lower, drawer = objects
    state = first.state
    hand = Hand(rig, first, 1.0 / RATE_HZ, s.stray)
    tip_T_held = pose_in_hand(state, robot, lower)
    if tip_T_held is None or upper not in carried_with(state, lower):
        return SkillOutcome(SkillEnd.REFUSED, f"{upper} on {lower} is not in the hand")
    hand.hold()
    width, height = float(state.get(lower, "size_x", "size_y").max()), float(state.get(lower, "size_z")[0])
    # The pads close across the drawer, where there is most room for them.
    yaw = hand.yaw + float(spatial.wrap(heading(state, drawer) - hand.yaw, np.pi))
    place = _middle_of(state, drawer) + np.array([0.0, 0.0, height / 2])
    tip, above = place - hand.rotation(yaw) @ tip_T_held[:3, 3], travel_height(state, carried=lower)
    try:
        yield from bring_over(hand, tip, yaw, above, s)
    except Blocked as blocked:
        yield from hand.back_off(above, s.approach_speed)
        return SkillOutcome(blocked.ending, f"over {drawer}: {blocked}")
    return (yield from stand_down(hand, tip, lower, width + 2 * s.release_clearance, above, s))


def _middle_of(state: State, drawer: Object) -> np.ndarray:
    """(3,) in the world, m: the middle of what is open of a drawer, on its floor."""
    opening, thickness = state.get(drawer, "opening", "size_x")
    pose = spatial.pose_from_features(state[drawer][:7])
    middle = (pose @ np.array([-thickness / 2 - opening / 2, 0.0, 0.0, 1.0]))[:3]
    middle[2] = fittings.DRAWER.floor
    return np.asarray(middle)


def _top(state: State, lower: Object) -> float:
    """Height of the highest stud of a tower, m."""
    z, height = state.get(carried_with(state, lower)[-1], "z", "size_z")
    return float(z + height / 2 + STUD)
