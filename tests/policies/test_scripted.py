"""Pick and Insert in the simulated world: what works in the open fails in a corner, and by physics alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import load_rig
from resync_robot.core.skill import SkillEnd, SkillOutcome
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.core.world import ArmObservation
from resync_robot.planning.execute import Listener
from resync_robot.planning.skill_run import run_skill
from resync_robot.policies.scripted import ScriptedSettings, scripted_skills
from resync_robot.sim_training.domains.cornered_insertion_s.domain import hand_empty, holding, on
from resync_robot.sim_training.physics.parts import CHAMFER, CLEARANCE
from resync_robot.sim_training.physics.world import SimWorld
from tests import scenes
from tests.policies.followers import Follower
from tests.scenes import B0, B1, B2, CORNER, THE_BOX, R

RIG = load_rig()
HARD = 20.0
"""N, far above that of a touch."""
SKILLS = {s.name: s for s in scripted_skills(RIG)}
FREE, ASIDE = (-0.07, -0.06, 0.3), (0.075, 0.06, -0.2)


def build(b0: Sequence[float], b1: Sequence[float] = ASIDE, kind: type[SimWorld] = SimWorld) -> SimWorld:
    task: Task = scenes.scene({"b0": b0, "b1": b1})
    world = kind(task, RIG)
    assert world.settles()
    return world


class ContactMonitor(Listener):
    """The peak force between the hand and each object while a skill runs, N."""

    def __init__(self, world: SimWorld) -> None:
        self.world = world
        self.peaks: dict[Object, float] = {}

    def on_control(self, observation: Any, action: Any) -> None:
        for obj, force in self.world.contacts().items():
            self.peaks[obj] = max(self.peaks.get(obj, 0.0), force)


def run(world: SimWorld, name: str, *objects: Object, monitor: ContactMonitor | None = None) -> SkillOutcome:
    return run_skill(world, SKILLS[name].ground((R, *objects)), monitor)


def test_a_free_block_is_picked_and_inserted_and_holds() -> None:
    world = build(FREE)
    assert run(world, "Pick", B0).done
    assert holding(world.perceive(), (R, B0)) and not hand_empty(world.perceive(), (R,))
    assert run(world, "Insert", B0, B1).done
    state = world.perceive()
    assert on(state, (B0, B1)) and not on(state, (B1, B0)) and hand_empty(state, (R,))
    # The stud holds what would slide off a flat block: a push of 1 N on the upper one, from each side.
    for push in ([1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [0, -1.0, 0]):
        body = world.built.rigid[B0]
        for _ in range(30):
            body.add_force_at_point(np.array(push), body.entity_pose.p)
            world.step()
    assert on(world.perceive(), (B0, B1))


@pytest.mark.parametrize("corner", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_a_cornered_block_cannot_be_picked_and_the_box_is_what_was_hit(corner: tuple[int, int]) -> None:
    world = build((corner[0] * CORNER, corner[1] * CORNER), (0.0, 0.0))
    before = world.perceive()
    monitor = ContactMonitor(world)
    outcome = run(world, "Pick", B0, monitor=monitor)
    assert outcome.ending is SkillEnd.BLOCKED and "b0" in outcome.reason
    state = world.perceive()
    assert not holding(state, (R, B0))
    assert np.linalg.norm(state[B0][:3] - before[B0][:3]) < 0.01
    assert monitor.peaks[THE_BOX] > HARD
    assert state.get(R, "z")[0] > scenes.FLOOR + scenes.RIM, "the hand is out of the way again"


def test_a_block_beside_one_wall_can_be_picked() -> None:
    world = build((CORNER, 0.03), (-0.08, -0.03))
    assert run(world, "Pick", B0).done
    assert holding(world.perceive(), (R, B0))


@pytest.mark.parametrize(("gap", "fits"), [(0.026, True), (0.019, True), (0.012, False)])
def test_between_neighbours_a_block_is_picked_where_a_finger_fits(gap: float, fits: bool) -> None:
    beside = scenes.WIDTH + gap
    world = SimWorld(scenes.scene({"b0": (0.0, 0.0), "b1": (beside, 0.0), "b2": (0.0, -beside)}), RIG)
    before = world.perceive()
    assert run(world, "Pick", B0).done is fits
    after = world.perceive()
    for neighbour in (B1, B2):
        assert np.linalg.norm(after[neighbour][:3] - before[neighbour][:3]) < 0.005


def test_nothing_is_inserted_on_a_cornered_block() -> None:
    world = build(FREE, (CORNER, CORNER))
    assert run(world, "Pick", B0).done
    outcome = run(world, "Insert", B0, B1)
    assert not on(world.perceive(), (B0, B1))
    assert outcome.ending is SkillEnd.BLOCKED and "b1" in outcome.reason


class Slippery(SimWorld):
    """A world in which the block leaves the hand as soon as it is over the other one."""

    def act(self, target: JointTarget, duration: float) -> None:
        if np.linalg.norm(self.perceive().get(B0, "x", "y") - self.perceive().get(B1, "x", "y")) < 0.05:
            self.place(B0, np.array([0.45, 0.45, 0.03, 1.0, 0.0, 0.0, 0.0]))
        super().act(target, duration)


def test_a_block_that_is_lost_on_the_way_ends_the_skill_at_once() -> None:
    world = build(FREE, kind=Slippery)
    assert run(world, "Pick", B0).done
    outcome = run(world, "Insert", B0, B1)
    assert outcome.ending is SkillEnd.DROPPED and "left the hand" in outcome.reason
    state = world.perceive()
    assert hand_empty(state, (R,)) and state.get(R, "z")[0] > scenes.FLOOR + scenes.RIM, (
        "and the hand is out of the way"
    )


class Misled(SimWorld):
    """A world whose observations show b1 in the wrong place by `error` m."""

    error = 0.0

    def observe(self, live: bool = False) -> ArmObservation:
        seen = super().observe(live)
        wrong = seen.state.with_features(B1, x=seen.state.get(B1, "x")[0] + self.error)
        return replace(seen, state=wrong)


LEAD_IN = CLEARANCE + 2 * CHAMFER[0]
"""How far stud and socket may be apart and still find each other, m."""


@pytest.mark.parametrize(("error", "seats"), [(LEAD_IN - 0.003, True), (LEAD_IN + 0.003, False)])
def test_an_insertion_seats_within_the_lead_in_and_not_beyond(error: float, seats: bool) -> None:
    world = build(FREE, kind=Misled)
    assert run(world, "Pick", B0).done
    world.error = error
    run(world, "Insert", B0, B1)
    assert bool(on(world.perceive(), (B0, B1))) is seats


def test_inserting_what_is_not_in_the_hand_is_refused_without_moving() -> None:
    world = Follower(scenes.scene({"b0": FREE, "b1": ASIDE}).initial)
    outcome = run_skill(world, SKILLS["Insert"].ground((R, B0, B1)))
    assert outcome == SkillOutcome(SkillEnd.REFUSED, "b0 is not in the hand")
    assert world.tips == []


def test_closing_on_nothing_is_reported() -> None:
    """A hand that finds no block where it was seen says how far the pads closed."""
    world = Follower(scenes.scene({"b0": FREE, "b1": ASIDE}).initial)
    outcome = run_skill(world, SKILLS["Pick"].ground((R, B0)))
    assert outcome.ending is SkillEnd.BLOCKED and "not on b0" in outcome.reason


def test_speeds_are_settings() -> None:
    slow = {s.name: s for s in scripted_skills(RIG, ScriptedSettings(travel_speed=0.05))}
    times = []
    for skills in (SKILLS, slow):
        world = Follower(scenes.scene({"b0": (-0.1, -0.1), "b1": ASIDE}).initial)
        run_skill(world, skills["Pick"].ground((R, B0)))
        times.append(world.time)
    assert times[1] > times[0] + 1.0


# -- Place ------------------------------------------------------------------------------------------------------------


def bottom(world: SimWorld, block: Object) -> float:
    return float(world.perceive().get(block, "z")[0] - scenes.HEIGHT / 2)


@pytest.mark.parametrize("blocked", [False, True], ids=["from the air", "after an insertion that was blocked"])
def test_what_is_in_the_hand_is_put_down_softly_and_can_be_picked_again(blocked: bool) -> None:
    world = build(FREE, (CORNER, CORNER))
    assert run(world, "Pick", B0).done
    if blocked:
        assert not run(world, "Insert", B0, B1).done
    before = world.perceive()
    monitor = ContactMonitor(world)
    assert run(world, "Place", B0, monitor=monitor).done
    state = world.perceive()
    assert hand_empty(state, (R,)) and not on(state, (B0, B1))
    assert bottom(world, B0) == pytest.approx(0.0, abs=0.001), "it stands on the table"
    assert np.linalg.norm(state[B1][:3] - before[B1][:3]) < 0.001
    assert THE_BOX not in monitor.peaks
    assert world.settles()
    assert run(world, "Pick", B0).done


def test_a_tower_is_put_down_by_its_lowest_block_and_stands() -> None:
    upper = (*FREE, scenes.FLOOR + scenes.HEIGHT)
    world = SimWorld(scenes.scene({"b0": FREE, "b1": ASIDE, "b2": upper}), RIG)
    assert run(world, "Pick", B0).done
    assert on(world.perceive(), (B2, B0))
    assert run(world, "Place", B0).done
    state = world.perceive()
    assert on(state, (B2, B0)) and hand_empty(state, (R,))
    assert bottom(world, B0) == pytest.approx(0.0, abs=0.001)
    assert world.settles()


def test_what_stands_where_nobody_knew_of_it_sends_the_block_to_another_place() -> None:
    """The observations show b1 in the box; it stands where the block would have gone."""
    world = build(FREE)
    assert run(world, "Pick", B0).done
    assert run(world, "Place", B0).done
    chosen = world.perceive()[B0][:2]
    offset = chosen - [scenes.BOX_X, 0.0]

    world = build(FREE, (*offset, 0.0, 0.0), kind=Hidden)
    assert run(world, "Pick", B0).done
    assert run(world, "Place", B0).done
    state = world.perceive()
    assert hand_empty(state, (R,)) and bottom(world, B0) == pytest.approx(0.0, abs=0.001)
    assert np.linalg.norm(state[B0][:2] - chosen) > scenes.WIDTH


class Hidden(SimWorld):
    """A world whose observations show b1 in the box, wherever it stands."""

    def observe(self, live: bool = False) -> ArmObservation:
        seen = super().observe(live)
        return replace(seen, state=seen.state.with_features(B1, x=scenes.BOX_X + 0.07, y=0.05, z=0.03))


def test_a_block_that_is_held_by_its_lower_end_is_let_fall_where_the_tips_would_meet_the_ground() -> None:
    x, y, z = RIG.tip_pose(RIG.arm.home)[:3, 3]
    lying = scenes.scene({"b0": FREE, "b1": ASIDE}).initial
    world = Follower(lying.with_features(B0, x=x, y=y, z=z + scenes.HEIGHT), opening=scenes.WIDTH)
    assert run_skill(world, SKILLS["Place"].ground((R, B0))).done
    lowest = min(float(tip[2]) for tip in world.tips)
    assert 0.002 < lowest < 0.005
    assert world.opening > scenes.WIDTH


def test_putting_down_what_is_not_in_the_hand_is_refused_without_moving() -> None:
    world = Follower(scenes.scene({"b0": FREE, "b1": ASIDE}).initial)
    assert run_skill(world, SKILLS["Place"].ground((R, B0))) == SkillOutcome(SkillEnd.REFUSED, "b0 is not in the hand")
    assert world.tips == []


def test_where_there_is_no_room_to_put_it_down_it_says_so_without_moving() -> None:
    grid = [(x, y) for x in np.arange(-0.2, 0.2, 0.12) for y in np.arange(-0.4, 0.41, 0.12)]
    crowd = scenes.scene({"b0": FREE} | {f"b{i}": (*place, 0.0, 0.0) for i, place in enumerate(grid, start=1)}).initial
    x, y, z = RIG.tip_pose(RIG.arm.home)[:3, 3]
    world = Follower(crowd.with_features(B0, x=x, y=y, z=z), opening=scenes.WIDTH)
    outcome = run_skill(world, SKILLS["Place"].ground((R, B0)))
    assert outcome == SkillOutcome(SkillEnd.REFUSED, "no free place within reach to put b0 down")
    assert world.tips == []
