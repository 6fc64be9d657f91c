"""Attempts are counted by what held of their arguments, those only whose preconditions held."""

from __future__ import annotations

import numpy as np

from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.trajectory import Trajectory, Transition
from resync_robot.learning.outcome_counts import experience
from resync_robot.planning.abstract import Abstraction, Not
from tests.planning.kitchen import CLEAN, CUP, FILL, FULL, OPEN, A, B

IS_SHUT = Not(OPEN)


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
    found = experience(runs, ABSTRACTION, (FILL,))
    assert set(found) == {"Fill"}
    assert found["Fill"] == [
        {"predicate": "Clean", "argument": 0, "held": [3, 4], "otherwise": [0, 0]},
        {"predicate": "Full", "argument": 0, "held": [1, 2], "otherwise": [2, 2]},
        {"predicate": "Open", "argument": 0, "held": [3, 4], "otherwise": [0, 0]},
    ]
