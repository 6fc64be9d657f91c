from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core.errors import PlanningError, UnknownNameError
from resync_robot.core.state import State
from resync_robot.core.symbols import Predicate
from resync_robot.core.vocabulary import BLOCK, BOX
from resync_robot.planning.abstract import Abstraction, Exists, ForAll, Not, form_from_json, form_to_json

BLOCKS, BOXES = [BLOCK("b0"), BLOCK("b1")], [BOX("x0"), BOX("x1")]
STATE = State({o: np.zeros(len(o.type.features)) for o in [*BLOCKS, *BOXES]})
CLEAR = Predicate("Clear", (BLOCK, BOX))
FREE, SOME, BLOCKED = ForAll(CLEAR, (1,)), Exists(CLEAR, (1,)), Not(CLEAR)


class Table:
    """A batch classifier that looks its answers up and counts its calls."""

    def __init__(self, values: dict) -> None:
        self.values, self.calls = values, 0

    def __call__(self, state, objects) -> float:
        return self.values[objects]

    def batch(self, state, groundings):
        self.calls += 1
        return np.array([self.values[g] for g in groundings])


def table(values) -> Table:
    return Table({(b, x): v for (b, x), v in zip([(b, x) for b in BLOCKS for x in BOXES], values, strict=True)})


@given(st.lists(st.floats(0, 1), min_size=4, max_size=4))
def test_quantified_forms_agree_with_their_groundings(values) -> None:
    classifier = table(values)
    forms = {f.predicate.name: f for f in (FREE, SOME, BLOCKED)}
    abstraction = Abstraction([CLEAR, *(f.predicate for f in forms.values())], {"Clear": classifier, **forms})
    confidence, true = abstraction.abstract(STATE), abstraction.true_atoms(STATE)
    assert classifier.calls == 2  # one batch for each grounding of the state, whatever derives from it
    for b in BLOCKS:
        clear = [CLEAR(b, x) in true for x in BOXES]
        assert (FREE.predicate(b) in true) == all(clear)
        assert (SOME.predicate(b) in true) == any(clear)
        for x in BOXES:
            assert confidence[BLOCKED.predicate(b, x)] == 1 - confidence[CLEAR(b, x)]


def test_a_base_need_not_be_grounded_itself_and_forms_nest() -> None:
    stuck = Not(FREE.predicate)
    forms = {"Clear": table([0.9, 0.8, 0.9, 0.2]), FREE.predicate.name: FREE, stuck.predicate.name: stuck}
    assert Abstraction([stuck.predicate], forms).true_atoms(STATE) == {stuck.predicate(BLOCKS[1])}


def test_without_a_box_every_block_is_free_and_none_is_in_some_box() -> None:
    state = STATE.project(BLOCKS)
    abstraction = Abstraction(
        [FREE.predicate, SOME.predicate],
        {"Clear": table([0] * 4), FREE.predicate.name: FREE, SOME.predicate.name: SOME},
    )
    assert abstraction.true_atoms(state) == {FREE.predicate(b) for b in BLOCKS}


def test_a_missing_classifier_is_named() -> None:
    with pytest.raises(UnknownNameError, match="Clear"):
        Abstraction([FREE.predicate], {FREE.predicate.name: FREE})
    with pytest.raises(PlanningError, match="cannot quantify"):
        ForAll(CLEAR, (2,))


@pytest.mark.parametrize("form", [FREE, SOME, BLOCKED, ForAll(CLEAR, (0, 1))])
def test_forms_survive_json(form) -> None:
    assert form_from_json(form_to_json(form), {"Clear": CLEAR}) == form
    with pytest.raises(UnknownNameError):
        form_from_json({**form_to_json(form), "base": "Other"}, {"Clear": CLEAR})
    with pytest.raises(UnknownNameError):
        form_from_json({**form_to_json(form), "form": "Most"}, {"Clear": CLEAR})


@given(st.lists(st.floats(0, 1), min_size=8, max_size=8))
def test_several_states_are_judged_in_one_pass_as_each_by_itself(values) -> None:
    class Reads(Table):
        """Judges by a feature of the state, so that a mix-up of states shows."""

        def batch(self, state, groundings):
            self.calls += 1
            return np.array([state.get(g[0], "x")[0] for g in groundings])

    high = Predicate("High", (BLOCK,))
    forms = {f.predicate.name: f for f in (FREE, Not(high))}
    reads = Reads({})
    classifiers = {"Clear": reads, "High": lambda state, objects: state.get(objects[0], "y")[0], **forms}
    abstraction = Abstraction([CLEAR, high, *(f.predicate for f in forms.values())], classifiers)
    states = [
        STATE.with_features(BLOCKS[0], x=values[i], y=values[i + 1]).with_features(BLOCKS[1], x=values[i + 2])
        for i in range(0, 6, 2)
    ]
    each = abstraction.abstract_each(states)
    assert reads.calls == 1
    assert each == [abstraction.abstract(s) for s in states]
    assert abstraction.abstract_each([]) == []
