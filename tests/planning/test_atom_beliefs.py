"""Probabilities of atoms: what a look says, what an outcome says, and when either is forgotten."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core.skill import SkillEnd, SkillOutcome
from resync_robot.core.symbols import Atom
from resync_robot.planning.atom_beliefs import AtomBeliefs, BeliefSettings
from resync_robot.planning.outcome_costs import OutcomeCosts, Tally
from tests.planning.kitchen import CLEAN, FILL, FULL, OPEN, WIPE, A, B

DONE, BLOCKED, REFUSED = SkillOutcome(SkillEnd.DONE), SkillOutcome(SkillEnd.BLOCKED), SkillOutcome(SkillEnd.REFUSED)
FILL_A, WIPE_A = FILL.ground((A,)), WIPE.ground((A,))
PRACTISED = OutcomeCosts(
    {"Fill": [Tally(OPEN, (0,), (690, 690), (0, 0))], "Wipe": [Tally(OPEN, (0,), (46, 50), (0, 0))]}
)
MEASURED = {"Clean": 0.05}


def looks(**changes: float) -> dict[Atom, float]:
    """Cup a is open and clean, cup b is neither, both are empty; keywords such as clean=0.0 are about a."""
    seen = {OPEN(A): 1.0, CLEAN(A): 1.0, FULL(A): 0.0, OPEN(B): 0.0, CLEAN(B): 0.0, FULL(B): 0.0}
    return seen | {p(A): changes[p.name.lower()] for p in (OPEN, CLEAN, FULL) if p.name.lower() in changes}


def beliefs(learned=None, costs: OutcomeCosts | None = None, **seen: float) -> AtomBeliefs:
    found = AtomBeliefs(MEASURED if learned is None else learned, costs)
    found.perceived(looks(**seen))
    return found


def test_a_look_is_believed_as_far_as_its_classifier_is_to_be_trusted() -> None:
    b = beliefs({"Clean": 0.05, "Full": 0.0, "Open": None})
    assert b.probability(CLEAN(A)) == pytest.approx(0.95) and b.probability(CLEAN(B)) == pytest.approx(0.05)
    assert b.probability(FULL(A)) == pytest.approx(BeliefSettings().least_error), "nothing is beyond all doubt"
    assert b.probability(OPEN(A)) == pytest.approx(1 - BeliefSettings().error)
    assert beliefs().probability(OPEN(A)) == 1.0, "what is given is believed as it is seen"
    assert b.certain() == {OPEN(A), CLEAN(A)} and b.likely() == {}
    # The same look again says nothing new.
    b.perceived(looks())
    assert b.probability(CLEAN(A)) == pytest.approx(0.95)
    # Half of the poses speak for it.
    b.perceived(looks(clean=0.6))
    assert b.certain() == {OPEN(A)} and b.likely() == {CLEAN(A): pytest.approx(0.59)}
    assert b.shown()[CLEAN(A)] == 0.5 and b.shown()[OPEN(A)] == pytest.approx(0.95)


def test_a_failure_says_the_more_the_more_reliable_the_skill_was() -> None:
    unknown, practised = beliefs(), beliefs(costs=PRACTISED)
    for b in (unknown, practised):
        assert not b.attempted(FILL_A, BLOCKED, looks())
        assert CLEAN(A) not in b.certain() and b.probability(OPEN(A)) == 1.0
    assert unknown.probability(CLEAN(A)) == pytest.approx(0.95 * 0.1 / (0.95 * 0.1 + 0.05 * 0.9))
    assert practised.probability(CLEAN(A)) < 0.06 < 0.5 < unknown.probability(CLEAN(A))
    assert CLEAN(A) in practised.likely(), "a last resort: it looks true"
    assert practised.probability(CLEAN(B)) == pytest.approx(0.05), "about the cup that failed alone"


def test_a_failure_is_shared_among_learned_preconditions_by_how_doubtful_they_were() -> None:
    alone, both = beliefs(costs=PRACTISED), beliefs({"Clean": 0.05, "Open": 0.2}, costs=PRACTISED)
    for b in (alone, both):
        b.attempted(FILL_A, BLOCKED, looks())
    assert both.probability(OPEN(A)) < both.probability(CLEAN(A)) < 0.95
    assert alone.probability(CLEAN(A)) < both.probability(CLEAN(A)), "the other one may be to blame"


def test_success_speaks_for_what_was_doubted() -> None:
    b = beliefs(clean=0.6)
    before = b.probability(CLEAN(A))
    assert b.attempted(FILL_A, DONE, looks(clean=0.6, full=1.0))
    assert b.probability(CLEAN(A)) > before


@pytest.mark.parametrize(("outcomes", "believed"), [([DONE] * 2, True), ([BLOCKED] * 2, False), ([BLOCKED] * 4, True)])
def test_done_in_vain_again_and_again_means_that_the_classifier_is_wrong(
    outcomes: list[SkillOutcome], believed
) -> None:
    b = beliefs(costs=PRACTISED, clean=0.0)
    came_true = [b.attempted(WIPE_A, outcome, looks(clean=0.0)) for outcome in outcomes]
    assert not came_true[0] and came_true[-1] == believed
    assert (CLEAN(A) in b.certain()) == believed
    if believed:
        assert not b.attempted(FILL_A, BLOCKED, looks(clean=0.0))
        assert CLEAN(A) not in b.certain(), "one failure shows that it was right"


def test_what_is_restored_is_believed_again() -> None:
    b = beliefs(costs=PRACTISED)
    b.attempted(FILL_A, BLOCKED, looks())
    assert b.attempted(WIPE_A, DONE, looks())
    assert b.probability(CLEAN(A)) == pytest.approx(0.95)


def test_an_outcome_tells_of_what_the_skill_mostly_fails_without_though_it_needs_nothing() -> None:
    """Wipe has no precondition about how open a cup is, but a closed one is hard to wipe."""
    told = OutcomeCosts({"Wipe": [Tally(OPEN, (0,), (90, 100), (5, 50))]})
    learned = {"Clean": 0.05, "Open": 0.1}
    b, without = beliefs(learned, told, clean=0.0), beliefs(learned, clean=0.0)
    for each in (b, without):
        each.attempted(WIPE_A, BLOCKED, looks(clean=0.0))
    assert OPEN(A) not in b.certain() and b.probability(OPEN(A)) < without.probability(OPEN(A)) == pytest.approx(0.9)
    once = b.probability(OPEN(A))
    b.attempted(WIPE_A, BLOCKED, looks(clean=0.0))
    assert b.probability(OPEN(A)) < once, "failures add up"
    b.attempted(WIPE_A, DONE, looks())
    assert b.probability(OPEN(A)) > once, "and a success takes them back"


def test_where_a_circumstance_makes_no_difference_outcomes_say_nothing_of_it() -> None:
    same = OutcomeCosts({"Wipe": [Tally(OPEN, (0,), (90, 100), (90, 100))]})
    b = beliefs({"Clean": 0.05, "Open": 0.1}, same, clean=0.0)
    b.attempted(WIPE_A, BLOCKED, looks(clean=0.0))
    assert b.probability(OPEN(A)) == pytest.approx(0.9)


@pytest.mark.parametrize("ending", [SkillEnd.REFUSED, SkillEnd.NEEDLESS])
def test_a_skill_that_refused_to_begin_restored_nothing(ending: SkillEnd) -> None:
    b = beliefs(clean=0.0)
    for _ in range(5):
        assert not b.attempted(WIPE_A, SkillOutcome(ending), looks(clean=0.0))
    assert b.probability(CLEAN(A)) == pytest.approx(0.05)


def test_evidence_about_an_object_fades_once_it_has_changed() -> None:
    b = beliefs(costs=PRACTISED)
    b.attempted(FILL_A, BLOCKED, looks())
    distrusted = b.probability(CLEAN(A))
    b.perceived(looks() | {OPEN(B): 1.0})
    assert b.probability(CLEAN(A)) == distrusted, "the other cup changed"
    b.perceived(looks(open=0.0))
    faded = b.probability(CLEAN(A))
    b.perceived(looks())
    assert distrusted < faded < b.probability(CLEAN(A)) < 0.95


def test_missing_effects_and_effects_that_stay_are_no_success() -> None:
    b = beliefs()
    assert b.attempted(FILL_A, DONE, looks(full=1.0))
    assert not beliefs().attempted(FILL_A, DONE, looks(full=0.6)), "not certain"
    soiling = replace(WIPE_A, delete=frozenset({OPEN(A)}))
    assert beliefs().attempted(soiling, DONE, looks(open=0.0))
    assert not beliefs().attempted(soiling, DONE, looks()), "it is still open"


OUTCOMES = st.sampled_from([DONE, BLOCKED, REFUSED, SkillOutcome(SkillEnd.NEEDLESS)])


@given(st.lists(st.tuples(st.sampled_from([FILL_A, WIPE_A]), OUTCOMES, st.floats(0, 1), st.floats(0, 1)), max_size=30))
def test_outcomes_never_outweigh_a_clear_look_beyond_measure(history) -> None:
    b, s = beliefs(costs=PRACTISED), BeliefSettings()
    for step, outcome, clean, full in history:
        b.attempted(step, outcome, looks(clean=clean, full=full))
        assert 0.0 < b.probability(CLEAN(A)) < 1.0
        assert clean < 0.5 or b.probability(CLEAN(A)) >= 1 - s.most - 1e-9
        assert clean > 0.5 or b.probability(CLEAN(A)) <= s.most + 1e-9
        assert not b.certain() & b.likely().keys()


def test_an_attempt_that_gave_up_is_not_believed_for_what_practice_came_to() -> None:
    """As a recovery that always succeeded in practice, ran out of time here, and left what looks half done."""
    always = OutcomeCosts({"Wipe": [Tally(OPEN, (0,), (300, 300), (0, 0))]})
    gave_up, done = (beliefs(costs=always, clean=0.4) for _ in range(2))
    assert not gave_up.attempted(WIPE_A, BLOCKED, looks(clean=0.4)) and CLEAN(A) not in gave_up.certain()
    assert done.attempted(WIPE_A, DONE, looks(clean=0.4)) and CLEAN(A) in done.certain()
