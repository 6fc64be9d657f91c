"""What we write as PDDL, solved by another planner."""

from __future__ import annotations

from pathlib import Path

import pytest

import resync_robot
from resync_robot.core.symbols import Atoms, Object
from resync_robot.core.vocabulary import TYPES
from resync_robot.planning.pddl import domain_from_pddl, domain_to_pddl, object_names, problem_to_pddl
from resync_robot.planning.search import plan
from tests.planning.models import BLOCKS, HOLDING, ON, OPERATORS, PREDICATES, ROBOT_0, scene
from tests.planning.other_planner import solve


@pytest.mark.parametrize(
    "goal",
    [
        frozenset({ON(BLOCKS[1], BLOCKS[0])}),
        frozenset({ON(BLOCKS[1], BLOCKS[0]), ON(BLOCKS[2], BLOCKS[1])}),
        frozenset({HOLDING(ROBOT_0, BLOCKS[0])}),
    ],
)
def test_another_planner_finds_a_plan_as_short_by_the_same_names(goal: Atoms, tmp_path: Path) -> None:
    objects, atoms = scene(3, {0, 1})
    # Here the robot is called 'robot' and the box 'box', as their types are.
    found = _solve(tmp_path, OPERATORS, PREDICATES, objects, atoms, goal)
    assert len(found) == len(plan(OPERATORS, objects, atoms, goal).steps)
    operators, named = {o.name.lower(): o for o in OPERATORS}, _by_name(objects)
    for name, *of in found:
        step = operators[name].ground([named[o] for o in of])
        assert step.applicable(atoms)
        atoms = step.apply(atoms)
    assert goal <= atoms


def test_the_shipped_domain_is_one_that_another_planner_reads(tmp_path: Path) -> None:
    shipped = Path(resync_robot.__file__).parent / "shipped" / "cornered-insertion-s"
    text = (shipped / "domain.pddl").read_text(encoding="utf-8")
    predicates, operators = domain_from_pddl(text, TYPES)
    p = {x.name: x for x in predicates}
    objects, _ = scene(2, set())
    b0, b1 = BLOCKS[:2]
    bare = p["not-On-exists-block0"]
    atoms = frozenset({p["HandEmpty"](ROBOT_0), bare(b0), bare(b1), p["ReadyPick"](b1)})
    found = _solve(tmp_path, operators, predicates, objects, atoms, frozenset({p["On"](b1, b0)}))
    assert found == [("recover", "robot0", "b0", "box0"), ("pick", "robot0", "b1"), ("insert", "robot0", "b1", "b0")]


def _by_name(objects: list[Object]) -> dict[str, Object]:
    return {name: o for o, name in object_names(objects, TYPES.values(), PREDICATES, OPERATORS).items()}


def _solve(folder: Path, operators, predicates, objects, atoms: Atoms, goal: Atoms) -> list[tuple[str, ...]]:
    domain, problem = folder / "domain.pddl", folder / "problem.pddl"
    names = object_names(objects, TYPES.values(), predicates, operators)
    domain.write_text(domain_to_pddl("insertion", TYPES.values(), predicates, operators))
    problem.write_text(problem_to_pddl("p", "insertion", names, atoms, goal))
    return solve(domain, problem)
