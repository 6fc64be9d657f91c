"""A failure is the same one again where the objects of its skill are where they were, as far as can be told."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core.state import State
from resync_robot.core.symbols import Atoms, GroundOperator, Object, Operator
from resync_robot.planning.failures import LEAST_MOVE, SIGMAS, Failures, has_moved
from tests import scenes
from tests.scenes import B0, B1, THE_BOX, R

SCENE = scenes.scene({"b0": (scenes.CORNER, scenes.CORNER), "b1": (0.0, 0.0)}).initial
NOTHING: Atoms = frozenset()
FREE_B0 = GroundOperator(Operator("Free", (), NOTHING, NOTHING, NOTHING), (R, B0, THE_BOX), NOTHING, NOTHING, NOTHING)


def moved(state: State, metres: float, obj: Object = B0) -> State:
    return state.with_features(obj, x=float(state.get(obj, "x")[0]) + metres)


def test_failures_that_leave_everything_in_place_are_counted() -> None:
    failures, elsewhere = Failures(), moved(SCENE, 0.1, R)
    assert [failures.count(FREE_B0, SCENE, after) for after in (SCENE, elsewhere, SCENE)] == [1, 2, 3]
    # What another block did is no matter of this skill.
    assert failures.count(FREE_B0, SCENE, moved(SCENE, 0.1, B1)) == 4


def test_each_attempt_that_moves_its_block_begins_the_count_anew() -> None:
    failures, state, counts = Failures(), SCENE, []
    for step in (0.01, 0.01, 0.0, 0.0):
        after = moved(state, step)
        counts.append(failures.count(FREE_B0, state, after))
        state = after
    assert counts == [1, 1, 2, 3]


def test_small_steps_add_up() -> None:
    failures, state, counts = Failures(), SCENE, []
    for _ in range(6):
        after = moved(state, 0.6 * LEAST_MOVE)
        counts.append(failures.count(FREE_B0, state, after))
        state = after
    assert max(counts) == 2


@given(st.floats(0.0, 0.05), st.floats(0.0, 0.01), st.floats(0.0, 0.01))
def test_what_the_errors_of_two_looks_explain_is_no_motion(metres: float, first: float, second: float) -> None:
    def seen(state: State, sigma: float) -> State:
        return State({o: state[o] for o in state}, {B0: np.eye(len(B0.type.features)) * sigma**2})

    told = has_moved(seen(SCENE, first), seen(moved(SCENE, metres), second), (R, B0, THE_BOX))
    least = LEAST_MOVE + SIGMAS * np.hypot(first, second)
    assert told == (metres > least) or abs(metres - least) < 1e-9
    assert not has_moved(SCENE, moved(SCENE, 1.0), (R, THE_BOX))
