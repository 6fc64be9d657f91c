from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core.state import State
from resync_robot.learning.dataset import Dataset, Run, Step
from resync_robot.learning.operators import OperatorConfig
from resync_robot.learning.select import PAPER_J, Concept, SelectConfig, Selector, _published_cost, edit_distance
from resync_robot.planning.search import plans
from tests.planning.kitchen import CLEAN, CUP, FILL, FULL, OPEN, A, B, X
from tests.planning.models import BLOCKS, ON, OPERATORS, scene

words = st.lists(st.sampled_from("abc"), max_size=6)


@given(words, words, words)
def test_edit_distance_is_a_metric(a, b, c) -> None:
    assert (edit_distance(a, b) == 0) == (a == b)
    assert edit_distance(a, b) == edit_distance(b, a)
    assert edit_distance(a, c) <= edit_distance(a, b) + edit_distance(b, c)
    assert abs(len(a) - len(b)) <= edit_distance(a, b) <= max(len(a), len(b))


def test_the_published_cost_is_the_nodes_where_the_first_plan_is_the_demonstration() -> None:
    objects, atoms = scene(2, {0})
    found = plans(OPERATORS, objects, atoms, frozenset({ON(BLOCKS[1], BLOCKS[0])}), 8)
    shown = tuple((s.name, s.objects) for s in found[0].steps)
    first = _published_cost(found, shown, PAPER_J.penalty)
    assert abs(first - found[0].nodes_created) < 2
    later = _published_cost(found, tuple((s.name, s.objects) for s in found[3].steps), PAPER_J.penalty)
    assert found[0].nodes_created < later < PAPER_J.penalty / 2
    assert _published_cost((), shown, PAPER_J.penalty) == PAPER_J.penalty
    assert _published_cost(found, (), PAPER_J.penalty) > PAPER_J.penalty * 0.99


def test_a_demonstration_that_is_one_of_the_shortest_plans_is_as_near_as_can_be() -> None:
    """Two cups, filled in either order: which plan is found first says nothing of the concepts."""
    state = State({A: np.zeros(3), B: np.zeros(3)})
    goal = frozenset({FULL(A), FULL(B)})
    open_clean = frozenset(p(c) for p in (OPEN, CLEAN) for c in (A, B))
    errors = []
    for order in ((A, B), (B, A), (A, B, A)):
        steps = tuple(Step("Fill", (c,), 0, 0) for c in order)
        run = Run(steps, (), 0, goal, True, "dream", (A, B), 1)
        dataset = Dataset((state,), ((0,),), (run,), {"Fill": (CUP,)})
        known = {"Fill": (X,)}
        selector = Selector(dataset, [open_clean], [], known, {"Fill": FILL}, SelectConfig(), OperatorConfig())
        errors.append(selector.score([]).plan_error)
    assert errors[:2] == [0.0, 0.0]
    assert errors[2] > 0, "one that is longer than need be is not"


def test_of_forms_that_explain_equally_well_the_one_about_more_objects_is_preferred() -> None:
    forms = [Concept(FULL, None, FULL, None, None, (), {}, about) for about in (0, 2, 1)]
    assert [c.about for c in sorted(forms, key=lambda c: c.preference)] == [2, 1, 0]
