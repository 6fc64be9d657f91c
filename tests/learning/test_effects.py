from __future__ import annotations

import pytest

from resync_robot.core.errors import TrainingError
from resync_robot.core.state import State
from resync_robot.core.trajectory import Trajectory, Transition
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.learning.dataset import merged_dataset, variant_dataset
from resync_robot.learning.effects import Attempts, Candidate, Effect, affordances, candidates, slots, supervise
from tests.learning.toy import BOX_0, ON, ROBOT_0, Toy

SIGNATURES = {"Pick": (ROBOT, BLOCK), "Insert": (ROBOT, BLOCK, BLOCK), "Recover": (ROBOT, BLOCK, BOX)}
B = [BLOCK("b0"), BLOCK("b1")]
GOAL = frozenset({ON(B[0], B[1])})
PAIR = (BLOCK, BOX)
FREE = Candidate(PAIR, (Effect("Recover", (1, 2), 1),))
RECOVERED = Effect("Recover", (1, 2), 1)


@pytest.fixture(scope="module")
def mended() -> Trajectory:
    """Pick fails in the corner, the recovery mends it, Pick and Insert succeed."""
    toy = Toy(0, noise=False)
    state = toy.scene(2, lambda i: "corner" if i == 0 else "free")
    steps = [("Pick", (ROBOT_0, B[0])), ("Insert", (ROBOT_0, B[0], B[1]))]
    return toy.record(state, steps, GOAL, "before@b0", mends=1)


def test_a_failed_attempt_and_its_recovery_are_one_use_of_the_recovery(mended: Trajectory) -> None:
    run = merged_dataset([[mended]], ("Recover",), SIGNATURES).runs[0]
    assert [s.skill for s in run.steps] == ["Recover", "Pick", "Insert"]
    assert [s.skill for s in run.failures] == ["Pick"]
    assert run.failures[0].before == run.failures[0].after == run.steps[0].before == run.first
    assert all(a.after == b.before for a, b in zip(run.steps, run.steps[1:], strict=False))


def test_the_published_view_gives_the_failed_attempt_a_symbol(mended: Trajectory) -> None:
    data = variant_dataset([[mended]], ("Recover",), SIGNATURES)
    assert [s.skill for s in data.runs[0].steps] == ["Pick_Recover", "Recover", "Pick", "Insert"]
    assert data.signatures["Pick_Recover"] == (ROBOT, BLOCK) and not data.runs[0].failures


def test_unknown_skills_and_empty_data_are_refused(mended: Trajectory) -> None:
    with pytest.raises(TrainingError, match="known skills"):
        merged_dataset([[mended]], ("Recover",), {"Pick": (ROBOT, BLOCK)})
    with pytest.raises(TrainingError, match="no trajectory"):
        merged_dataset([[]], ("Recover",), SIGNATURES)


def test_candidates_are_counted_up_to_their_sign() -> None:
    three = {**SIGNATURES, "Place": (ROBOT, BLOCK)}
    pairs = [c for c in candidates("Recover", ["Recover", "Pick", "Place"], three) if c.types == PAIR]
    assert len(pairs) == 13 and len(set(pairs)) == 13  # (3^3 - 1) / 2
    assert all(c.effects[0].sign == 1 for c in pairs)
    assert {c.types for c in candidates("Recover", ["Recover", "Pick"], three)} == {
        (ROBOT,), (BLOCK,), (BOX,), (ROBOT, BLOCK), (ROBOT, BOX), PAIR
    }  # fmt: skip


def test_names_tell_candidates_apart() -> None:
    found = candidates("Recover", ["Recover", "Pick", "Insert"], SIGNATURES)
    found += affordances("Recover", ["Pick", "Insert"], SIGNATURES)
    assert len({c.name for c in found}) == len(set(found))


def test_slots_read_a_predicate_through_a_skill() -> None:
    assert slots(PAIR, SIGNATURES["Recover"]) == [(1, 2)]
    assert slots(PAIR, SIGNATURES["Insert"]) == [(1, None), (2, None)]
    assert slots((BOX,), SIGNATURES["Pick"]) == []


def test_values_spread_until_the_next_effect(mended: Trajectory) -> None:
    found = supervise(merged_dataset([[mended]], ("Recover",), SIGNATURES), FREE)
    of_b0 = {(lab.moment, lab.value, lab.direct) for lab in found.labels if lab.atoms == ((B[0], BOX_0),)}
    moments = sorted(of_b0)
    assert [(v, d) for _, v, d in moments] == [(0, True), (1, True), (1, False), (1, False)]
    assert not found.contradicted and not [lab for lab in found.labels if lab.atoms[0][0] == B[1]]


def test_contradictions_show_without_training(mended: Trajectory) -> None:
    data = merged_dataset([[mended]], ("Recover",), SIGNATURES)
    again = Candidate(PAIR, (RECOVERED, Effect("Pick", (1, None), 1)))
    assert supervise(data, again).contradicted
    undone = Candidate(PAIR, (RECOVERED, Effect("Pick", (1, None), -1)))
    assert not supervise(data, undone).contradicted


def test_attempts_label_and_explained_ones_do_not(mended: Trajectory) -> None:
    failed = next(t for t in mended.transitions if not t.succeeded)
    alone = Trajectory((failed,), GOAL, False, "attempt")
    data = merged_dataset([[mended, alone]], ("Recover",), SIGNATURES)
    ready = Candidate(PAIR, (RECOVERED,), Attempts("Pick", (1, None)))
    values = [lab.value for lab in supervise(data, ready).labels if lab.run == 1 and lab.direct]
    assert values == [0]
    assert not [lab for lab in supervise(data, ready, {data.runs[1].failures[0]}).labels if lab.run == 1]


def test_of_several_boxes_one_is_to_blame() -> None:
    """A failure says that at least one (block, box) atom is false, a success that all are true."""
    toy = Toy(0, noise=False)
    state = toy.scene(1, lambda i: "corner")
    other = BOX("other")
    two = State({**{o: state[o] for o in state}, other: state[BOX_0]})
    tries = [Transition(two, "Pick", (ROBOT_0, B[0]), two, succeeded) for succeeded in (False, True)]
    data = merged_dataset([[Trajectory((t,), GOAL, False, "attempt") for t in tries]], ("Recover",), SIGNATURES)
    labels = supervise(data, Candidate(PAIR, (RECOVERED,), Attempts("Pick", (1, None)))).labels
    assert [(len(lab.atoms), lab.value) for lab in labels if lab.direct] == [(2, 0), (1, 1), (1, 1)]
