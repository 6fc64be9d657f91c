"""Grounding and lifting mirror each other; what is ill-typed cannot be built."""

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core.errors import PlanningError
from resync_robot.core.symbols import ROUND, SE2, SE3, Operator, Predicate, Type, Variable, distinct_products

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


def test_what_is_deleted_of_every_object_goes_of_every_object_but_what_is_added() -> None:
    other = Variable("?any", BLOCK)
    drop = Operator("Drop", (R, TOP), add=frozenset({HOLDING(R, TOP)}), delete_all=frozenset({HOLDING(R, other)}))
    held = frozenset({HOLDING(ROBOT0, B0), HOLDING(ROBOT0, B1), CLEAR(B1)})
    assert drop.ground((ROBOT0, B0), (ROBOT0, B0, B1)).apply(held) == {HOLDING(ROBOT0, B0), CLEAR(B1)}
    assert drop.ground((ROBOT0, B0)).apply(held) == held, "it was not told which objects there are"
    assert drop.ground((ROBOT0, B0), (ROBOT0, B0, B1)).lift() == drop
    with pytest.raises(PlanningError, match="no variable that stands for every object"):
        Operator("Drop", (R, TOP), delete_all=frozenset({HOLDING(R, TOP)}))


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


def test_renaming_there_and_back_leaves_the_operator_as_it_was() -> None:
    other = Predicate("Seated", ON.types)
    renamed = INSERT.renamed({"On": other})
    atoms = renamed.preconditions | renamed.add | renamed.delete
    assert other(TOP, BASE) in renamed.add and ON not in {a.predicate for a in atoms}
    assert renamed != INSERT and renamed.renamed({"Seated": ON}) == INSERT


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


def test_what_a_type_declares_says_what_its_features_mean_and_not_which_type_it_is() -> None:
    plain, declared = Type("car", (*SE2, "w", "h")), Type("car", (*SE2, "w", "h"), pose=SE2, extents=("w", "h"))
    assert plain == declared and hash(plain) == hash(declared) and plain != Type("car", SE2)
    assert (plain.dimensions, declared.dimensions, Type("arm", SE3, pose=SE3).dimensions) == (0, 2, 3)
    again = pickle.loads(pickle.dumps(declared))  # noqa: S301
    assert (again.pose, again.extents, again.symmetry, again.exact) == (SE2, ("w", "h"), 1, False)


@pytest.mark.parametrize(
    ("declared", "why"),
    [
        ({"pose": ("x", "y")}, "has the pose .*declare pose=SE2, SE3 or None"),
        ({"pose": SE3}, "do not begin with its pose.*begin them with x, y, z, qw"),
        ({"pose": SE2, "extents": ("w",)}, r"has the extents \(w\).*one of its features for each axis"),
        ({"pose": SE2, "extents": ("w", "depth")}, r"has the extents \(w, depth\)"),
        ({"extents": ("w", "h")}, r"has the extents \(w, h\)"),
        ({"pose": SE2, "symmetry": -1}, "has the symmetry -1.*declare 1, 2, 4 or ROUND"),
        ({"pose": SE2, "extents": ("w", "h"), "symmetry": 3}, "has the symmetry 3"),
    ],
)
def test_a_type_that_contradicts_itself_is_refused(declared: dict, why: str) -> None:
    with pytest.raises(PlanningError, match=f"(?s){why}"):
        Type("car", (*SE2, "w", "h"), **declared)


@pytest.mark.parametrize(
    "kind",
    [
        Type("nothing"),
        Type("disc", (*SE2, "d"), pose=SE2, extents=("d", "d"), symmetry=ROUND, exact=True),
        Type(
            "block", (*SE3, "x_size", "y_size", "z_size"), pose=SE3, extents=("x_size", "y_size", "z_size"), symmetry=4
        ),
    ],
    ids=lambda kind: kind.name,
)
def test_a_type_comes_back_from_a_file(kind: Type) -> None:
    back = Type.from_json(kind.name, json.loads(json.dumps(kind.to_json())))
    told = ("name", "features", "pose", "extents", "symmetry", "exact")
    assert [getattr(back, n) for n in told] == [getattr(kind, n) for n in told] and back == kind


def test_an_atom_is_the_same_in_another_process() -> None:
    """Where words have other hashes."""
    atoms = frozenset({ON(b, c) for b in (BLOCK("b0"), BLOCK("b1")) for c in (BLOCK("b2"),)})
    code = (
        "import pickle, sys; from tests.core.test_symbols import BLOCK, ON; "
        "print(ON(BLOCK('b1'), BLOCK('b2')) in pickle.loads(sys.stdin.buffer.read()))"
    )
    for seed in ("1", "2"):
        told = subprocess.run(
            [sys.executable, "-c", code],
            input=pickle.dumps(atoms),
            capture_output=True,
            check=True,
            cwd=Path(__file__).parents[2],
            env={**os.environ, "PYTHONHASHSEED": seed},
        )
        assert told.stdout.strip() == b"True"
