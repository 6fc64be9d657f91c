"""Grounding and lifting mirror each other; what is ill-typed cannot be built."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core.errors import PlanningError
from resync_robot.core.symbols import Operator, Predicate, Type, Variable, distinct_products

BLOCK, ROBOT = Type("block", ("x",)), Type("robot", ("x",))
ON, HOLDING, CLEAR = Predicate("On", (BLOCK, BLOCK)), Predicate("Holding", (ROBOT, BLOCK)), Predicate("Clear", (BLOCK,))
R, TOP, BASE = Variable("?r", ROBOT), Variable("?top", BLOCK), Variable("?base", BLOCK)
ROBOT0, B0, B1 = ROBOT("robot"), BLOCK("b0"), BLOCK("b1")

INSERT = Operator(
    "Insert",
    (R, TOP, BASE),
    preconditions=frozenset({HOLDING(R, TOP), CLEAR(BASE)}),
    add=frozenset({ON(TOP, BASE)}),
    delete=frozenset({HOLDING(R, TOP), CLEAR(BASE)}),
)

LIFTED_ATOMS = (ON(TOP, BASE), ON(BASE, TOP), HOLDING(R, TOP), HOLDING(R, BASE), CLEAR(TOP), CLEAR(BASE))
atom_sets = st.frozensets(st.sampled_from(LIFTED_ATOMS))


@given(atom_sets, atom_sets, atom_sets)
def test_lift_undoes_ground(preconditions: frozenset, add: frozenset, delete: frozenset) -> None:
    operator = Operator("Move", (R, TOP, BASE), preconditions, add, delete)
    assert operator.ground((ROBOT0, B0, B1)).lift() == operator


def test_ground_binds_the_parameters_in_order() -> None:
    ground = INSERT.ground((ROBOT0, B1, B0))
    assert ground.preconditions == {HOLDING(ROBOT0, B1), CLEAR(B0)}
    assert ground.add == {ON(B1, B0)}
    assert str(ground) == "Insert(robot, b1, b0)"


def test_apply_deletes_before_it_adds() -> None:
    both = Operator("Renew", (TOP,), add=frozenset({CLEAR(TOP)}), delete=frozenset({CLEAR(TOP)}))
    assert both.ground((B0,)).apply(frozenset({CLEAR(B0)})) == {CLEAR(B0)}


def test_an_operator_applies_where_its_preconditions_hold() -> None:
    ground = INSERT.ground((ROBOT0, B1, B0))
    atoms = frozenset({HOLDING(ROBOT0, B1), CLEAR(B0), CLEAR(B1)})
    assert ground.applicable(atoms)
    assert not ground.applicable(atoms - {CLEAR(B0)})
    assert ground.apply(atoms) == {ON(B1, B0), CLEAR(B1)}


@pytest.mark.parametrize("arguments", [(), (B0,), (B0, B1, B0), (ROBOT0, B0), (B0, R)])
def test_an_ill_typed_atom_is_refused(arguments: tuple) -> None:
    with pytest.raises(PlanningError, match=r"On\(.*ill-typed: it takes \(block, block\)"):
        ON(*arguments)


@pytest.mark.parametrize("objects", [(), (ROBOT0, B0), (B0, B1, ROBOT0), (ROBOT0, B0, B1, B1)])
def test_an_ill_typed_grounding_is_refused(objects: tuple) -> None:
    with pytest.raises(PlanningError, match="ill-typed"):
        INSERT.ground(objects)


def test_an_operator_may_use_its_parameters_only() -> None:
    with pytest.raises(PlanningError, match=r"\?base.*not among its parameters"):
        Operator("Drop", (TOP,), add=frozenset({ON(TOP, BASE)}))


def test_a_variable_starts_with_a_question_mark() -> None:
    with pytest.raises(PlanningError, match="'top' must start with"):
        Variable("top", BLOCK)


def test_groundings_are_well_typed_distinct_and_ordered() -> None:
    assert ON.groundings([B1, ROBOT0, B0]) == [ON(B0, B1), ON(B1, B0)]
    assert HOLDING.groundings([B1, ROBOT0, B0]) == [HOLDING(ROBOT0, B0), HOLDING(ROBOT0, B1)]


@given(st.integers(0, 4), st.integers(0, 4))
def test_distinct_products_count_the_arrangements(objects: int, places: int) -> None:
    pool = [BLOCK(f"b{i}") for i in range(objects)]
    tuples = distinct_products([pool] * places)
    expected = 1
    for k in range(places):
        expected *= max(objects - k, 0)
    assert len(tuples) == len(set(tuples)) == expected
