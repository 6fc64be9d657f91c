from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from resync_robot.learning.select import PAPER_J, _published_cost, edit_distance
from resync_robot.planning.search import plans
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
