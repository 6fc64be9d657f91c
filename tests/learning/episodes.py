"""Whether a learned model reaches goals in the toy, and small nets to learn one in seconds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from resync_robot.core.errors import PlanningError
from resync_robot.core.symbols import GroundOperator
from resync_robot.learning.concepts import ConceptConfig, Concepts
from resync_robot.learning.fit import SCREENING, FitConfig
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.search import plan
from tests.learning.toy import Toy

SMALL = ConceptConfig(fit=FitConfig(widths=(64, 64), epochs=15, learning_rate=3e-3))
QUICK = replace(SMALL, screening=replace(SCREENING, epochs=8))
"""For sixty dreams, and two stages of them."""


def success(concepts: Concepts, scenario: str, episodes: int, toy: Toy | None = None) -> float:
    """Share of episodes that reach the goal, planning anew after every step."""
    toy, solved = toy or Toy(1000), []
    abstraction = Abstraction(concepts.predicates, concepts.classifiers)
    named = {p.name: p for p in concepts.predicates}
    operators = {op.name: op for op in concepts.operators}
    relied_on = concepts.report["affordances_of"].get("Pick", [])
    for _ in range(episodes):
        state, goal = toy.scenario(scenario)
        following: list[GroundOperator] = []

        def decide(seen, failed, goal=goal, following=following):
            if following:
                return following.pop()
            judged = abstraction.abstract(seen)
            atoms = {a for a, p in judged.items() if p > 0.5}
            for a in failed if relied_on else ():
                # Of the atoms that Pick relies on, the one that is least sure.
                atoms.discard(min((named[x["predicate"]](a.args[x["argument"]]) for x in relied_on), key=judged.get))
            try:
                steps = plan(concepts.operators, seen.objects, frozenset(atoms), goal).steps
            except PlanningError:
                return None
            if (real := concepts.report["variants"].get(steps[0].name)) is None:
                return steps[0]
            # A failure on purpose changes nothing that could be seen, so the plan goes on as it was meant.
            following += steps[1:2]
            return operators[real].ground(steps[0].objects)

        solved.append(toy.execute(state, goal, decide)[0])
    return float(np.mean(solved))
