"""LM-cut (Helmert and Domshlak 2009): what a plan costs at least, by sets of operators of which any plan needs one.

pyperplan has one, too: it knows no costs, and keeps of one state what belongs to another.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import dataclass, field

from pyperplan.search.searchspace import SearchNode
from pyperplan.task import Task

INFINITY = float("inf")
Landmark = tuple[frozenset[int], int]
"""Operators of which any plan needs one, and what is charged for it."""


class LmCut:
    """The heuristic of one task; never more than the cheapest plan costs, and the same for the same input.

    A landmark of one state is one of the next as well, unless the step between them is one of its operators: the
    next state begins with what is left of them (Pommerening and Helmert 2013).

    Args:
        task: with whole numbers for facts, and at least one precondition for each operator.
        costs: whole numbers above 0, by the name of an operator; left out: 1 each.
    """

    def __init__(self, task: Task, costs: Mapping[int, int] | None = None) -> None:
        given = costs or {}
        self._goal = max(task.facts, default=0) + 1
        self._needs = [sorted(op.preconditions) for op in task.operators] + [sorted(task.goals)]
        self._count = [len(needs) for needs in self._needs]
        self._makes = [sorted(op.add_effects) for op in task.operators] + [[self._goal]]
        self._costs = [given.get(op.name, 1) for op in task.operators] + [0]
        self._number = {op.name: i for i, op in enumerate(task.operators)}
        self._needed_by: list[list[int]] = [[] for _ in range(self._goal + 1)]
        self._made_by: list[list[int]] = [[] for _ in range(self._goal + 1)]
        for op, (needs, makes) in enumerate(zip(self._needs, self._makes, strict=True)):
            for fact in needs:
                self._needed_by[fact].append(op)
            for fact in makes:
                self._made_by[fact].append(op)
        self._landmarks: dict[frozenset[int], list[Landmark]] = {}

    def __call__(self, node: SearchNode) -> float:
        """Least cost from the state of `node` to the goal; infinite where no plan is left."""
        found, costs = self._still_needed(node), list(self._costs)
        for cut, cost in found:
            for op in cut:
                costs[op] -= cost
        while True:
            reached = self._reach(node.state, costs)
            if reached.value[self._goal] == INFINITY:
                return INFINITY
            if reached.value[self._goal] == 0:
                break
            cut = self._cut(node.state, self._plateau(reached, costs))
            cost = min(costs[op] for op in cut)
            for op in cut:
                costs[op] -= cost
            found.append((cut, cost))
        self._landmarks[node.state] = found
        return sum(cost for _, cost in found)

    def at_least(self, node: SearchNode) -> float:
        """The same, or less, at no price: by the landmarks of the state before alone."""
        return sum(cost for _, cost in self._still_needed(node))

    def _still_needed(self, node: SearchNode) -> list[Landmark]:
        if node.parent is None:
            return []
        taken = self._number[node.action.name]
        return [landmark for landmark in self._landmarks.get(node.parent.state, ()) if taken not in landmark[0]]

    def _reach(self, state: frozenset[int], costs: list[int]) -> _Reached:
        """h-max: each fact costs what its cheapest operator does, on top of its dearest precondition. Where the goal
        costs nothing, nobody asks for more."""
        found = _Reached([INFINITY] * (self._goal + 1), [-1] * len(costs))
        cost_of, dearest, unmet = found.value, found.dearest, self._count.copy()
        queue: list[tuple[float, int]] = []
        # What costs nothing needs no order, and is most of all that is looked at.
        free = sorted(state)
        for fact in free:
            cost_of[fact] = 0.0
        for fact in free:
            for op in self._needed_by[fact]:
                unmet[op] -= 1
                if unmet[op]:
                    continue
                dearest[op] = fact
                cost = float(costs[op])
                for made in self._makes[op]:
                    if cost < cost_of[made]:
                        cost_of[made] = cost
                        if cost:
                            heapq.heappush(queue, (cost, made))
                        else:
                            free.append(made)
            if cost_of[self._goal] == 0:
                return found
        while queue:
            value, fact = heapq.heappop(queue)
            if value > cost_of[fact]:
                continue
            for op in self._needed_by[fact]:
                unmet[op] -= 1
                if unmet[op]:
                    continue
                dearest[op] = fact
                then = value + costs[op]
                for made in self._makes[op]:
                    if then < cost_of[made]:
                        cost_of[made] = then
                        heapq.heappush(queue, (then, made))
        return found

    def _plateau(self, reached: _Reached, costs: list[int]) -> set[int]:
        """The facts from which the goal costs nothing more."""
        plateau, facts = {self._goal}, [self._goal]
        while facts:
            for op in self._made_by[facts.pop()]:
                fact = reached.dearest[op]
                if costs[op] == 0 and fact >= 0 and fact not in plateau:
                    plateau.add(fact)
                    facts.append(fact)
        return plateau

    def _cut(self, state: frozenset[int], plateau: set[int]) -> frozenset[int]:
        """The operators that lead into the plateau from what is reached without it."""
        unmet = self._count.copy()
        seen, facts, cut = set(state), list(state), set[int]()
        while facts:
            for op in self._needed_by[facts.pop()]:
                unmet[op] -= 1
                if unmet[op]:
                    continue
                if not plateau.isdisjoint(self._makes[op]):
                    cut.add(op)
                for fact in self._makes[op]:
                    if fact not in seen and fact not in plateau:
                        seen.add(fact)
                        facts.append(fact)
        return frozenset(cut)


@dataclass(frozen=True)
class _Reached:
    """What each fact costs, and the dearest precondition of each operator; -1 where it cannot be applied."""

    value: list[float] = field(default_factory=list)
    dearest: list[int] = field(default_factory=list)
