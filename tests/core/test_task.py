"""Goals as text."""

from dataclasses import fields, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core.errors import PlanningError, ResyncError, UnknownNameError
from resync_robot.core.symbols import Object, Predicate
from resync_robot.core.task import Domain, Scenario, parse_atoms
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT, TYPES

ON, IN, EMPTY = Predicate("On", (BLOCK, BLOCK)), Predicate("In", (BLOCK, BOX)), Predicate("HandEmpty", (ROBOT,))
PREDICATES = (ON, IN, EMPTY)
B0, B1, CRATE, ARM = BLOCK("b0"), BLOCK("b1"), BOX("box"), ROBOT("robot")
OBJECTS = (B0, B1, CRATE, ARM)
# Names are all that is looked up here; what a domain can do besides is left out.
DOMAIN = Domain(
    **{
        **dict.fromkeys((f.name for f in fields(Domain)), None),
        "name": "test",
        "types": tuple(TYPES.values()),
        "predicates": PREDICATES,
        "scenarios": {},
        "stacking": (ON,),
    }
)
ATOMS = [a for p in PREDICATES for a in p.groundings(OBJECTS)]


@given(st.lists(st.sampled_from(ATOMS), min_size=1), st.sampled_from([", ", ",", " ", "; ", " & "]))
def test_what_atoms_print_can_be_read_back(atoms: list, separator: str) -> None:
    assert parse_atoms(separator.join(map(str, atoms)), PREDICATES, OBJECTS) == frozenset(atoms)


def test_predicates_are_case_insensitive_and_blanks_do_not_matter() -> None:
    assert DOMAIN.parse_goal("  on( b1 ,b0)", OBJECTS) == {ON(B1, B0)}


@pytest.mark.parametrize("text", ["", "  ", ",", "On b1 b0", "On(b1,b0", "On(b1,b0))", "On(b1,(b0))", "not On(b1,b0)"])
def test_what_is_no_goal_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(PlanningError, match=r'--goal "On\(b1,b0\)"'):
        DOMAIN.parse_goal(text, OBJECTS)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("not On(b1,b0)", "'not' is not understood; a goal lists what shall hold"),
        ("not(On(b1,b0))", "cannot ask that something does not"),
        ("!On(b1,b0)", "'!' is not understood"),
        ("On(b1,b0) and In(b0,box)", "'and' is not understood; atoms stand beside each other, with a comma"),
        ("On(b1,b0) OR In(b0,box)", "'OR' is not understood; a goal leaves no choice"),
        ("(and (on b1 b0))", "'and' is not understood"),
        ("On(b1,b0)\nIn(b0,box)", "it has a line break"),
        ("On(b1,b0)\n", "it has a line break"),
        ("On(b1,b0))", "a parenthesis is too many"),
        ("On(b1,b0), please", "'please' is no atom"),
    ],
)
def test_a_goal_that_cannot_be_read_says_what_stands_in_the_way(text: str, why: str) -> None:
    with pytest.raises(PlanningError) as error:
        DOMAIN.parse_goal(text, OBJECTS)
    assert why in str(error.value) and '--goal "On(b1,b0)' in error.value.fix


BLOCKS = tuple(BLOCK(f"b{i}") for i in range(5))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("On(b0,b0)", "On(b0, b0): it takes different objects"),
        ("On(b0,b1), On(b1,b0)", "On(b0, b1), On(b1, b0): b0 would be upon itself"),
        ("On(b4,b0), On(b0,b1), On(b1,b2), On(b2,b0)", "On(b0, b1), On(b1, b2), On(b2, b0): b0 would be upon itself"),
        ("On(b0,b1), On(b0,b2)", "both On(b0, b1) and On(b0, b2)"),
    ],
)
def test_a_goal_that_no_state_can_meet_is_refused(text: str, why: str) -> None:
    with pytest.raises(PlanningError, match="no state has") as error:
        DOMAIN.parse_goal(text, BLOCKS)
    assert why in str(error.value)


@given(st.permutations(BLOCKS), st.integers(1, 4))
def test_any_tower_is_a_goal(order: list[Object], height: int) -> None:
    atoms = frozenset(ON(order[i], order[i + 1]) for i in range(height))
    assert DOMAIN.parse_goal(", ".join(map(str, atoms)), BLOCKS) == atoms


@given(st.permutations(BLOCKS), st.integers(2, 5), st.integers(0, 4))
def test_a_ring_of_any_size_is_none(order: list[Object], size: int, more: int) -> None:
    ring = [ON(order[i], order[(i + 1) % size]) for i in range(size)]
    tail = [ON(order[i], order[i - 1]) for i in range(size, min(size + more, 5))]
    with pytest.raises(PlanningError, match="upon itself"):
        DOMAIN.parse_goal(", ".join(map(str, ring + tail)), BLOCKS)


def test_an_unknown_predicate_names_the_valid_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown predicate 'Above'(.|\n)*HandEmpty, In, On"):
        DOMAIN.parse_goal("Above(b1,b0)", OBJECTS)


def test_an_unknown_object_names_the_valid_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown object 'b7'(.|\n)*b0, b1, box, robot"):
        DOMAIN.parse_goal("On(b7,b0)", OBJECTS)


@pytest.mark.parametrize("text", ["On(b1)", "On(b1,box)", "In(box,b1)", "On(b0,b1,b0)", "On()"])
def test_an_ill_typed_atom_is_refused(text: str) -> None:
    with pytest.raises(PlanningError, match="ill-typed"):
        DOMAIN.parse_goal(text, OBJECTS)


@given(st.text(max_size=40))
def test_no_text_breaks_the_reader(text: str) -> None:
    try:
        atoms = parse_atoms(text, PREDICATES, OBJECTS)
    except ResyncError:
        return
    assert atoms <= frozenset(ATOMS)


def test_unknown_scenarios_and_predicates_of_a_domain_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="unknown scenario of test 's9'"):
        DOMAIN.scenario("s9")
    with pytest.raises(UnknownNameError, match="unknown predicate 'Above'"):
        DOMAIN.predicate("Above")
    assert DOMAIN.predicate("handempty") is EMPTY


def test_a_scenario_that_says_only_how_it_is_sampled_practises_and_is_tested_on_that() -> None:
    def usual(rng: object, seed: int) -> Any:
        return seed

    def unseen(rng: object, seed: int) -> Any:
        return -seed

    plain = Scenario("a", "", lambda domain: frozenset(), usual)
    assert plain.sample_practice is plain.sample_unseen is usual
    both = Scenario("a", "", lambda domain: frozenset(), usual, sample_unseen=unseen)
    assert (both.sample_practice, both.sample_unseen) == (usual, unseen)


@pytest.mark.parametrize(("training", "first"), [((True, False, False), "b"), ((True, True), "a"), ((False,), "a")])
def test_the_first_test_of_a_domain_is_one_that_nothing_trains_in_if_there_is_any(
    training: tuple[bool, ...], first: str
) -> None:
    scenarios = {
        name: Scenario(name, "", lambda domain: frozenset(), lambda rng, seed: None, training=trains)
        for name, trains in zip("abc", training, strict=False)
    }
    assert replace(DOMAIN, scenarios=scenarios).first_test.name == first
