"""The given skill RemoveLid: lifts a lid by its knob and puts it down on the table, where there is room for it."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from resync_robot.core import fittings, spatial
from resync_robot.core.rig import Rig
from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, LID, ROBOT
from resync_robot.core.world import ArmObservation
from resync_robot.policies.cartesian import Blocked, Dropped, Hand, Motion, run_motion
from resync_robot.policies.fittings import footprints, in_a_way, knob_top
from resync_robot.policies.grasp import finger_clearance, travel_height
from resync_robot.policies.placing import Places
from resync_robot.policies.scripted import (
    RATE_HZ,
    ScriptedSettings,
    bring_over,
    heading,
    reach_down,
    reached,
    stand_down,
)


@dataclass(frozen=True, kw_only=True)
class LidSettings:
    """Lengths in m.

    Attributes:
        grasp: how far below the knob's upper face the finger tips reach.
        clearance: free space a side between an open finger and the knob.
        slipped: by how much narrower than the knob the pads may be that hold it.
        region: x and y in the world between which the middle of a lid is put down.
        pitch: between two places that are considered.
        room: least distance from the plate to what stands around it.
        ground: height of the table.
    """

    grasp: float = 0.035
    clearance: float = 0.015
    slipped: float = 0.006
    region: tuple[tuple[float, float], tuple[float, float]] = ((0.26, 0.62), (-0.56, 0.56))
    pitch: float = 0.03
    room: float = 0.015
    ground: float = 0.0


def lid_skills(
    rig: Rig, settings: ScriptedSettings | None = None, lids: LidSettings | None = None
) -> tuple[Skill, ...]:
    """RemoveLid(robot, lid)."""
    s, of_lids = settings or ScriptedSettings(), lids or LidSettings()
    return (
        Skill(
            "RemoveLid",
            (ROBOT, LID),
            lambda objects, first: run_motion(_remove(objects, first, rig, s, of_lids), first),
            RATE_HZ,
            60,
        ),
    )


def _remove(
    objects: tuple[Object, ...], first: ArmObservation, rig: Rig, s: ScriptedSettings, of_lids: LidSettings
) -> Motion:
    _, lid = objects
    state = first.state
    hand = Hand(rig, first, 1.0 / RATE_HZ, s.stray)
    x, y, z, thickness = state.get(lid, "x", "y", "z", "size_z")
    tip = np.array([x, y, knob_top(state, lid) - of_lids.grasp])
    yaw = hand.yaw + float(spatial.wrap(heading(state, lid) - hand.yaw, np.pi / 2))
    width, above, carrying = fittings.LID.knob[0], travel_height(state, None), travel_height(state, lid)
    opening = width + 2 * of_lids.clearance
    try:
        yield from reach_down(hand, tip, yaw, opening, above, s)
    except Blocked as blocked:
        yield from hand.back_off(above, s.approach_speed)
        return SkillOutcome(blocked.ending, f"descending to the knob of {lid}: {blocked}")
    yield from hand.close(width - s.squeeze)
    places = _places(state, lid, hand, tip[2] - z + thickness / 2, carrying, of_lids)
    refused = None
    if abs(hand.last.opening - width) > of_lids.slipped:
        gap = 1000 * hand.last.opening
        refused = SkillOutcome(SkillEnd.BLOCKED, f"the pads are {gap:.0f} mm apart, not on the knob of {lid}")
    elif not places:
        refused = SkillOutcome(SkillEnd.REFUSED, f"no free place within reach to put {lid} down")
    if refused is not None:
        yield from hand.open(opening)
        yield from hand.back_off(above, s.approach_speed)
        return refused
    hand.hold()
    try:
        yield from hand.move(x, y, carrying, yaw, s.approach_speed)
    except Blocked as blocked:
        yield from hand.open(opening)
        return SkillOutcome(blocked.ending, f"lifting {lid}: {blocked}")
    return (yield from _put_down(hand, lid, places[: s.places], opening, carrying, s, of_lids))


def _put_down(
    hand: Hand,
    lid: Object,
    places: list[np.ndarray],
    opening: float,
    carrying: float,
    s: ScriptedSettings,
    of_lids: LidSettings,
) -> Motion:
    """Lay a lid that hangs from the hand down at the first of these (3,) places of the tip where nothing is met.

    Where something is met at each, the last one has to do: no other skill can put a lid down. What is met is the table
    mostly, by the edge of a lid that hangs askew.
    """
    # Square to the table, so that it takes the least room.
    yaw, reason = hand.yaw - float(spatial.wrap(hand.yaw, np.pi / 2)), ""
    for tip in places:
        try:
            yield from bring_over(hand, tip, yaw, carrying, s)
        except Dropped as dropped:
            yield from hand.back_off(carrying, s.approach_speed)
            return SkillOutcome(dropped.ending, f"carrying {lid}: {dropped}")
        except Blocked as blocked:
            reason = str(blocked)
            yield from hand.back_off(carrying, s.approach_speed)
            continue
        return (yield from stand_down(hand, tip, lid, opening, carrying, s))
    x, y, _ = hand.position
    with suppress(Blocked):
        yield from hand.move(x, y, places[-1][2], hand.yaw, s.descent_speed, max_force=s.touch_force)
    yield from hand.give_in()
    yield from hand.open(opening)
    yield from hand.back_off(carrying, s.approach_speed)
    return SkillOutcome(SkillEnd.BLOCKED, f"putting {lid} down: {reason}")


def _places(
    state: State, lid: Object, hand: Hand, hanging: float, carrying: float, of_lids: LidSettings
) -> list[np.ndarray]:
    """(3,) each: where the tip may be when the lid lies on the table, square to it; the nearest to the lid first. Clear
    of where it lies now as well: of what it covers, a scan hardly sees how far it reaches."""
    x, y = (np.arange(low, high + of_lids.pitch / 2, of_lids.pitch) for low, high in of_lids.region)
    xy = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    half = state.get(lid, "size_x", "size_y") / 2
    across = [np.linspace(-h, h, int(np.ceil(2 * h / of_lids.pitch)) + 1) for h in half]
    plate = np.stack(np.meshgrid(*across, indexing="ij"), -1).reshape(-1, 2)
    others = state.project(o for o in state if o != lid)
    covered = xy[:, None] + plate
    room = finger_clearance(others, covered, of_lids.ground, state.of_type(BLOCK)).min(1)
    room = np.minimum(room, next(footprints(state.project([lid]))).away(covered).min(1))
    free = (room >= of_lids.room) & ~in_a_way(others, covered, of_lids.room).any(1)
    tips: Places = np.column_stack([xy, np.full(len(xy), of_lids.ground + hanging)])[free]
    tips = tips[reached(tips, carrying, hand)]
    return list(tips[np.argsort(np.linalg.norm(tips[:, :2] - state.get(lid, "x", "y"), axis=1), kind="stable")])
