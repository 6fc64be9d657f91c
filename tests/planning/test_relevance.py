"""What a search need not look at: other blocks, what holds already, and what makes nothing cheaper."""

from __future__ import annotations

import pytest

from resync_robot.core.symbols import Atom, GroundOperator, Operator, Predicate, Type, Variable
from resync_robot.planning.abstract import Exists, ForAll
from resync_robot.planning.outcome_costs import Count, OutcomeCosts, Tally
from resync_robot.planning.relevance import relevant
from resync_robot.planning.search import ground_all, plan

CUP = Type("cup", ("x",))
X = Variable("?x", CUP)
CLEAN, FULL, LIT = Predicate("Clean", (CUP,)), Predicate("Full", (CUP,)), Predicate("Lit", ())
WIPE = Operator("Wipe", (X,), frozenset(), frozenset({CLEAN(X)}))
FILL = Operator("Fill", (X,), frozenset({CLEAN(X)}), frozenset({FULL(X)}))
LIGHT = Operator("Light", (), frozenset(), frozenset({LIT()}))
SPILL = Operator("Spill", (X,), frozenset(), frozenset(), frozenset({FULL(X)}))
CUPS = tuple(CUP(f"c{i}") for i in range(6))
GOAL = frozenset({FULL(CUPS[0])})
ALL_CLEAN = ForAll(CLEAN, (0,))
SOME_FULL = Exists(FULL, (0,))
GOOD, POOR = (40, 40), (2, 40)


def kept(operators: list[Operator], atoms: set[Atom], costs: OutcomeCosts | None = None) -> set[str]:
    ground: list[GroundOperator] = ground_all(operators, CUPS)
    return {str(op) for op in relevant(ground, frozenset(atoms), GOAL, costs or OutcomeCosts(), CUPS)}


def fills(predicate: Predicate, held: Count, otherwise: Count, form: ForAll | Exists | None = None) -> OutcomeCosts:
    return OutcomeCosts({"Fill": [Tally(predicate, (), held, otherwise, form)]})


def test_other_objects_are_left_out() -> None:
    assert kept([WIPE, FILL, LIGHT, SPILL], set()) == {"Wipe(c0)", "Fill(c0)"}


def test_what_holds_and_is_not_undone_need_not_be_achieved() -> None:
    assert kept([WIPE, FILL], {CLEAN(CUPS[0])}) == {"Fill(c0)"}
    dirties = Operator("Fill", (X,), FILL.preconditions, FILL.add, frozenset({CLEAN(X)}))
    assert kept([WIPE, dirties], {CLEAN(CUPS[0])}) == {"Fill(c0)", "Wipe(c0)"}


@pytest.mark.parametrize(("dark", "lights"), [(POOR, True), (GOOD, False), ((39, 40), False)])
def test_what_makes_a_step_cheaper_is_kept_where_it_saves_enough(dark: Count, lights: bool) -> None:
    """In the light 40 of 40 attempts succeed."""
    assert ("Light()" in kept([WIPE, FILL, LIGHT], set(), fills(LIT, GOOD, dark))) == lights


def test_what_all_objects_decide_keeps_those_that_are_missing() -> None:
    costs = fills(ALL_CLEAN.predicate, GOOD, POOR, ALL_CLEAN)
    clean = {CLEAN(c) for c in CUPS[2:]}
    assert kept([WIPE, FILL], clean, costs) == {"Wipe(c0)", "Wipe(c1)", "Fill(c0)"}
    found = plan([WIPE, FILL], CUPS, frozenset(clean), GOAL, costs=costs)
    assert {str(s) for s in found.steps} == {"Wipe(c0)", "Wipe(c1)", "Fill(c0)"}


def test_what_had_better_end_is_ended_where_it_can_hold() -> None:
    costs = fills(SOME_FULL.predicate, POOR, GOOD, SOME_FULL)
    # The goal's own cup is filled by an operator that was kept, so it may be spilt again.
    assert kept([WIPE, FILL, SPILL], {FULL(CUPS[3])}, costs) == {"Wipe(c0)", "Fill(c0)", "Spill(c0)", "Spill(c3)"}


def test_what_the_preconditions_decide_is_not_brought_about() -> None:
    some_clean = Exists(CLEAN, (0,))
    costs = fills(some_clean.predicate, GOOD, POOR, some_clean)
    assert kept([WIPE, FILL], set(), costs) == {"Wipe(c0)", "Fill(c0)"}
