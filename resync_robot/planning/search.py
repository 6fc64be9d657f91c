"""From atoms to a plan: A* over the grounded operators, with pyperplan's search and heuristics.

pyperplan's task is built directly from our ground operators, so no PDDL text is written or parsed on the way.
Facts are numbered: sets of small integers iterate in one order, whatever the hash seed, and so do the plans.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from pyperplan.heuristics.blind import BlindHeuristic
from pyperplan.heuristics.lm_cut import LmCutHeuristic
from pyperplan.heuristics.relaxation import hFFHeuristic, hMaxHeuristic
from pyperplan.search.a_star import astar_search
from pyperplan.search.searchspace import SearchNode, make_child_node, make_root_node
from pyperplan.task import Operator as PyperplanOperator
from pyperplan.task import Task

from resync_robot.core.errors import PlanningError, UnknownNameError
from resync_robot.core.symbols import Atom, Atoms, GroundOperator, Object, Operator, distinct_products
from resync_robot.planning.risk import Risk

INFINITY = float("inf")


@dataclass(frozen=True)
class Plan:
    """Ground operators in order, and what finding them cost.

    Attributes:
        nodes_created: search nodes whose heuristic was computed until this plan was found.
        seconds: grounding included.
        atoms: what was taken to hold when it was made.
    """

    steps: tuple[GroundOperator, ...]
    nodes_created: int
    seconds: float
    atoms: Atoms

    def reaches(self, goal: Atoms) -> bool:
        """Whether its operators, as they are, lead from its atoms to the goal; not so where a step supposes more."""
        now = self.atoms
        for step in self.steps:
            if not step.applicable(now):
                return False
            now = step.apply(now)
        return goal <= now

    def __str__(self) -> str:
        return ", ".join(map(str, self.steps)) or "(nothing to do)"


class _LmCut(LmCutHeuristic):  # type: ignore[misc]
    """LM-cut in a fixed order; pyperplan's own formats a log line for every operator of every cut."""

    def find_cut(self, state: Any) -> list[Any]:
        return sorted(super().find_cut(state), key=lambda op: op.name)

    def __call__(self, node: SearchNode) -> float:
        goal = self.relaxed_facts[self.explicit_goal]
        self.dead_end = True
        self.compute_hmax(node.state, True)
        if goal.hmax_value == INFINITY:
            return INFINITY
        value = 0.0
        while goal.hmax_value != 0:
            self.goal_plateau.clear()
            self.compute_goal_plateau(self.explicit_goal)
            cut = self.find_cut(node.state)
            cost = min(op.cost for op in cut)
            value += cost
            for op in cut:
                op.cost -= cost
            self.compute_hmax_from_last_cut(node.state, cut)
        return INFINITY if self.dead_end else value


HEURISTICS: dict[str, Callable[[Task], Callable[[SearchNode], float]]] = {
    "lmcut": _LmCut,
    "hmax": hMaxHeuristic,
    "hff": hFFHeuristic,
    "blind": BlindHeuristic,
}
"""The first two and the last never overestimate, so plans are shortest; hFF is faster and may not be."""


class _TooManyNodes(Exception):
    pass


def plan(
    operators: Iterable[Operator],
    objects: Iterable[Object],
    atoms: Atoms,
    goal: Atoms,
    heuristic: str = "lmcut",
    max_nodes: int = 50_000,
    risk: Risk | None = None,
) -> Plan:
    """The first plan that A* finds; always the same one for the same input.

    Args:
        risk: given one, of the shortest plans the one whose steps bear the least in sum (with a heuristic that never
            overestimates).

    Raises:
        PlanningError: no plan reaches the goal, or none was found within `max_nodes`.
        UnknownNameError: the heuristic does not exist.
    """
    start = time.perf_counter()
    problem = _Problem(operators, objects, atoms, goal, risk=risk)
    estimate = problem.heuristic(heuristic)
    created = 0

    def counted(node: SearchNode) -> float:
        nonlocal created
        if created >= max_nodes:
            raise _TooManyNodes
        created += 1
        return estimate(node)

    try:
        found = _surest(problem, _remembered(counted)) if risk else astar_search(problem.task, counted)
    except _TooManyNodes:
        raise PlanningError(f"no plan for {_words(goal)} within {max_nodes} search nodes") from None
    if found is None:
        raise PlanningError(f"no plan reaches {_words(goal)}{problem.why_not()}")
    return Plan(problem.steps(found), created, time.perf_counter() - start, atoms)


def _remembered(estimate: Callable[[SearchNode], float]) -> Callable[[SearchNode], float]:
    """The same heuristic, computed once for each state."""
    values: dict[frozenset[int], float] = {}

    def h(node: SearchNode) -> float:
        if node.state not in values:
            values[node.state] = estimate(node)
        return values[node.state]

    return h


def _surest(problem: _Problem, h: Callable[[SearchNode], float]) -> list[Any] | None:
    """A* on (steps, risk), compared in this order; the heuristic speaks of steps only."""
    root = make_root_node(problem.task.initial_state)
    best = {root.state: (0, 0.0)}
    queue = [(h(root), 0.0, h(root), 0, root)] if h(root) < INFINITY else []
    pushed = 0
    while queue:
        _, borne, _, _, node = heapq.heappop(queue)
        if best[node.state] < (node.g, borne):
            continue
        if problem.task.goal_reached(node.state):
            steps: list[Any] = node.extract_solution()
            return steps
        for op, state in problem.task.get_successor_states(node.state):
            child = make_child_node(node, op, state)
            cost = child.g, borne + problem.risk_of(op, node.state)
            if (state not in best or cost < best[state]) and h(child) < INFINITY:
                best[state] = cost
                pushed += 1
                heapq.heappush(queue, (child.g + h(child), cost[1], h(child), pushed, child))
    return None


def plans(
    operators: Iterable[Operator],
    objects: Iterable[Object],
    atoms: Atoms,
    goal: Atoms,
    count: int,
    heuristic: str = "lmcut",
    max_nodes: int = 2_000,
) -> tuple[Plan, ...]:
    """Up to `count` different plans in the order A* meets them, fewer where there are no more within `max_nodes`.

    Unlike the first plan, later ones may hold steps that change nothing, such as a failure on purpose. Each carries
    the nodes created since the search began. A state is expanded at most `count` times: a plan that needs it once
    more has `count` plans before it already, so the search also ends where the goal is out of reach.
    """
    start = time.perf_counter()
    problem = _Problem(operators, objects, atoms, goal, keep_useless=True)
    h = _remembered(problem.heuristic(heuristic))
    root = make_root_node(problem.task.initial_state)
    created = 1
    queue: list[tuple[float, float, int, SearchNode]] = []
    if h(root) < INFINITY:
        queue.append((h(root), 0.0, created, root))
    expanded: dict[frozenset[int], int] = {}
    found: list[Plan] = []
    while queue and len(found) < count and created < max_nodes:
        _, _, _, node = heapq.heappop(queue)
        if expanded.get(node.state, 0) >= count:
            continue
        expanded[node.state] = expanded.get(node.state, 0) + 1
        if problem.task.goal_reached(node.state):
            steps = problem.steps(node.extract_solution())
            found.append(Plan(steps, created, time.perf_counter() - start, atoms))
            continue
        for op, state in problem.task.get_successor_states(node.state):
            child = make_child_node(node, op, state)
            created += 1
            if (value := h(child)) < INFINITY:
                heapq.heappush(queue, (child.g + value, value, created, child))
    return tuple(found)


def ground_all(operators: Iterable[Operator], objects: Iterable[Object]) -> list[GroundOperator]:
    """Every well-typed grounding with distinct objects, sorted by name and objects."""
    pool = sorted(objects)
    return [
        op.ground(args)
        for op in sorted(operators, key=lambda o: o.name)
        for args in distinct_products([[o for o in pool if o.type == v.type] for v in op.parameters])
    ]


class _Problem:
    """A pyperplan task with numbered facts. Only facts that a precondition, the goal or a risk asks for are kept."""

    def __init__(
        self,
        operators: Iterable[Operator],
        objects: Iterable[Object],
        atoms: Atoms,
        goal: Atoms,
        keep_useless: bool = False,
        risk: Risk | None = None,
    ) -> None:
        if not goal:
            raise PlanningError("the goal is empty: there is nothing to plan for")
        self.goal, self.atoms, self._risk = goal, atoms, risk
        self.ground = ground_all(operators, objects)
        self._asked = sorted(
            goal.union(*(op.preconditions for op in self.ground), *(risk.atoms(op) for op in self.ground if risk))
        )
        number = {atom: i for i, atom in enumerate(self._asked, start=1)}

        def facts(of: Iterable[Atom]) -> frozenset[int]:
            return frozenset(sorted(number[a] for a in of if a in number))

        # Fact 0 always holds and stands for "no precondition": pyperplan's own stand-in is a string.
        self.task = Task(
            "task",
            frozenset(range(len(self._asked) + 1)),
            facts(atoms) | {0},
            facts(goal),
            [
                PyperplanOperator(i, facts(op.preconditions) or {0}, facts(op.add), facts(op.delete))
                for i, op in enumerate(self.ground)
                if keep_useless or op.add & number.keys()
            ],
        )

    def heuristic(self, name: str) -> Callable[[SearchNode], float]:
        if name not in HEURISTICS:
            raise UnknownNameError("heuristic", name, list(HEURISTICS))
        return HEURISTICS[name](self.task)

    def risk_of(self, op: PyperplanOperator, state: frozenset[int]) -> float:
        """What the step bears where `state` holds; 0 without a risk."""
        if self._risk is None:
            return 0.0
        return self._risk.of(self.ground[op.name], {self._asked[i - 1] for i in state if i})

    def steps(self, found: Sequence[Any]) -> tuple[GroundOperator, ...]:
        return tuple(self.ground[op.name] for op in found)

    def why_not(self) -> str:
        reachable = self.atoms.union(*(op.add for op in self.ground))
        missing = self.goal - reachable
        return f": nothing achieves {_words(missing)}" if missing else " from the atoms that hold now"


def _words(atoms: Atoms) -> str:
    return ", ".join(str(a) for a in sorted(atoms))
