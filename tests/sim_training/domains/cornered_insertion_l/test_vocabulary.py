"""What is told of lids, drawers and towers is so, and the given operators make plans of it."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.fittings import DRAWER as BUILT
from resync_robot.core.fittings import LID as PLATE
from resync_robot.core.state import State
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.search import plan
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.domains.cornered_insertion_l.vocabulary import (
    CLOSED,
    OPEN,
    drawer_closed,
    drawer_open,
    hand_empty,
    holding_tower,
    in_drawer,
    lid_off,
    lid_on,
    outside,
)
from resync_robot.sim_training.domains.cornered_insertion_l.vocabulary import holding as in_hand
from tests import furnished_scenes as furnished
from tests import scenes
from tests.furnished_scenes import THE_DRAWER, THE_LID
from tests.scenes import B0, B1, R

DOMAIN = find_domain("cornered-insertion-l")
GIVEN = Abstraction(DOMAIN.predicates, DOMAIN.classifiers)
STACKED = {"b0": (0.0, 0.0), "b1": (0.0, 0.0, 0.0, scenes.FLOOR + scenes.HEIGHT)}
OPENED = furnished.drawer_features(BUILT.travel)


@pytest.mark.parametrize(
    ("shift", "turn", "on"),
    [
        (0.0, 0.0, True),
        (0.02, 0.4, True),
        (0.25, 0.0, True),
        (0.34, 0.0, False),
        (0.34, 0.78, True),
        (0.45, 0.78, False),
    ],
)
def test_a_lid_is_on_as_long_as_it_covers_any_of_the_inside(shift: float, turn: float, on: bool) -> None:
    lid = furnished.lid_features(yaw=turn)
    lid[1] -= shift
    state = furnished.furnished(STACKED, lid=lid).initial
    assert bool(lid_on(state, (THE_LID,))) is on and bool(lid_off(state, ())) is not on


@pytest.mark.parametrize(
    ("opening", "opened", "closed"),
    [(0.0, False, True), (CLOSED + 1e-3, False, False), (OPEN - 1e-3, False, False), (OPEN, True, False)],
)
def test_an_ajar_drawer_is_neither_open_nor_closed(opening: float, opened: bool, closed: bool) -> None:
    state = furnished.furnished(STACKED, drawer=furnished.drawer_features(opening)).initial
    assert bool(drawer_open(state, (THE_DRAWER,))) is opened
    assert bool(drawer_closed(state, (THE_DRAWER,))) is closed


@pytest.mark.parametrize("opening", [BUILT.travel, 0.0])
def test_a_tower_is_in_the_drawer_by_its_lowest_block_and_goes_with_it(opening: float) -> None:
    task = furnished.in_tray(furnished.furnished(STACKED, drawer=OPENED), "b0", "b1")
    way = (BUILT.travel - opening) * spatial.pose_from_features(OPENED[:7])[:3, 0]
    state = task.initial
    for obj in (B0, B1, THE_DRAWER):
        state = state.with_features(obj, **dict(zip("xyz", state[obj][:3] - way, strict=True)))
    state = state.with_features(THE_DRAWER, opening=opening)
    assert in_drawer(state, (B0, THE_DRAWER)) and not in_drawer(state, (B1, THE_DRAWER))


@pytest.mark.parametrize(
    "change", [{"z": 0.02}, {"y": 0.12}, {"x": -0.14}, {"z": -BUILT.floor}, {"qx": 0.7, "qw": 0.7}]
)
def test_what_does_not_stand_on_the_floor_of_a_drawer_is_not_in_it(change: dict[str, float]) -> None:
    state = furnished.in_tray(furnished.furnished(STACKED, drawer=OPENED), "b0").initial
    assert in_drawer(state, (B0, THE_DRAWER))
    moved = {k: v + (state.get(B0, k)[0] if k in "xyz" else 0.0) for k, v in change.items()}
    if "qx" in change:
        moved |= {"qw": 0.0, "qy": 0.0}
    assert not in_drawer(state.with_features(B0, **moved), (B0, THE_DRAWER))


def test_all_of_a_tower_in_a_drawer_is_inside_and_out_of_reach_of_what_handles_single_blocks() -> None:
    state = furnished.in_tray(furnished.furnished(STACKED, drawer=OPENED), "b0", "b1").initial
    assert not outside(state, (B0,)) and not outside(state, (B1,))
    stacked = furnished.furnished(STACKED).initial
    assert outside(stacked, (B0,)) and outside(stacked, (B1,))
    by_name = {o.name: o for o in DOMAIN.operators}
    for step in (("Pick", (R, B1)), ("Insert", (R, B0, B1)), ("PickTower", (R, B1, B0))):
        needs = by_name[step[0]].ground(step[1]).preconditions
        assert {a for a in needs if a.predicate.name == "Outside"} - GIVEN.true_atoms(state), step
        assert not {a for a in needs if a.predicate.name == "Outside"} - GIVEN.true_atoms(stacked), step


def holding(state: State, block: object, opening: float) -> State:
    x, y, z = state.get(block, "x", "y", "z")  # type: ignore[arg-type]
    return state.with_features(R, x=x, y=y, z=z, opening=opening)


def test_a_held_tower_is_held_below_and_seated_above() -> None:
    state = furnished.furnished(STACKED).initial
    held = holding(state, B0, scenes.WIDTH)
    assert holding_tower(held, (R, B1, B0)) and not holding_tower(held, (R, B0, B1))
    assert not holding_tower(holding(state, B1, scenes.WIDTH), (R, B1, B0))
    assert not holding_tower(held.with_features(B1, z=held.get(B1, "z")[0] + 0.02), (R, B1, B0))


@pytest.mark.parametrize(("up", "held"), [(0.0, True), (0.02, True), (0.04, False)])
def test_what_is_left_of_a_tower_in_the_hand_is_held(up: float, held: bool) -> None:
    """The pads closed on the lower block, which slipped out: they hold the upper one by its lower end."""
    state = furnished.furnished(STACKED).initial
    tower = holding(state, B0, scenes.WIDTH)
    assert in_hand(tower, (R, B0)) and not in_hand(tower, (R, B1))
    # B0 stays where it is, hand and B1 are a tower's height above it.
    bottom = tower.get(B1, "z")[0] - scenes.HEIGHT / 2
    lifted = tower.with_features(R, z=bottom + 0.15 - up - 1e-4).with_features(B1, z=tower.get(B1, "z")[0] + 0.15)
    assert bool(in_hand(lifted, (R, B1))) is held and not in_hand(lifted, (R, B0))
    assert bool(hand_empty(lifted, (R,))) is not held


def test_a_hand_that_holds_a_knob_is_not_empty() -> None:
    state = furnished.furnished(STACKED).initial
    x, y, z = state.get(THE_LID, "x", "y", "z")
    held = state.with_features(R, x=x, y=y, z=z + 0.02, opening=PLATE.knob[0])
    assert not hand_empty(held, (R,))
    assert hand_empty(held.with_features(R, opening=0.06), (R,)) and hand_empty(held.with_features(R, z=z + 0.2), (R,))


PLANS = {
    "l0": "RemoveLid Pick Insert OpenDrawer PickTower PlaceTower CloseDrawer",
    "l3": "RemoveLid Pick Insert PickTower PlaceTower CloseDrawer",
    "l4": "Pick Insert OpenDrawer PickTower PlaceTower CloseDrawer",
    "l5": "RemoveLid Pick Insert Pick Insert OpenDrawer PickTower PlaceTower CloseDrawer",
}


@pytest.mark.parametrize("name", sorted(PLANS))
def test_the_given_model_plans_what_a_person_would_do_without_the_corner(name: str) -> None:
    for seed in range(3):
        task = DOMAIN.scenario(name).sample(np.random.default_rng(seed), seed)
        found = plan(DOMAIN.operators, task.objects, GIVEN.true_atoms(task.initial), task.goal)
        assert sorted(step.name for step in found.steps) == sorted(PLANS[name].split())


def test_from_every_stage_of_the_way_a_plan_leads_on() -> None:
    """Of a drawer that is ajar, a tower in the hand, and a tower that stands in an open drawer."""
    lid_off_scene = furnished.furnished(STACKED, drawer=OPENED)
    goal = DOMAIN.scenario("l1").goal(DOMAIN)
    ajar = furnished.furnished({"b0": (0.0, 0.0), "b1": (0.1, 0.1)}, drawer=furnished.drawer_features(0.05))
    for state, first in (
        (holding(lid_off_scene.initial, B0, scenes.WIDTH), "PlaceTower"),
        (furnished.in_tray(lid_off_scene, "b0", "b1").initial, "CloseDrawer"),
        (ajar.initial, None),
    ):
        steps = [s.name for s in plan(DOMAIN.operators, state.objects, GIVEN.true_atoms(state), goal).steps]
        assert steps[-1] == "CloseDrawer" and (first is None or steps[0] == first)
