"""Goals as text."""

from dataclasses import fields

import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core.errors import PlanningError, ResyncError, UnknownNameError
from resync_robot.core.symbols import Predicate
from resync_robot.core.task import Domain, parse_atoms
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
