"""Steps cost by the success that experience shows; the cheapest plan is found."""

from __future__ import annotations

import heapq
import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core.errors import PlanningError
from resync_robot.core.symbols import Atoms, Operator, Predicate, Variable
from resync_robot.core.vocabulary import BLOCK
from resync_robot.planning.abstract import Exists, ForAll
from resync_robot.planning.outcome_costs import WORTH_A_STEP, CostSettings, JitteredCosts, OutcomeCosts, Tally
from resync_robot.planning.search import ground_all, plan
from tests.planning.kitchen import CLEAN, CUP, FILL, FULL, OPEN, UNLID, WIPE, A, B, X
from tests.planning.models import B1, BLOCKS, BOX_0, HOLDING, INSERT, ON, PICK, RECOVER, ROBOT_0, scene

COVERED = Predicate("Covered", (BLOCK,))
STACKING = (PICK, RECOVER, replace(INSERT, add=INSERT.add | {COVERED(B1)}))
TOWERS_FALL = OutcomeCosts({"Pick": [Tally(COVERED, (1,), (18, 20), (97, 98))]})
GOAL = frozenset({ON(BLOCKS[1], BLOCKS[0]), ON(BLOCKS[2], BLOCKS[1])})
POUR = Operator("Pour", (X,), frozenset({OPEN(X)}), frozenset({FULL(X)}))
"""As `FILL`, and it may be tried with a cup that is not clean."""
FULL_A = frozenset({FULL(A)})


def picked(found) -> list[str]:
    return [s.objects[1].name for s in found.steps if s.name == "Pick"]


def test_a_tower_is_built_from_below_where_lifting_one_failed_more_often() -> None:
    objects, atoms = scene(3, {0})
    found = plan(STACKING, objects, atoms, GOAL, costs=TOWERS_FALL)
    assert picked(found) == ["b1", "b2"]
    # Where it never failed and is what was practised, the tower is lifted.
    other = OutcomeCosts({"Pick": [Tally(COVERED, (1,), (98, 98), (5, 9))]})
    assert picked(plan(STACKING, objects, atoms, GOAL, costs=other)) == ["b2", "b1"]


@pytest.mark.parametrize(("won", "steps"), [(5, ["Wipe", "Pour"]), (19, ["Pour"])])
def test_a_further_step_is_taken_where_it_saves_more_risk_than_it_costs(won: int, steps: list[str]) -> None:
    costs = OutcomeCosts({"Pour": [Tally(CLEAN, (0,), (20, 20), (won, 20))]})
    found = plan((POUR, WIPE), (A, B), frozenset({OPEN(A)}), FULL_A, costs=costs)
    assert [s.name for s in found.steps] == steps
    assert len(plan((POUR, WIPE), (A, B), frozenset({OPEN(A)}), FULL_A).steps) == 1, "the shortest without counts"


def test_success_is_estimated_from_counts_and_a_prior() -> None:
    pour = POUR.ground((A,))
    assert OutcomeCosts({}).success(pour, {CLEAN(A)}) == pytest.approx(0.9)
    one = OutcomeCosts({"Pour": [Tally(CLEAN, (0,), (98, 100), (0, 0))]})
    expected = 0.95 * (98 + 5 * 0.9) / (100 + 5)
    assert one.success(pour, {CLEAN(A)}) == pytest.approx((98 + 10 * expected) / (100 + 10))
    assert one.success(pour, set()) == pytest.approx(expected), "never tried, and so a little riskier"
    clean, full = Tally(CLEAN, (0,), (90, 100), (0, 0)), Tally(FULL, (0,), (5, 10), (85, 90))
    both = OutcomeCosts({"Pour": [clean, full]})
    assert both.atoms(pour) == [CLEAN(A), FULL(A)]
    expected = 0.95 * (90 + 4.5) / 105
    assert both.success(pour, {CLEAN(A), FULL(A)}) == pytest.approx((5 + 10 * expected) / (10 + 10)), "full is worse"
    clean_only = (90 + 10 * expected) / (100 + 10)
    assert both.success(pour, {CLEAN(A)}) == pytest.approx(clean_only), "clean is worse than empty"
    assert both.success(pour, {FULL(A)}) == both.success(pour, {CLEAN(A), FULL(A)})
    free = OutcomeCosts({"Pour": [clean, full]}, CostSettings(step=0.0))
    assert free.cost(pour, {CLEAN(A), FULL(A)}) == pytest.approx(-math.log((5 + 10 * expected) / 20))


def test_what_nobody_tried_with_a_full_hand_is_done_before_the_hand_is_full() -> None:
    holds = Exists(HOLDING, (1,))
    objects, atoms = scene(2, {0, 1})
    empty_handed = OutcomeCosts({"Recover": [Tally(holds.predicate, (0,), (0, 0), (50, 50), holds)]})
    anytime = replace(RECOVER, preconditions=frozenset())
    found = plan((PICK, anytime, INSERT), objects, atoms, frozenset({ON(BLOCKS[1], BLOCKS[0])}), costs=empty_handed)
    assert [s.name for s in found.steps] == ["Recover", "Recover", "Pick", "Insert"]
    holding = {HOLDING(ROBOT_0, BLOCKS[1])}
    recover = anytime.ground((ROBOT_0, BLOCKS[0], BOX_0))
    empty, full = (empty_handed.success(recover, empty_handed.circumstances(a, objects)) for a in (set(), holding))
    assert full < empty
    assert empty_handed.circumstances(holding, objects) == {*holding, holds.predicate(ROBOT_0)}


def test_what_nobody_tried_with_two_things_together_is_tried_last() -> None:
    """Both cups could be wiped to make all well; only a cup beside the other was ever wiped."""
    beside, well = Predicate("Beside", (CUP, CUP)), Predicate("AllWell", ())
    y = Variable("?y", CUP)
    wipe = Operator("WipeBeside", (X, y), frozenset(), frozenset({well()}))
    costs = OutcomeCosts({"WipeBeside": [Tally(beside, (1, 0), (50, 50), (0, 0))]})
    for atom, wiped in ((beside(B, A), (A, B)), (beside(A, B), (B, A))):
        found = plan((wipe,), (A, B), frozenset({atom}), frozenset({well()}), costs=costs)
        assert [s.objects for s in found.steps] == [wiped]


def test_what_bars_one_thing_may_be_in_the_way_to_another() -> None:
    """All cups are wiped before the first is filled, where that failed beside a dirty one."""
    all_clean = ForAll(CLEAN, (0,))
    costs = OutcomeCosts({"Fill": [Tally(all_clean.predicate, (), (40, 40), (20, 30), all_clean)]})
    goal = frozenset({FULL(A), FULL(B)})
    open_ = frozenset({OPEN(A), OPEN(B), CLEAN(A)})
    assert [s.name for s in plan((FILL, WIPE), (A, B), open_, goal, costs=costs).steps] == ["Wipe", "Fill", "Fill"]
    assert all_clean.predicate() in costs.circumstances({CLEAN(A), CLEAN(B)}, (A, B))
    assert all_clean.predicate() not in costs.circumstances({CLEAN(A)}, (A, B))
    assert all_clean.predicate() in costs.circumstances(set(), ()), "all of none"


def test_out_of_reach_is_told_as_without_costs() -> None:
    objects, atoms = scene(2, {0})
    with pytest.raises(PlanningError, match=r"no plan reaches On\(b1, b0\)"):
        plan([PICK, RECOVER], objects, atoms, frozenset({ON(BLOCKS[1], BLOCKS[0])}), costs=TOWERS_FALL)


DRAIN = Operator("Drain", (X,), frozenset({FULL(X)}), frozenset({CLEAN(X)}), frozenset({FULL(X), OPEN(X)}))
KITCHEN = (UNLID, FILL, WIPE, POUR, DRAIN)
COUNTS = st.tuples(st.integers(0, 20), st.integers(0, 20)).map(lambda c: (c[0], c[0] + c[1]))
TALLIES = st.builds(Tally, st.sampled_from([OPEN, FULL, CLEAN]), st.just((0,)), COUNTS, COUNTS)


@given(
    st.fixed_dictionaries({o.name: st.lists(TALLIES, max_size=2) for o in KITCHEN}),
    st.sets(st.sampled_from([OPEN(A), CLEAN(A), FULL(B)])),
    st.sampled_from([FULL_A, frozenset({FULL(A), FULL(B)}), frozenset({CLEAN(B)})]),
    st.sampled_from(["lmcut", "hmax", "blind"]),
)
@settings(max_examples=40, deadline=None)
def test_no_plan_is_cheaper(tallies, atoms, goal, heuristic: str) -> None:
    costs = OutcomeCosts(tallies)
    found = plan(KITCHEN, (A, B), frozenset(atoms), goal, heuristic, costs=costs)
    now, total = frozenset(atoms), 0.0
    for step in found.steps:
        assert step.applicable(now) and costs.least(step) <= costs.cost(step, now) + 1e-12
        total += costs.cost(step, now)
        now = step.apply(now)
    least, steps = cheapest(frozenset(atoms), goal, costs)
    # What saves hardly anything of a step is not brought about for its own sake.
    assert goal <= now and least - 1e-4 <= total <= least + steps * WORTH_A_STEP * CostSettings().step + 1e-4


def cheapest(atoms: Atoms, goal: Atoms, costs: OutcomeCosts) -> tuple[float, int]:
    """Cost and steps of a cheapest plan, by Dijkstra's algorithm, over the states themselves."""
    ground, queue, best, pushed = ground_all(KITCHEN, (A, B)), [(0.0, 0, atoms)], {atoms: 0.0}, 0
    lengths = {atoms: 0}
    while queue:
        total, _, state = heapq.heappop(queue)
        if goal <= state:
            return total, lengths[state]
        for step in (s for s in ground if s.applicable(state)):
            after, cost = step.apply(state), total + costs.cost(step, state)
            if cost < best.get(after, math.inf):
                best[after], lengths[after], pushed = cost, lengths[state] + 1, pushed + 1
                heapq.heappush(queue, (cost, pushed, after))
    return math.inf, 0


def test_what_failed_just_now_is_not_begun_with_where_something_else_is_as_good() -> None:
    goal = frozenset({FULL(A), FULL(B)})
    atoms = frozenset({OPEN(A), OPEN(B), CLEAN(A), CLEAN(B)})
    usual = plan((FILL,), (A, B), atoms, goal).steps
    other = plan((FILL,), (A, B), atoms, goal, failed={str(usual[0]): 1}).steps
    assert other == usual[::-1]
    # Relying on something is no step.
    likely = {CLEAN(B): 0.9}
    relying = plan((FILL,), (A, B), atoms - {CLEAN(B)}, goal, likely=likely, failed={str(usual[0]): 1}).steps
    assert relying == usual[::-1]
    # Not at the price of a further step.
    alone = plan((FILL, WIPE), (A, B), atoms, frozenset({FULL(A)}), failed={"Fill(a)": 1})
    assert [str(s) for s in alone.steps] == ["Fill(a)"]


def test_what_failed_is_done_after_what_changes_its_circumstances() -> None:
    """Filling a dirty cup mostly works, and wiping one that is full works better than wiping an empty one."""
    tallies = {
        "Fill": [Tally(CLEAN, (0,), (20, 20), (16, 20))],
        "Wipe": [Tally(FULL, (0,), (20, 20), (15, 20))],
    }
    operators, goal = (replace(FILL, preconditions=frozenset()), WIPE), frozenset({FULL(A), CLEAN(A)})

    def steps(failed: dict[str, int]) -> list[str]:
        return [
            str(s) for s in plan(operators, (A, B), frozenset(), goal, costs=OutcomeCosts(tallies), failed=failed).steps
        ]

    assert steps({}) == ["Fill(a)", "Wipe(a)"]
    assert steps({"Fill(a)": 2}) == ["Wipe(a)", "Fill(a)"]
    # Another cup has nothing to do with it.
    assert steps({"Fill(b)": 2}) == ["Fill(a)", "Wipe(a)"]


def test_jitter_takes_another_of_plans_as_good_and_no_worse_one() -> None:
    goal, atoms = frozenset({FULL(A), FULL(B)}), frozenset({OPEN(A), OPEN(B), CLEAN(A), CLEAN(B)})
    first = {
        plan((FILL,), (A, B), atoms, goal, costs=JitteredCosts(OutcomeCosts(), seed)).steps[0] for seed in range(20)
    }
    assert len(first) == 2
    risky = OutcomeCosts({"Pour": [Tally(CLEAN, (0,), (20, 20), (5, 20))]})
    for seed in range(20):
        found = plan((POUR, WIPE), (A, B), frozenset({OPEN(A)}), FULL_A, costs=JitteredCosts(risky, seed))
        assert [s.name for s in found.steps] == ["Wipe", "Pour"]


@pytest.mark.parametrize("failed", [{}, {"Pour(a)": 1}])
def test_a_step_that_failed_is_not_put_off_for_a_detour_that_changes_what_holds_of_all(failed: dict[str, int]) -> None:
    """That all cups are clean is worth less than wiping the other one, and no circumstance of pouring this one."""
    all_clean = ForAll(CLEAN, (0,))
    costs = OutcomeCosts({"Pour": [Tally(all_clean.predicate, (), (90, 100), (80, 100), all_clean)]})
    found = plan((POUR, WIPE), (A, B), frozenset({OPEN(A), CLEAN(A)}), FULL_A, costs=costs, failed=failed)
    assert [str(s) for s in found.steps] == ["Pour(a)"]
