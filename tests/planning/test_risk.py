"""Of the shortest plans the surest one: no longer than any other, and none as short bears less."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core.errors import PlanningError
from resync_robot.core.symbols import GroundOperator, Predicate
from resync_robot.core.vocabulary import BLOCK
from resync_robot.planning.risk import Risk, Tally
from resync_robot.planning.search import ground_all, plan
from tests.planning.models import B1, BLOCKS, FREE, INSERT, ON, PICK, RECOVER, scene

COVERED = Predicate("Covered", (BLOCK,))
STACKING = (PICK, RECOVER, replace(INSERT, add=INSERT.add | {COVERED(B1)}))
TOWERS_FALL = Risk({"Pick": [Tally(COVERED, 1, (18, 20), (97, 98))]})
GOAL = frozenset({ON(BLOCKS[1], BLOCKS[0]), ON(BLOCKS[2], BLOCKS[1])})


def picked(found) -> list[str]:
    return [s.objects[1].name for s in found.steps if s.name == "Pick"]


def test_a_tower_is_built_from_below_where_lifting_one_failed_more_often() -> None:
    objects, atoms = scene(3, {0})
    found = plan(STACKING, objects, atoms, GOAL, risk=TOWERS_FALL)
    assert picked(found) == ["b1", "b2"]
    # Where it never failed and is what was practised, the tower is lifted.
    other = Risk({"Pick": [Tally(COVERED, 1, (98, 98), (5, 9))]})
    assert picked(plan(STACKING, objects, atoms, GOAL, risk=other)) == ["b2", "b1"]


def test_what_was_never_tried_is_riskier_than_what_seldom_failed() -> None:
    tally = Tally(COVERED, 1, (0, 0), (97, 99))
    assert tally.risk(True) == pytest.approx(math.log(2)) and tally.risk(False) < 0.05
    objects, _ = scene(2, set())
    pick = next(o for o in ground_all([PICK], objects) if o.objects[1] == BLOCKS[1])
    risk = Risk({"Pick": [tally, Tally(FREE, 1, (1, 9), (0, 0))]})
    assert risk.atoms(pick) == [COVERED(BLOCKS[1]), FREE(BLOCKS[1])]
    # The worst that any tally knows of it.
    assert risk.of(pick, {FREE(BLOCKS[1])}) == pytest.approx(-math.log(2 / 11))
    assert Risk({}).of(pick, set()) == 0.0 and not Risk({}) and risk


def test_out_of_reach_is_told_as_without_risk() -> None:
    objects, atoms = scene(2, {0})
    with pytest.raises(PlanningError, match=r"no plan reaches On\(b1, b0\)"):
        plan([PICK, RECOVER], objects, atoms, frozenset({ON(BLOCKS[1], BLOCKS[0])}), risk=TOWERS_FALL)


COUNTS = st.tuples(st.integers(0, 5), st.integers(0, 5)).map(lambda c: (c[0], c[0] + c[1]))
TALLIES = st.builds(Tally, st.sampled_from([COVERED, FREE]), st.just(1), COUNTS, COUNTS)


@given(
    st.fixed_dictionaries({name: st.lists(TALLIES, max_size=2) for name in ("Pick", "Insert", "Recover")}),
    st.sets(st.integers(0, 2)),
    st.sampled_from([GOAL, frozenset({ON(BLOCKS[0], BLOCKS[2])}), frozenset({ON(BLOCKS[1], BLOCKS[0])})]),
    st.sampled_from(["lmcut", "hmax", "blind"]),
)
@settings(max_examples=30, deadline=None)
def test_no_plan_as_short_bears_less(tallies, cornered: set[int], goal, heuristic: str) -> None:
    objects, atoms = scene(3, cornered)
    risk = Risk(tallies)
    found = plan(STACKING, objects, atoms, goal, heuristic, risk=risk)
    length = len(plan(STACKING, objects, atoms, goal, heuristic).steps)
    assert len(found.steps) == length
    ground = ground_all(STACKING, objects)
    layer = {atoms: 0.0}
    for _ in range(length):
        after: dict[frozenset, float] = {}
        for state, op in product(layer, ground):
            if op.applicable(state):
                reached, bears = op.apply(state), layer[state] + risk.of(op, state)
                after[reached] = min(bears, after.get(reached, math.inf))
        layer = after
    assert borne(found.steps, atoms, risk) == pytest.approx(min(r for s, r in layer.items() if goal <= s))


def borne(steps: tuple[GroundOperator, ...], atoms: frozenset, risk: Risk) -> float:
    total = 0.0
    for step in steps:
        total += risk.of(step, atoms)
        atoms = step.apply(atoms)
    return total
