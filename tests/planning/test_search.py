from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core.errors import PlanningError, UnknownNameError
from resync_robot.core.symbols import Operator
from resync_robot.planning.search import HEURISTICS, plan, plans
from tests.planning.models import BLOCKS, FREE, HAND_EMPTY, HOLDING, ON, OPERATORS, PICK, RECOVER, ROBOT_0, R, scene

TOWER = frozenset({ON(BLOCKS[1], BLOCKS[0]), ON(BLOCKS[2], BLOCKS[1]), ON(BLOCKS[3], BLOCKS[2])})


def names(found) -> list[str]:
    return [str(s) for s in found.steps]


def test_recovers_the_base_before_the_hand_is_full() -> None:
    objects, atoms = scene(2, {0})
    found = plan(OPERATORS, objects, atoms, frozenset({ON(BLOCKS[1], BLOCKS[0])}))
    assert names(found) == ["Recover(robot, b0, box)", "Pick(robot, b1)", "Insert(robot, b1, b0)"]
    assert found.nodes_created >= 4 and found.seconds > 0


@given(st.sets(st.integers(0, 3)), st.sampled_from(["lmcut", "hmax", "hff", "blind"]))
@settings(max_examples=25, deadline=None)
def test_every_plan_is_executable_and_as_short_as_it_can_be(cornered: set[int], heuristic: str) -> None:
    objects, atoms = scene(4, cornered)
    found = plan(OPERATORS, objects, atoms, frozenset({ON(BLOCKS[1], BLOCKS[0]), ON(BLOCKS[3], BLOCKS[2])}), heuristic)
    for step in found.steps:
        assert step.applicable(atoms)
        atoms = step.apply(atoms)
    assert {ON(BLOCKS[1], BLOCKS[0]), ON(BLOCKS[3], BLOCKS[2])} <= atoms
    if heuristic != "hff":
        assert len(found.steps) == 4 + len(cornered)


def test_a_goal_that_holds_needs_nothing() -> None:
    objects, atoms = scene(2, set())
    goal = frozenset({FREE(BLOCKS[0])})
    assert plan(OPERATORS, objects, atoms, goal).steps == ()
    assert [p.steps for p in plans(OPERATORS, objects, atoms, goal, 1)] == [()]


def test_out_of_reach_names_the_goal() -> None:
    objects, atoms = scene(2, {0})
    goal = frozenset({ON(BLOCKS[1], BLOCKS[0])})
    with pytest.raises(PlanningError, match=r"no plan reaches On\(b1, b0\): nothing achieves On\(b1, b0\)"):
        plan([PICK, RECOVER], objects, atoms, goal)
    without_recovery = [op for op in OPERATORS if op.name != "Recover"]
    with pytest.raises(PlanningError, match=r"On\(b1, b0\) from the atoms that hold now"):
        plan(without_recovery, objects, atoms, goal)
    assert plans(without_recovery, objects, atoms, goal, 8) == ()


def test_limits_and_bad_input() -> None:
    objects, atoms = scene(4, {0, 1, 2, 3})
    with pytest.raises(PlanningError, match="within 3 search nodes"):
        plan(OPERATORS, objects, atoms, TOWER, max_nodes=3)
    with pytest.raises(UnknownNameError, match="lmcut"):
        plan(OPERATORS, objects, atoms, TOWER, heuristic="psychic")
    with pytest.raises(PlanningError, match="empty"):
        plan(OPERATORS, objects, atoms, frozenset())


def test_several_plans_differ_and_start_with_the_first() -> None:
    objects, atoms = scene(3, {0, 1})
    goal = frozenset({ON(BLOCKS[1], BLOCKS[0])})
    found = plans(OPERATORS, objects, atoms, goal, 8)
    assert len(found) == 8 and len({p.steps for p in found}) == 8
    assert len(found[0].steps) == len(plan(OPERATORS, objects, atoms, goal).steps)
    assert [p.nodes_created for p in found] == sorted(p.nodes_created for p in found)
    assert [len(p.steps) for p in found] == sorted(len(p.steps) for p in found)


def test_deletes_come_before_adds() -> None:
    # An operator that deletes and adds one atom leaves it true.
    odd = Operator("Odd", RECOVER.parameters, frozenset(), RECOVER.add, RECOVER.add)
    objects, atoms = scene(1, {0})
    assert names(plan([odd], objects, atoms, frozenset({FREE(BLOCKS[0])}))) == ["Odd(robot, b0, box)"]


def test_what_is_only_likely_is_relied_on_where_it_must_be_and_the_likelier_before_the_other() -> None:
    objects, atoms = scene(2, {0, 1})
    goal = frozenset({HOLDING(ROBOT_0, BLOCKS[0])})
    free = {FREE(BLOCKS[0]): 0.6, FREE(BLOCKS[1]): 0.7, HAND_EMPTY(ROBOT_0): 0.9}
    found = plan([PICK], objects, atoms, goal, likely=free)
    assert names(found) == ["Pick(robot, b0)"] and found.relies_on == {FREE(BLOCKS[0])}
    assert found.atoms == atoms | found.relies_on and found.reaches(goal)
    either = Operator("Either", PICK.parameters, frozenset({FREE(PICK.parameters[1])}), frozenset({HAND_EMPTY(R)}))
    unsure = {atom: p for atom, p in free.items() if atom.predicate == FREE}
    found = plan([either], objects, frozenset(), frozenset({HAND_EMPTY(ROBOT_0)}), likely=unsure)
    assert names(found) == ["Either(robot, b1)"] and found.relies_on == {FREE(BLOCKS[1])}


def test_what_a_step_has_ended_is_not_relied_on_any_more() -> None:
    objects, _ = scene(2, set())
    both = frozenset({HOLDING(ROBOT_0, BLOCKS[0]), HOLDING(ROBOT_0, BLOCKS[1])})
    likely = {HAND_EMPTY(ROBOT_0): 0.9, FREE(BLOCKS[0]): 0.9, FREE(BLOCKS[1]): 0.9}
    assert len(plan([PICK], objects, frozenset(), both - {HOLDING(ROBOT_0, BLOCKS[1])}, likely=likely).steps) == 1
    with pytest.raises(PlanningError):
        plan([PICK], objects, frozenset(), both, likely=likely)


PROBE = """
from resync_robot.planning.search import plan, HEURISTICS
from tests.planning.models import *
objects, atoms = scene(4, {0, 1, 2})
goal = frozenset({ON(BLOCKS[1], BLOCKS[0]), ON(BLOCKS[3], BLOCKS[2])})
for h in HEURISTICS:
    found = plan(OPERATORS, objects, atoms, goal, h)
    print(h, found, found.nodes_created)
"""


def test_the_hash_seed_changes_nothing() -> None:
    root = Path(__file__).parents[2]
    said = {
        subprocess.run(
            [sys.executable, "-c", PROBE],
            cwd=root,
            env={"PYTHONHASHSEED": seed, "PYTHONPATH": str(root)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("0", "1", "7")
    }
    assert len(said) == 1 and len(said.pop().splitlines()) == len(HEURISTICS)


def test_planning_is_fast() -> None:
    """p95 of at most 50 ms with four blocks, grounding included."""
    rng = np.random.default_rng(0)
    seconds = []
    for _ in range(40):
        objects, atoms = scene(4, set(np.flatnonzero(rng.random(4) < 0.5).tolist()))
        start = time.process_time()
        plan(OPERATORS, objects, atoms, TOWER)
        seconds.append(time.process_time() - start)
    # Twice the figure promised, because test machines are shared; docs give the measured one.
    assert np.percentile(seconds, 50) < 0.05 and np.percentile(seconds, 95) < 0.1
