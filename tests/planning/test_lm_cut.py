from __future__ import annotations

import heapq
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyperplan.search.searchspace import SearchNode, make_root_node
from pyperplan.task import Operator, Task

from resync_robot.planning.lm_cut import LmCut

FACTS = range(6)
SOME = st.frozensets(st.sampled_from(FACTS), max_size=3)
EFFECTS = st.tuples(SOME.map(lambda of: of | {0}), SOME, SOME, st.integers(1, 9))
"""Preconditions, adds, deletes and the cost of an operator. Fact 0 always holds."""


def make_task(effects, goal=(4, 5)) -> tuple[Task, dict[int, int]]:
    operators = [Operator(i, pre, add, delete - {0}) for i, (pre, add, delete, _) in enumerate(effects)]
    costs = {i: cost for i, (*_, cost) in enumerate(effects)}
    return Task("task", frozenset(FACTS), frozenset({0}), frozenset(goal), operators), costs


def cheapest(task: Task, costs: dict[int, int], state: frozenset[int]) -> float:
    """Cost of a cheapest plan, by Dijkstra's algorithm."""
    queue, best = [(0, sorted(state), state)], {state: 0}
    while queue:
        total, _, state = heapq.heappop(queue)
        if task.goal_reached(state):
            return total
        for op, after in task.get_successor_states(state):
            if total + costs[op.name] < best.get(after, math.inf):
                best[after] = total + costs[op.name]
                heapq.heappush(queue, (best[after], sorted(after), after))
    return math.inf


@given(st.lists(EFFECTS, min_size=1, max_size=7))
@settings(max_examples=200, deadline=None)
def test_it_never_says_more_than_the_cheapest_plan_costs_along_any_path(effects) -> None:
    task, costs = make_task(effects)
    h, node = LmCut(task, costs), make_root_node(task.initial_state)
    for _ in range(4):
        assert 0 <= h(node) <= cheapest(task, costs, node.state)
        assert (h(node) == 0) == task.goal_reached(node.state)
        following = task.get_successor_states(node.state)
        if h(node) == math.inf or not following:
            break
        op, state = following[-1]
        node = SearchNode(state, node, op, node.g + costs[op.name])


@given(st.lists(st.integers(1, 50), min_size=1, max_size=5))
def test_of_one_way_it_says_the_whole_cost_at_every_step(costs) -> None:
    chain = [(frozenset({i}), frozenset({i + 1}), frozenset(), cost) for i, cost in enumerate(costs)]
    task, _ = make_task(chain, goal=(len(costs),))
    h, node = LmCut(task, dict(enumerate(costs))), make_root_node(task.initial_state)
    for i, op in enumerate(task.operators):
        assert h(node) == sum(costs[i:])
        node = SearchNode(op.apply(node.state), node, op, 0)
    assert h(node) == 0


@pytest.mark.parametrize("costs", [None, {}, {0: 7}])
def test_what_has_no_cost_of_its_own_costs_one_and_what_nothing_brings_about_is_out_of_reach(costs) -> None:
    task, _ = make_task([(frozenset({0}), frozenset({4}), frozenset(), 1)], goal=(4,))
    assert LmCut(task, costs)(make_root_node(task.initial_state)) == (costs or {}).get(0, 1)
    task, _ = make_task([(frozenset({0}), frozenset({4}), frozenset(), 1)], goal=(4, 5))
    assert LmCut(task, costs)(make_root_node(task.initial_state)) == math.inf
