"""Cornered Insertion-L as a domain: what it declares, what a person would do, and where physics fails its model."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core.domain_faults import faults
from resync_robot.core.rig import load_rig
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.execute import EpisodeResult, ExecuteSettings, Model, plan_and_execute
from resync_robot.planning.pddl import domain_to_pddl
from resync_robot.policies.given_skills import given_skills
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.domains.cornered_insertion_l.domain import expert
from resync_robot.sim_training.domains.cornered_insertion_s.domain import ON
from resync_robot.sim_training.physics.world import SimWorld
from tests import furnished_scenes as furnished
from tests import scenes
from tests.furnished_scenes import THE_DRAWER
from tests.libraries import DOMAIN
from tests.scenes import B0, B1, THE_BOX

FURNISHED = find_domain("cornered-insertion-l")
GIVEN = Abstraction(FURNISHED.predicates, FURNISHED.classifiers)


def sample(name: str, seed: int) -> Task:
    return FURNISHED.scenario(name).sample(np.random.default_rng(seed), seed)


def attempt(task: Task) -> tuple[SimWorld, EpisodeResult]:
    skills = {s.name: s for s in given_skills(load_rig(), FURNISHED.operators)}
    world = SimWorld(task, load_rig())
    assert world.reset(task.initial)
    model = Model(skills, GIVEN, FURNISHED.operators)
    return world, plan_and_execute(world, model, task.goal, ExecuteSettings(max_failures=1))


def test_its_parts_fit_and_can_be_written_for_other_planners() -> None:
    assert list(faults(FURNISHED)) == []
    text = domain_to_pddl(FURNISHED.name, FURNISHED.types, FURNISHED.predicates, FURNISHED.operators)
    assert "(LidOff)" in text
    assert list(FURNISHED.scenarios) == [f"l{i}" for i in range(7)]
    assert [s.name for s in FURNISHED.scenarios.values() if s.training] == ["l0"]


def test_its_recovery_is_that_of_the_smaller_domain() -> None:
    """Blocks, boxes and corners are the same, so a skill that was learned there is one here."""
    small = find_domain(DOMAIN)
    assert FURNISHED.stages[0].recovery == small.stages[0].recovery
    assert set(small.types) < set(FURNISHED.types) and set(small.predicates) < set(FURNISHED.predicates)
    assert FURNISHED.relations == small.relations


@pytest.mark.parametrize("name", list(FURNISHED.scenarios))
def test_nothing_of_the_goal_holds_to_begin_with_but_that_the_drawer_is_closed(name: str) -> None:
    for seed in range(5):
        task = sample(name, seed)
        atoms = GIVEN.true_atoms(task.initial)
        assert {a.predicate.name for a in task.goal & atoms} == (set() if name == "l3" else {"DrawerClosed"})
        assert FURNISHED.predicate("HandEmpty")(scenes.R) in atoms


def steps(task: Task) -> list[str]:
    return [f"{skill}({', '.join(o.name for o in objects[1:])})" for skill, objects in expert(task.initial, task.goal)]


def test_a_person_uncovers_frees_builds_and_puts_away() -> None:
    last = ["OpenDrawer(drawer)", "PickTower(b0, b1)", "PlaceTower(b0, b1, drawer)", "CloseDrawer(drawer)"]
    build = ["Recover(b0, box)", "Pick(b0)", "Insert(b0, b1)"]
    assert steps(sample("l0", 3)) == ["RemoveLid(lid)", *build, *last]
    assert steps(sample("l3", 3)) == ["RemoveLid(lid)", *build, *last[1:]]
    assert steps(sample("l4", 3)) == [*build, *last]
    assert steps(sample("l2", 3))[:3] == ["RemoveLid(lid)", "Recover(b1, box)", "Recover(b0, box)"]
    assert steps(sample("l5", 3))[-3] == "PickTower(b1, b0)"


def test_a_person_does_not_repeat_what_is_done() -> None:
    task = furnished.in_tray(
        furnished.furnished({"b0": (0, 0), "b1": (0, 0)}, drawer=furnished.drawer_features(0.17)), "b0", "b1"
    )
    goal = FURNISHED.scenario("l1").goal(FURNISHED)
    assert [skill for skill, _ in expert(task.initial, goal)] == ["CloseDrawer"]
    away = -0.17 * np.array([np.cos(np.pi), 0.0])
    state = task.initial.with_features(THE_DRAWER, opening=0.0, x=task.initial.get(THE_DRAWER, "x")[0] + away[0])
    for block in state.of_type(BLOCK):
        state = state.with_features(block, x=state.get(block, "x")[0] + away[0])
    assert expert(state, goal) == ()


@pytest.mark.parametrize("seed", [0, 1])
def test_the_given_model_fails_at_the_cornered_block_by_physics(seed: int) -> None:
    world, result = attempt(sample("l0", seed))
    assert not result.success and "Pick(r, b0)" in result.reason and "blocked" in result.reason
    assert [t.skill for t in result.transitions] == ["RemoveLid", "Pick"]
    assert scenes.in_box(world.perceive(), B0)[1] < 0.01, "it is as cornered as before"
    assert THE_BOX in world.task.objects


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_where_nothing_obstructs_the_given_model_puts_the_tower_away(seed: int) -> None:
    task = FURNISHED.free(np.random.default_rng(seed), seed, {BLOCK: 2})  # type: ignore[misc]
    _, result = attempt(task)
    assert result.success, result.reason


def test_practice_has_one_thing_in_the_way_and_that_is_no_lid_and_no_drawer() -> None:
    assert FURNISHED.practice is not None
    built = 0
    for seed in range(40):
        state = FURNISHED.practice(np.random.default_rng(seed), seed).initial
        atoms = GIVEN.true_atoms(state)
        names = {a.predicate.name for a in atoms}
        inside = {b for b in state.of_type(BLOCK) if scenes.in_box(state, b)[0] > -0.01}
        assert {"LidOff", "DrawerOpen"} <= names
        if ON(B0, B1) in atoms:
            built += 1
            assert inside == {B0, B1}
        else:
            assert len(inside) + ("On" in names) == 1
    assert 2 <= built <= 16, "so that PickTower is tried beside a corner"
