"""Attempts are counted by what held of their arguments, those only whose preconditions held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from resync_robot.core.state import State
from resync_robot.core.symbols import Object, Operator, Predicate, Variable
from resync_robot.core.trajectory import Trajectory, Transition
from resync_robot.learning.outcome_counts import experience
from resync_robot.planning.abstract import Abstraction, Not
from tests.planning.kitchen import CLEAN, CUP, FILL, FULL, OPEN, A, B

IS_SHUT = Not(OPEN)
BESIDE = Predicate("Beside", (CUP, CUP))


def reader(feature: str):
    return lambda state, objects: float(state.get(objects[0], feature)[0])


ABSTRACTION = Abstraction(
    (OPEN, FULL, CLEAN, IS_SHUT.predicate),
    {"Open": reader("open"), "Full": reader("full"), "Clean": reader("clean"), IS_SHUT.predicate.name: IS_SHUT},
)


def attempt(cup: Object, succeeded: bool, **features: float) -> Transition:
    values = np.array([features.get(f, 0.0) for f in CUP.features])
    other = A if cup == B else B
    state = State({cup: values, other: np.ones(3)})
    return Transition(state, "Fill", (cup,), state, succeeded)


def test_attempts_are_counted_by_what_held() -> None:
    tried = [
        attempt(A, True, open=1, clean=1),
        attempt(B, True, open=1, clean=1),
        attempt(A, True, open=1, clean=1, full=1),
        attempt(A, False, open=1, clean=1, full=1),
        # Preconditions did not hold: no wonder.
        attempt(A, False, open=1, clean=0, full=1),
    ]
    unknown = Transition(tried[0].before, "Juggle", (A, B), tried[0].after, False)
    runs = [
        Trajectory((*tried[:2], unknown), frozenset({FULL(A)}), True, "dream"),
        Trajectory(tuple(tried[2:]), frozenset({FULL(A)}), False, "dream"),
    ]
    found = experience(runs, ABSTRACTION, (FILL,), given=(OPEN, FULL, CLEAN))
    assert set(found) == {"Fill"}
    assert found["Fill"] == [
        {"predicate": "Clean", "arguments": [0], "held": [3, 4], "otherwise": [0, 0]},
        {"predicate": "Full", "arguments": [0], "held": [1, 2], "otherwise": [2, 2]},
        {"predicate": "Open", "arguments": [0], "held": [3, 4], "otherwise": [0, 0]},
    ]


def test_it_counts_too_whether_a_given_predicate_holds_of_an_argument_and_anything() -> None:
    classifiers = {**ABSTRACTION.classifiers, "Beside": lambda state, pair: float(state.get(pair[1], "full")[0])}
    abstraction = Abstraction((*ABSTRACTION.predicates, BESIDE), classifiers)
    tried = [attempt(A, True, open=1, clean=1), attempt(A, False, open=1, clean=1, full=1)]
    runs = [Trajectory(tuple(tried), frozenset({FULL(A)}), True, "dream")]
    found = experience(runs, abstraction, (FILL,), given=(OPEN, FULL, CLEAN, BESIDE))["Fill"]
    assert [t for t in found if "over" in t] == [
        # The other cup is full each time, the filled one once.
        {"predicate": "Beside", "form": "Exists", "over": [0], "arguments": [0], "held": [0, 1], "otherwise": [1, 1]},
        {"predicate": "Beside", "form": "Exists", "over": [1], "arguments": [0], "held": [1, 2], "otherwise": [0, 0]},
    ]
    plain = experience(runs, ABSTRACTION, (FILL,), given=(OPEN, FULL, CLEAN))["Fill"]
    assert [t for t in found if "over" not in t] == plain


def test_it_counts_too_whether_what_was_learned_holds_of_all() -> None:
    tried = [attempt(A, True, open=1, clean=1), attempt(A, False, open=1, clean=1, full=1)]
    runs = [Trajectory(tuple(tried), frozenset({FULL(A)}), True, "dream")]
    found = experience(runs, ABSTRACTION, (FILL,), given=(OPEN, CLEAN))["Fill"]
    assert [t for t in found if "form" in t] == [
        {"predicate": "Full", "form": "ForAll", "over": [0], "arguments": [], "held": [0, 1], "otherwise": [1, 1]}
    ]


def test_it_counts_what_holds_of_two_arguments_together() -> None:
    """A skill over two cups, and whether the second is beside the first."""
    beside = {"Beside": lambda state, pair: float(state.get(pair[1], "full")[0] - state.get(pair[0], "full")[0])}
    over = Operator("PourOver", (Variable("?x", CUP), Variable("?y", CUP)))
    tried = [attempt(A, True, full=0), attempt(A, False, full=1)]
    pairs = [replace(t, skill="PourOver", objects=(A, B)) for t in tried]
    runs = [Trajectory(tuple(pairs), frozenset({FULL(A)}), True, "dream")]
    found = experience(runs, Abstraction((BESIDE,), beside), (over,))["PourOver"]
    assert {tuple(t["arguments"]): (t["held"], t["otherwise"]) for t in found} == {
        (0, 1): ([1, 1], [0, 1]),
        (1, 0): ([0, 0], [1, 2]),
    }
