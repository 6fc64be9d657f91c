"""From atoms to a plan: A* over the grounded operators by action cost, with pyperplan's heuristics.

pyperplan's task is built directly from our ground operators, so no PDDL text is written or parsed on the way.
Facts are numbered: sets of small integers iterate in one order, whatever the hash seed, and so do the plans.
"""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from pyperplan.heuristics.blind import BlindHeuristic
from pyperplan.heuristics.relaxation import hFFHeuristic, hMaxHeuristic
from pyperplan.search.searchspace import SearchNode, make_child_node, make_root_node
from pyperplan.task import Operator as PyperplanOperator
from pyperplan.task import Task

from resync_robot.core.errors import PlanningError, UnknownNameError
from resync_robot.core.symbols import Atom, Atoms, GroundOperator, Object, Operator, distinct_products
from resync_robot.planning.lm_cut import INFINITY, LmCut
from resync_robot.planning.outcome_costs import OutcomeCosts
from resync_robot.planning.relevance import relevant

AGAIN = 0.09
"""Cost of beginning with a step that failed just now, less than that of any further step: of plans as good as each
other one is taken that does something else first, which may change what that step failed of."""
ALIKE = 2.0
"""How many attempts the usual success of a step counts for, against those that just failed."""
COST_UNIT = 1e-6
"""Costs are whole numbers of this in a search, so that sums are exact and equal costs are equal."""


@dataclass(frozen=True)
class Plan:
    """Ground operators in order, and what finding them cost.

    Attributes:
        nodes_created: search nodes whose heuristic was computed until this plan was found.
        seconds: grounding included.
        atoms: what was taken to hold when it was made.
        relies_on: those of `atoms` that are only likely.
    """

    steps: tuple[GroundOperator, ...]
    nodes_created: int
    seconds: float
    atoms: Atoms
    relies_on: Atoms = frozenset()

    def reaches(self, goal: Atoms) -> bool:
        """Whether its operators, as they are, lead from its atoms to the goal; not so where a step supposes more."""
        return _lead(self.steps, self.atoms, goal)

    def goes_without(self, index: int, atoms: Atoms, goal: Atoms) -> bool:
        """Whether a step is needless where `atoms` hold: what it brings about is there, the rest reaches the goal."""
        return self.steps[index].add <= atoms and _lead(self.steps[index + 1 :], atoms, goal)

    def lacks(self, index: int, atoms: Atoms) -> tuple[GroundOperator, Atoms] | None:
        """The first step, from that of `index` on, that cannot be run where `atoms` hold, and what is not there for it;
        None where each can, as far as the operators tell."""
        for step in self.steps[index:]:
            if missing := step.preconditions - atoms:
                return step, missing
            atoms = step.apply(atoms)
        return None

    def __str__(self) -> str:
        return ", ".join(map(str, self.steps)) or "(nothing to do)"


def _lead(steps: Iterable[GroundOperator], atoms: Atoms, goal: Atoms) -> bool:
    for step in steps:
        if not step.applicable(atoms):
            return False
        atoms = step.apply(atoms)
    return goal <= atoms


HEURISTICS: dict[str, Callable[[Task], Callable[[SearchNode], float]]] = {
    "lmcut": LmCut,
    "hmax": hMaxHeuristic,
    "hff": hFFHeuristic,
    "blind": BlindHeuristic,
}
"""The first two and the last never overestimate, so plans are cheapest; hFF is faster, and its plans may not be."""


class _TooManyNodes(Exception):
    pass


def plan(
    operators: Iterable[Operator],
    objects: Iterable[Object],
    atoms: Atoms,
    goal: Atoms,
    heuristic: str = "lmcut",
    max_nodes: int = 50_000,
    costs: OutcomeCosts | None = None,
    likely: Mapping[Atom, float] | None = None,
    failed: Mapping[str, int] | None = None,
) -> Plan:
    """The cheapest plan, by A* (with a heuristic that never overestimates), up to `WORTH_A_STEP`; always the same one
    for the same input.

    Args:
        costs: of the steps. Without them, or without counts in them, the plan is a shortest one.
        likely: further atoms with their probabilities p. The plan may rely on them from its start, at -log p for each.
        failed: ground steps, in words, and how often each has just failed. In the same circumstances it will again, the
            more likely the more often: attempts at one thing are not independent of each other.

    Raises:
        PlanningError: no plan reaches the goal, or none was found within `max_nodes`.
        UnknownNameError: the heuristic does not exist.
    """
    start = time.perf_counter()
    problem = _Problem(operators, objects, atoms, goal, costs=costs, likely=likely, failed=failed)
    estimate = problem.cost_to_go(heuristic)
    at_least = estimate.at_least if isinstance(estimate, LmCut) else None
    created = 0

    def counted(node: SearchNode) -> float:
        nonlocal created
        if created >= max_nodes:
            raise _TooManyNodes
        created += 1
        return estimate(node)

    try:
        found = _cheapest(problem, _remembered(counted), at_least)
    except _TooManyNodes:
        raise PlanningError(f"no plan for {_words(goal)} within {max_nodes} search nodes") from None
    if found is None:
        raise PlanningError(f"no plan reaches {_words(goal)}{problem.why_not()}")
    relied = problem.relied_on(found)
    return Plan(problem.steps(found), created, time.perf_counter() - start, atoms | relied, relied)


def _cheapest(
    problem: _Problem, h: Callable[[SearchNode], float], at_least: Callable[[SearchNode], float] | None = None
) -> list[Any] | None:
    """A*. The heuristic says what the rest costs at least.

    Args:
        at_least: never more than `h`, and cheaper: a node is queued by it, and asks for `h` when its turn comes.
    """
    root = make_root_node(problem.task.initial_state)
    best = {root.state: 0}
    queue = [(0.0, 0.0, 0, root)] if h(root) < INFINITY else []
    pushed = 0
    while queue:
        _, guessed, number, node = heapq.heappop(queue)
        if node.g > best[node.state]:
            continue
        if at_least is not None and (left := h(node)) > guessed and node is not root:
            if left < INFINITY:
                heapq.heappush(queue, (node.g + left, left, number, node))
            continue
        if problem.task.goal_reached(node.state):
            operators: list[Any] = node.extract_solution()
            return operators
        holding = problem.circumstances(node.state)
        for op, state in problem.task.get_successor_states(node.state):
            child = SearchNode(state, node, op, node.g + problem.cost(op, holding) + problem.extra(op, node, holding))
            if child.g >= best.get(state, INFINITY) or (left := (at_least or h)(child)) == INFINITY:
                continue
            best[state] = child.g
            pushed += 1
            heapq.heappush(queue, (child.g + left, left, pushed, child))
    return None


def _remembered(estimate: Callable[[SearchNode], float]) -> Callable[[SearchNode], float]:
    """The same heuristic, computed once for each state."""
    values: dict[frozenset[int], float] = {}

    def h(node: SearchNode) -> float:
        if node.state not in values:
            values[node.state] = estimate(node)
        return values[node.state]

    return h


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
    return list(_ground_all(tuple(sorted(operators, key=lambda o: o.name)), tuple(sorted(objects))))


@lru_cache(maxsize=8)
def _ground_all(operators: tuple[Operator, ...], pool: tuple[Object, ...]) -> tuple[GroundOperator, ...]:
    # An episode plans again and again with the same operators and objects.
    return tuple(
        op.ground(args, pool)
        for op in operators
        for args in distinct_products([[o for o in pool if o.type == v.type] for v in op.parameters])
    )


class _Problem:
    """A pyperplan task with numbered facts. Only facts that a precondition, the goal or a cost asks for are kept.

    An atom that is only likely is brought about by an operator of its own, which is no step of the plan, and which can
    be used until the first step is.
    """

    def __init__(
        self,
        operators: Iterable[Operator],
        objects: Iterable[Object],
        atoms: Atoms,
        goal: Atoms,
        keep_useless: bool = False,
        costs: OutcomeCosts | None = None,
        likely: Mapping[Atom, float] | None = None,
        failed: Mapping[str, int] | None = None,
    ) -> None:
        if not goal:
            raise PlanningError("the goal is empty: there is nothing to plan for")
        self.goal, self.atoms, self._costs = goal, atoms, costs or OutcomeCosts()
        self._objects = tuple(objects)
        self.ground = ground_all(operators, self._objects)
        if not keep_useless:
            self.ground = relevant(self.ground, atoms, goal, self._costs, self._objects)
        changed = atoms.union(*(op.add for op in self.ground)) if self._costs.bases else frozenset()
        self._asked = sorted(
            goal.union(
                *(op.preconditions for op in self.ground),
                *(self._costs.atoms(op) for op in self.ground),
                (a for a in changed if a.predicate in self._costs.bases),
            )
        )
        number = {atom: i for i, atom in enumerate(self._asked, start=1)}
        self._derived = [
            (number[atom], frozenset(number[b] for b in bases if b in number), needed)
            for atom, bases, needed in self._costs.derived(self._asked, self._objects)
            if atom in number
        ]
        self._hangs = [frozenset(number[a] for a in self._costs.atoms(op)) for op in self.ground]
        self._known_costs: dict[tuple[int, frozenset[int]], int] = {}
        self._likely = [(a, p) for a, p in sorted((likely or {}).items()) if a in number and a not in atoms]

        def facts(of: Iterable[Atom]) -> frozenset[int]:
            return frozenset(sorted(number[a] for a in of if a in number))

        # Fact 0 always holds and stands for "no precondition": pyperplan's own stand-in is a string. The last one holds
        # until the first step, where there is anything to rely on.
        self._first = first = frozenset({len(self._asked) + 1}) if self._likely else frozenset()
        self._failed = {i: failed[str(op)] for i, op in enumerate(self.ground) if str(op) in failed} if failed else {}
        begun = self._costs.circumstances(atoms, self._objects)
        self._then = {i: self._costs.about_things(self.ground[i], begun) for i in self._failed}
        steps = [
            PyperplanOperator(i, facts(op.preconditions) or {0}, facts(op.add), facts(op.delete | op.swept) | first)
            for i, op in enumerate(self.ground)
        ]
        reliances = [
            PyperplanOperator(i, first, facts({a}), frozenset())
            for i, (a, _) in enumerate(self._likely, start=len(self.ground))
        ]
        self.task = Task(
            "task",
            frozenset(range(len(self._asked) + 1)) | first,
            facts(atoms) | {0} | first,
            facts(goal),
            [*steps, *reliances],
        )
        least = [self._costs.least(op) for op in self.ground] + [-math.log(p) for _, p in self._likely]
        self._least = [math.floor(cost / COST_UNIT) for cost in least]

    def heuristic(self, name: str) -> Callable[[SearchNode], float]:
        """Steps to the goal."""
        if name not in HEURISTICS:
            raise UnknownNameError("heuristic", name, list(HEURISTICS))
        return HEURISTICS[name](self.task)

    def cost_to_go(self, name: str) -> Callable[[SearchNode], float]:
        """Cost to the goal, in COST_UNIT: never more than it is, where the heuristic never overestimates steps."""
        if name == "lmcut":
            return LmCut(self.task, dict(enumerate(self._least)))
        steps, least = self.heuristic(name), min(self._least, default=round(1.0 / COST_UNIT))
        return lambda node: steps(node) * least

    def circumstances(self, state: frozenset[int]) -> frozenset[int]:
        """A state of the search, and what follows from it that the costs of steps hang on."""
        return state.union(atom for atom, bases, needed in self._derived if len(bases & state) >= needed)

    def cost(self, op: PyperplanOperator, holding: frozenset[int]) -> int:
        """Of an operator in these `circumstances`, in COST_UNIT."""
        if op.name >= len(self.ground):
            return round(-math.log(self._likely[op.name - len(self.ground)][1]) / COST_UNIT)
        known = op.name, holding & self._hangs[op.name]
        if known not in self._known_costs:
            cost = self._costs.cost(self.ground[op.name], self._atoms_of(known[1]))
            self._known_costs[known] = round(cost / COST_UNIT)
        return self._known_costs[known]

    def _atoms_of(self, facts: frozenset[int]) -> Atoms:
        return frozenset(self._asked[i - 1] for i in facts if 0 < i <= len(self._asked))

    def extra(self, op: PyperplanOperator, node: SearchNode, holding: frozenset[int]) -> int:
        """What an operator costs besides that failed just now: to begin with it, and to do it in the same circumstances
        as far as these are about things. Where the robot comes from it can change at will."""
        if op.name not in self._failed:
            return 0
        first = node.parent is None or bool(self._first & node.state)
        same = self._costs.about_things(self.ground[op.name], self._atoms_of(holding)) == self._then[op.name]
        often = math.log(1 + self._failed[op.name] / ALIKE) if same else 0.0
        return round((AGAIN * first + often) / COST_UNIT)

    def steps(self, found: Sequence[Any]) -> tuple[GroundOperator, ...]:
        return tuple(self.ground[op.name] for op in found if op.name < len(self.ground))

    def relied_on(self, found: Sequence[Any]) -> Atoms:
        return frozenset(self._likely[i][0] for op in found if (i := op.name - len(self.ground)) >= 0)

    def why_not(self) -> str:
        reachable = self.atoms.union(*(op.add for op in self.ground))
        missing = self.goal - reachable
        return f": nothing achieves {_words(missing)}" if missing else " from the atoms that hold now"


def _words(atoms: Atoms) -> str:
    return ", ".join(str(a) for a in sorted(atoms))
