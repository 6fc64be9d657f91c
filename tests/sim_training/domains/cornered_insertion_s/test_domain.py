"""Cornered Insertion-S: every scenario begins as it says, and symbols say what is so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.errors import PlanningError, UnknownNameError
from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.task import Domain, Task
from resync_robot.core.vocabulary import BLOCK, BOX
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.pddl import domain_to_pddl
from resync_robot.policies.cartesian import Hand
from resync_robot.sim_training.domains import DOMAINS, EVALUATION_WORLDS, find_domain, world_task
from resync_robot.sim_training.domains.cornered_insertion_s.corner import in_corner
from resync_robot.sim_training.domains.cornered_insertion_s.domain import cover, expert, hand_empty, holding, on
from resync_robot.sim_training.domains.cornered_insertion_s.layouts import CORNER_GAP, FREE_GAP, MIDDLING_GAP
from tests import scenes
from tests.libraries import DOMAIN
from tests.scenes import B0, B1, B2, THE_BOX, R

CORNERED = find_domain(DOMAIN)
RIG = load_rig()
GIVEN = Abstraction(CORNERED.predicates, CORNERED.classifiers)
seeds = st.integers(0, 2**31)
scenario_names = st.sampled_from(sorted(CORNERED.scenarios))

IN_CORNERS = {
    "s0": {"b0"},
    "s1": {"b0"},
    "s2": {"b0", "b1"},
    "s3": {"b0"},
    "s4": set(),
    "s5": {"b2"},
    "s6": set(),
    "s7": {"b0"},
}
"""Names of the cornered blocks, as the descriptions say."""


def sample(name: str, seed: int) -> Task:
    return CORNERED.scenario(name).sample(np.random.default_rng(seed), seed)


def cornered(state: State) -> set[str]:
    """Blocks in the box with both gaps as small as a corner's."""
    gaps = {b.name: scenes.in_box(state, b) for b in state.of_type(BLOCK)}
    return {name for name, g in gaps.items() if g[0] >= 0 and g[1] <= CORNER_GAP[1] + 1e-6}


def tip_is_reached(tip: np.ndarray, yaw: float) -> bool:
    pose = spatial.transform(Hand.rotation(yaw), tip)
    flange = spatial.inverse(RIG.arm.world_T_base) @ pose @ spatial.inverse(RIG.gripper.flange_T_tip)
    return bool(np.all(np.isfinite(RIG.arm.kinematics.inverse(flange, RIG.arm.home))))


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=list(DOMAINS))
def test_a_domain_can_be_written_for_other_planners_and_says_what_its_recovery_does(domain: Domain) -> None:
    assert domain_to_pddl(domain.name, domain.types, domain.predicates, domain.operators)
    assert domain.instruction.endswith(".")


@settings(max_examples=60)
@given(scenario_names, seeds)
def test_a_task_is_well_formed(name: str, seed: int) -> None:
    task = sample(name, seed)
    state, blocks = task.initial, task.initial.of_type(BLOCK)
    assert 2 <= len(blocks) <= 4 and len(state.of_type(BOX)) == 1
    assert task.goal == CORNERED.scenario(name).goal(CORNERED)
    assert {a for atom in task.goal for a in atom.args} <= set(task.objects)
    assert not task.goal & GIVEN.true_atoms(state), "nothing of the goal holds to begin with"
    assert GIVEN.true_atoms(state) == {CORNERED.predicate("HandEmpty")(R)}
    assert set(task.physics["masses"]) == {b.name for b in blocks}
    for i, a in enumerate(blocks):
        size = state.get(a, "size_x", "size_y", "size_z")
        assert np.all((size >= 0.035) & (size <= 0.07))
        for b in blocks[i + 1 :]:
            apart = np.linalg.norm(state.get(a, "x", "y") - state.get(b, "x", "y"))
            assert apart > np.sqrt(2) * 0.07, "blocks do not overlap whatever their yaw"
        place = state.get(a, "x", "y", "z")
        for yaw in (0.0, np.pi / 2):
            for height in (0.0, 0.2):
                assert tip_is_reached(place + [0, 0, height], yaw)


@settings(max_examples=60)
@given(st.sampled_from(sorted(IN_CORNERS)), seeds)
def test_blocks_are_cornered_where_the_scenario_says(name: str, seed: int) -> None:
    assert cornered(sample(name, seed).initial) == IN_CORNERS[name]


@settings(max_examples=60)
@given(scenario_names, seeds)
def test_every_block_stands_in_the_box_or_clear_of_it_and_never_in_a_wall(name: str, seed: int) -> None:
    state = sample(name, seed).initial
    box = state[THE_BOX]
    outer = box[7:9] / 2 + box[10]
    for block in state.of_type(BLOCK):
        local = spatial.inverse(spatial.pose_from_features(box[:7])) @ spatial.pose_from_features(state[block][:7])
        half = state.get(block, "size_x")[0] / 2 * (abs(local[0, 0]) + abs(local[1, 0]))
        place = np.abs(local[:2, 3])
        in_box, beside = np.all(place + half <= box[7:9] / 2), np.any(place - half >= outer)
        assert in_box or beside
        bottom = state.get(block, "z")[0] - state.get(block, "size_z")[0] / 2
        assert bottom == pytest.approx((box[2] if in_box else 0.0) + 0.0005, abs=1e-6)


@settings(max_examples=30)
@given(seeds)
def test_single_walls_and_middling_gaps(seed: int) -> None:
    gaps = {name: [scenes.in_box(sample(name, seed).initial, b) for b in (B0, B1)] for name in ("s5", "s6")}
    walled = [g for g in gaps["s5"] if g[0] >= 0 and g[0] <= CORNER_GAP[1] + 1e-6 and g[1] > 0.03]
    between = [g for g in gaps["s6"] if MIDDLING_GAP[0] - 1e-6 <= g[0] and g[1] <= MIDDLING_GAP[1] + 1e-6]
    assert len(walled) == len(between) == 1


def test_all_four_corners_are_drawn() -> None:
    seen = set()
    for seed in range(40):
        state = sample("s0", seed).initial
        local = spatial.inverse(spatial.pose_from_features(state[THE_BOX][:7])) @ np.append(state[B0][:3], 1.0)
        seen.add((local[0] > 0, local[1] > 0))
    assert len(seen) == 4


@given(scenario_names, seeds)
def test_a_task_depends_on_its_seed_alone(name: str, seed: int) -> None:
    first, again = sample(name, seed), sample(name, seed)
    assert (first.initial, first.physics, first.goal) == (again.initial, again.physics, again.goal)
    assert first.seed == seed


def test_exactly_one_scenario_is_for_training_and_its_failure_is_cornered() -> None:
    assert [s.name for s in CORNERED.scenarios.values() if s.training] == ["s0"]
    assert all(s.description for s in CORNERED.scenarios.values())


@settings(max_examples=25)
@given(seeds, st.floats(0.0, 0.03), st.floats(0.0, 0.03), st.floats(-0.7, 0.7))
def test_relocate_moves_one_block_to_the_relative_pose_and_nothing_else(
    seed: int, gap: float, more: float, angle: float
) -> None:
    task = CORNERED.dream(np.random.default_rng(seed), seed, 2)
    moved = CORNERED.relocate(task, B0, THE_BOX, in_corner(gap, gap + more, angle), np.random.default_rng(seed))
    np.testing.assert_allclose(scenes.in_box(moved.initial, B0)[:2], [gap, gap + more], atol=1e-6)
    for obj in (B1, THE_BOX, R):
        np.testing.assert_array_equal(moved.initial[obj], task.initial[obj])
    assert (moved.goal, moved.physics, moved.seed) == (task.goal, task.physics, task.seed)


@settings(max_examples=25)
@given(seeds, st.integers(2, 3))
def test_dreams_begin_free_and_practice_between_trapped_and_free(seed: int, count: int) -> None:
    dream = CORNERED.dream(np.random.default_rng(seed), seed, count).initial
    assert len(dream.of_type(BLOCK)) == count
    for block in dream.of_type(BLOCK):
        assert scenes.in_box(dream, block)[0] < -0.05, "on the table, far outside of the box"
    practice = CORNERED.practice(np.random.default_rng(seed), seed).initial
    inside = [g for g in (scenes.in_box(practice, b) for b in practice.of_type(BLOCK)) if g[0] > -0.01]
    covered = [a for a in GIVEN.true_atoms(practice) if a.predicate.name == "On"]
    assert len(inside) + len(covered) == 1, "one thing at a time is in the way"
    for gaps in inside:
        assert 0.0005 - 1e-6 <= gaps[0] <= 0.045 + 1e-6 and gaps[1] <= 0.09 + 1e-6


@settings(max_examples=25)
@given(seeds)
def test_a_covered_block_has_another_seated_on_it_and_stays_itself(seed: int) -> None:
    task = CORNERED.dream(np.random.default_rng(seed), seed, 3)
    state = cover(task, B2, B0, np.random.default_rng(seed)).initial
    assert on(state, (B2, B0)) == 1.0
    for obj in (B0, B1, THE_BOX, R):
        np.testing.assert_array_equal(state[obj], task.initial[obj])


def test_a_person_frees_what_is_tight_and_needed_and_builds_from_below() -> None:
    def steps(name: str) -> list[str]:
        task = sample(name, 3)
        return [f"{skill}({', '.join(o.name for o in objects)})" for skill, objects in expert(task.initial, task.goal)]

    assert steps("s1") == ["Recover(r, b0, box)", "Pick(r, b1)", "Insert(r, b1, b0)"]
    assert steps("s2") == ["Recover(r, b1, box)", "Recover(r, b0, box)", "Pick(r, b0)", "Insert(r, b0, b1)"]
    assert steps("s3") == [
        "Recover(r, b0, box)",
        *("Pick(r, b1)", "Insert(r, b1, b0)"),
        *("Pick(r, b2)", "Insert(r, b2, b1)"),
    ]
    for name in ("s4", "s5"):
        assert steps(name) == ["Pick(r, b1)", "Insert(r, b1, b0)"]


def test_a_person_whose_hand_is_full_puts_that_down_first_unless_it_can_be_inserted_at_once() -> None:
    def steps(cornered: float, held: Object) -> list[str]:
        state = scenes.scene({"b0": (cornered, cornered), "b1": (-0.05, -0.05), "b2": (0.05, -0.08)}).initial
        x, y, z = RIG.tip_pose(RIG.arm.home)[:3, 3]
        state = state.with_features(held, x=x, y=y, z=z)
        state = state.with_features(R, x=x, y=y, z=z, opening=scenes.WIDTH)
        given = expert(state, CORNERED.parse_goal("On(b1,b0)", state.objects))
        return [f"{skill}({', '.join(o.name for o in objects)})" for skill, objects in given]

    assert steps(0.0, B1) == ["Insert(r, b1, b0)"]
    assert steps(0.0, B2) == ["Place(r, b2)", "Pick(r, b1)", "Insert(r, b1, b0)"]
    assert steps(scenes.CORNER, B1) == ["Place(r, b1)", "Recover(r, b0, box)", "Pick(r, b1)", "Insert(r, b1, b0)"]


def test_a_scenario_begins_after_given_skills_only_and_the_newest_comes_last() -> None:
    """An evaluation's worlds hang on the position of their scenario."""
    given = {o.name: o for o in CORNERED.operators}
    for scenario in CORNERED.scenarios.values():
        objects = {o.name: o for o in sample(scenario.name, 0).objects}
        for skill, names in scenario.begins_after:
            assert [objects[n].type for n in names] == [v.type for v in given[skill].parameters]
    assert list(CORNERED.scenarios) == [f"s{i}" for i in range(8)]
    assert CORNERED.scenario("s7").begins_after == (("Pick", ("r", "b1")),)


@given(seeds)
def test_free_blocks_leave_room_for_fingers(seed: int) -> None:
    state = sample("s1", seed).initial
    gap = scenes.in_box(state, B1)[0]
    assert gap >= FREE_GAP - 1e-6 or gap < -0.05


# -- given predicates -------------------------------------------------------------------------------------------------

STACKED = scenes.scene(
    {"b0": (0.0, 0.0), "b1": (0.0, 0.0, 0.4, scenes.FLOOR + scenes.HEIGHT), "b2": (0.1, 0.1)}
).initial


@pytest.mark.parametrize(
    ("shift", "holds"),
    [({}, 1.0), ({"z": 0.012}, 0.0), ({"x": 0.015}, 0.0), ({"y": -0.015}, 0.0), ({"z": 0.003, "x": 0.005}, 1.0)],
)
def test_on_means_seated_on_the_stud_and_not_lying_on_it(shift: dict[str, float], holds: float) -> None:
    state = STACKED.with_features(B1, **{k: STACKED.get(B1, k)[0] + v for k, v in shift.items()})
    assert on(state, (B1, B0)) == holds
    assert on(state, (B0, B1)) == 0.0 and on(state, (B2, B0)) == 0.0


@pytest.mark.parametrize(
    ("opening", "offset", "holds"),
    [(0.060, 0.0, 1.0), (0.067, 0.0, 1.0), (0.10, 0.0, 0.0), (0.060, 0.05, 0.0), (0.060, -0.05, 0.0)],
)
def test_holding_means_between_closed_pads(opening: float, offset: float, holds: float) -> None:
    x, y, z = STACKED.get(B2, "x", "y", "z")
    state = STACKED.with_features(R, x=x, y=y, z=z + offset, opening=opening)
    assert holding(state, (R, B2)) == holds
    assert hand_empty(state, (R,)) == 1.0 - holds
    assert holding(state, (R, B0)) == 0.0


# -- names and goals --------------------------------------------------------------------------------------------------


def test_goals_are_read_from_text() -> None:
    b0, b1, b2 = B0, B1, B2
    atom = CORNERED.predicate("On")
    assert CORNERED.parse_goal(" on(b1, b0) ,On(b2,b1);", (R, b0, b1, b2)) == {atom(b1, b0), atom(b2, b1)}


@pytest.mark.parametrize(
    ("text", "kind", "word"),
    [
        ("Under(b1,b0)", UnknownNameError, "predicate 'Under'"),
        ("On(b1,b9)", UnknownNameError, "object 'b9'"),
        ("On(B1,b0)", UnknownNameError, "object 'B1'"),
        ("On(b1)", PlanningError, "ill-typed"),
        ("On(b1,box)", PlanningError, "ill-typed"),
        ("On(b1,b0", PlanningError, "cannot read"),
        ("please stack", PlanningError, "cannot read"),
        ("", PlanningError, "no atom"),
    ],
)
def test_a_goal_that_makes_no_sense_is_explained(text: str, kind: type[Exception], word: str) -> None:
    with pytest.raises(kind, match=word):
        CORNERED.parse_goal(text, (R, THE_BOX, B0, B1))


def test_unknown_domains_and_scenarios_list_the_valid_ones() -> None:
    with pytest.raises(UnknownNameError, match="kitchen") as caught:
        find_domain("kitchen")
    assert DOMAIN in caught.value.fix
    with pytest.raises(UnknownNameError, match="s99") as caught:
        CORNERED.scenario("s99")
    assert "s0, s1" in caught.value.fix
    assert all(name == domain.name for name, domain in DOMAINS.items())


def test_evaluation_draws_other_worlds_than_training() -> None:
    trained = {sample("s0", seed).initial[B0].tobytes() for seed in range(100)}
    tested = {world_task(CORNERED, "s0", s, e).initial[B0].tobytes() for s in range(5) for e in range(20)}
    assert len(tested) == 100 and not trained & tested


def test_the_worlds_of_an_evaluation_hang_on_the_scenario_s_name() -> None:
    """Figures were reported of those of s0 to s7, which were drawn by their position; it may change now."""
    for position, (name, scenario) in enumerate(CORNERED.scenarios.items()):
        rng = np.random.default_rng([EVALUATION_WORLDS, position, 2, 3])
        assert world_task(CORNERED, name, 2, 3).initial == scenario.sample(rng, int(rng.integers(2**31))).initial
    new = replace(CORNERED.scenarios["s4"], name="new")
    more = replace(CORNERED, scenarios={"new": new, **CORNERED.scenarios})
    assert world_task(more, "s4", 2, 3).initial == world_task(CORNERED, "s4", 2, 3).initial
    assert world_task(more, "new", 2, 3).initial != world_task(CORNERED, "s4", 2, 3).initial
    last = replace(CORNERED, scenarios={**CORNERED.scenarios, "new": new})
    assert world_task(more, "new", 2, 3).initial == world_task(last, "new", 2, 3).initial
