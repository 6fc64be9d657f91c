"""The given skills of Blocked Stacking: they stack where nothing is in the way, and fail where something is."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core.skill import SkillEnd
from resync_robot.core.symbols import Type
from resync_robot.core.task import Task
from resync_robot.planning.execute import ExecuteSettings, plan_and_execute
from resync_robot.planning.skill_run import run_skill
from resync_robot.sim_training.domains.blocked_stacking.domain import OBSTRUCTED
from resync_robot.sim_training.domains.blocked_stacking.layouts import BASE, TOP, UNSEEN, USUAL, Layout
from resync_robot.sim_training.domains.blocked_stacking.layouts import ROBOT_NAME as R
from resync_robot.sim_training.domains.blocked_stacking.simulator import Bench
from resync_robot.sim_training.domains.blocked_stacking.vocabulary import CRATE, SLAB, WALL
from resync_robot.sim_training.failure_mining import attempt, explain
from tests.benchmarks.blocked_stacking import BODY, DOMAIN, MODEL, SCRIPTED, failures, recovers


def draw(name: str, seed: int) -> Task:
    return DOMAIN.scenario(name).sample(np.random.default_rng(seed), seed)


@pytest.mark.parametrize("seed", range(4))
def test_where_nothing_is_in_the_way_one_block_comes_upon_the_other(seed: int) -> None:
    task = Layout().draw(np.random.default_rng(seed), seed, UNSEEN if seed % 2 else USUAL)
    result = plan_and_execute(Bench(task), MODEL, task.goal, ExecuteSettings(max_failures=1))
    assert result.success, result.reason
    assert [t.skill for t in result.transitions] == ["ReachToGrasp", "Grasp", "ReachToPlace", "Place"]


@pytest.mark.parametrize("name", sorted(OBSTRUCTED, key=int))
def test_what_is_in_the_way_is_what_the_skill_fails_on(name: str) -> None:
    found = attempt(BODY, draw(name, 7), MODEL)
    assert found is not None
    at_grasp = {kind for kind, host in OBSTRUCTED[name].items() if host == "grasp"}
    assert found.skill == ("ReachToGrasp" if at_grasp else "ReachToPlace")
    assert found.run_into and {o.type for o in found.run_into} <= (at_grasp or set(OBSTRUCTED[name]))
    # A state that learning can begin in.
    assert Bench(found.task).reset(found.state)


@pytest.mark.parametrize(("stage", "culprit"), [(0, SLAB), (1, CRATE), (2, WALL)])
def test_each_stage_has_its_own_culprit(stage: int, culprit: Type) -> None:
    about = explain(DOMAIN, list(failures(DOMAIN.stages[stage].scenario, range(6))))
    assert (about.skill, about.objects) == ("ReachToGrasp", (R, TOP))
    assert about.culprits == (culprit(culprit.name),) and about.projected == (R, TOP, culprit(culprit.name))


@pytest.mark.parametrize("name", SCRIPTED)
def test_each_recovery_can_be_done_within_its_horizon(name: str) -> None:
    scenario, actions = SCRIPTED[name]
    assert len(actions) <= next(s.horizon for s in DOMAIN.stages if s.recovery == name)
    tried = list(failures(scenario, range(4)))
    assert sum(recovers(found, actions) for found in tried) >= 3
    assert not any(recovers(found, []) for found in tried)


def test_what_is_not_held_cannot_be_placed() -> None:
    world = Bench(draw("0", 0))
    assert run_skill(world, MODEL.skill("ReachToPlace").ground((R, TOP, BASE))).ending is SkillEnd.REFUSED


def test_what_was_run_into_before_is_not_the_next_skills_failure() -> None:
    found = next(failures("6", range(9)))
    world = Bench(found.task)
    world.reset(found.state)
    world.act(np.array([0.0, -0.05, 0.0, 0.0, 0.0]), 0.2)
    assert world.observe().run_into
    # It gets away from the crate, and only then comes down on it again.
    outcome = run_skill(world, MODEL.skill("ReachToGrasp").ground((R, TOP)))
    assert outcome.ending is SkillEnd.BLOCKED and world.observe().time > 1.0
    assert CRATE("crate") in world.contacts()
