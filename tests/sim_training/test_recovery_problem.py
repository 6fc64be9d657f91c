"""The recovery problem of Cornered Insertion-S: states between failure and freedom, and nothing said of recovered."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.arm_embodiment import arm_stage
from resync_robot.core.relations import seen
from resync_robot.core.rig import load_rig
from resync_robot.core.task import Domain
from resync_robot.core.vocabulary import BLOCK
from resync_robot.curriculum.context import Known
from resync_robot.curriculum.mine import task_of
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.domains.cornered_insertion_s.corner import RELATIONS
from resync_robot.sim_training.failure_mining import Explanation
from resync_robot.sim_training.recovery_problem import Problem, Start, judge_of, pose_problem
from tests.scenes import B0, THE_BOX, R
from tests.sim_training.sliding import COAST_SKILL, JUDGE, ONWARD, P, Rail, S, task_at

DOMAIN = find_domain("cornered-insertion-s")
PUCKS = str(Path(__file__).parents[2] / "docs" / "puck_behind_a_door.py")


@pytest.fixture(scope="module")
def problem() -> Problem:
    context = Known(domain=DOMAIN.spec, rig=load_rig()).open()
    stage = context.stage("Recover")
    tasks = [task_of(DOMAIN, stage, seed) for seed in (1000, 1001, 1002)]
    explanation = Explanation("Pick", (R, B0), B0, (THE_BOX,))
    starts = [Start(task, task.initial) for task in tasks]
    return pose_problem(DOMAIN, context.embodiment, stage, context.model, explanation, starts)


def test_it_is_about_the_robot_the_block_and_the_box(problem: Problem) -> None:
    assert problem.objects == (R, B0, THE_BOX)
    assert str(problem.judge.failed) == "Pick(r, b0)" and {str(a) for a in problem.judge.effects} == {"Holding(r, b0)"}
    for start in problem.starts:
        assert seen(start.state, B0, THE_BOX, RELATIONS)[1] < 0.008


def test_the_domain_says_of_its_stage_nothing_but_where_it_fails() -> None:
    """Neither success nor reward: what recovered means, only Pick says."""
    stage, named = DOMAIN.stages[0], ("recovery", "scenario", "horizon", "interface", "on_device")
    assert replace(arm_stage(stage, load_rig()), interface=None) == stage
    assert {name for name in vars(stage) if name not in named} == set()
    assert not {name for name in vars(Domain) if name in ("success", "reward", "potential", "is_recovered")}


def test_states_between_lie_between_and_most_of_them_near_the_failure(problem: Problem) -> None:
    rng, gaps = np.random.default_rng(0), []
    failed = problem.starts[0]
    free = problem.free(4)
    assert free is not None
    least, most = (seen(s.state, B0, THE_BOX, RELATIONS)[:2] for s in (failed, free))
    for _ in range(200):
        start = problem.between(failed, free, rng)
        gaps.append(seen(start.state, B0, THE_BOX, RELATIONS)[:2])
        others = [o for o in start.state.objects if o != B0]
        assert all((start.state[o] == failed.state[o]).all() for o in others) and start.task is failed.task
    low, high = np.sort(np.stack([least, most]), axis=0)
    assert (np.array(gaps).min(0) > low - 1e-6).all() and (np.array(gaps).max(0) < np.maximum(high, low) + 0.05).all()
    shares = (np.array(gaps)[:, 1] - least[1]) / (most[1] - least[1])
    assert 0.3 < (shares < 0.25).mean() < 0.8


def test_free_states_have_every_object_of_the_problem(problem: Problem) -> None:
    for seed in range(10):
        start = problem.free(seed)
        assert start is not None and set(problem.objects) <= set(start.state.objects)
        assert len(start.state.of_type(BLOCK)) == 2


@pytest.mark.parametrize(("skill", "others"), [("Fetch", ()), ("Bring", ("pad",))])
def test_what_the_failed_skill_needs_is_brought_about_first(skill: str, others: tuple[str, ...]) -> None:
    """In the toy of the guide, with all doors open: a puck has to be held before it can be brought."""
    context = Known(domain=PUCKS, rig=None).open()
    task = context.domain.scenario("open").sample(np.random.default_rng(3), 3)
    there = {o.type.name: o for o in reversed(task.initial.objects)}
    objects = tuple(there[name] for name in ("robot", "puck", *others))
    judge = judge_of(context.domain, context.model, Explanation(skill, objects, objects[1], (there["door"],)))
    simulator = context.embodiment.simulate(task)
    assert simulator.reset(task.initial)
    assert (judge.needs <= context.model.abstraction.true_atoms(simulator.perceive())) == (skill == "Fetch")
    judge.makes_ready(simulator, context.model, task)
    assert judge.needs <= context.model.abstraction.true_atoms(simulator.perceive())


@given(st.floats(0, 1), st.floats(0, 1))
def test_a_verdict_is_about_what_the_end_of_the_recovery_leaves(one: float, other: float) -> None:
    task = task_at(min(one, other), max(one, other))
    rail, moved = Rail(task), Rail(task)
    moved.act(np.array([ONWARD]), 0.1)
    judge = replace(JUDGE, leave=COAST_SKILL.ground((P, S)))
    assert judge(rail, task.initial) == JUDGE(moved, task.initial)  # type: ignore[arg-type]
    np.testing.assert_array_equal(rail.save(), Rail(task).save(), "the simulator is left as it was")


def test_the_arm_is_judged_once_it_has_let_go(problem: Problem) -> None:
    assert str(problem.judge.leave) == "Leave(r, b0, box)"
