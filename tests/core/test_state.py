"""A state keeps what it is given, and says what it cannot keep."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from resync_robot.core.errors import ResyncError, UnknownNameError
from resync_robot.core.state import State
from resync_robot.core.symbols import Type

BLOCK, ROBOT = Type("block", ("x", "y", "z")), Type("robot", ("x", "opening"))
TYPES = {t.name: t for t in (BLOCK, ROBOT)}
finite = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def states(draw: st.DrawFn) -> State:
    features, covariance = {}, {}
    for name in draw(st.sets(st.from_regex(r"[a-z][a-z0-9_]{0,5}", fullmatch=True), max_size=4)):
        obj = draw(st.sampled_from([BLOCK, ROBOT]))(name)
        n = len(obj.type.features)
        features[obj] = draw(arrays(np.float64, n, elements=finite))
        if draw(st.booleans()):
            covariance[obj] = draw(arrays(np.float64, (n, n), elements=finite))
    return State(features, covariance)


@given(states())
def test_json_and_back(state: State) -> None:
    back = State.from_json(json.loads(json.dumps(state.to_json())), TYPES)
    assert back == state
    for obj in state:
        expected = state.covariance(obj)
        found = back.covariance(obj)
        assert (found is None) == (expected is None)
        if expected is not None:
            np.testing.assert_array_equal(found, expected)


@given(states())
def test_the_projection_on_everything_changes_nothing(state: State) -> None:
    assert state.project(state.objects) == state


B0, B1, ARM = BLOCK("b0"), BLOCK("b1"), ROBOT("robot")


@pytest.fixture
def state() -> State:
    return State({B1: [4.0, 5.0, 6.0], ARM: [0.5, 0.1], B0: [1.0, 2.0, 3.0]}, {B0: np.eye(3)})


def test_features_come_in_the_order_asked_for(state: State) -> None:
    np.testing.assert_array_equal(state.get(B0, "z", "x"), [3.0, 1.0])


def test_a_change_leaves_the_original_alone(state: State) -> None:
    changed = state.with_features(B0, y=9.0)
    np.testing.assert_array_equal(changed[B0], [1.0, 9.0, 3.0])
    np.testing.assert_array_equal(state[B0], [1.0, 2.0, 3.0])
    assert changed != state
    assert changed.covariance(B0) is not None


def test_vectors_cannot_be_written_to(state: State) -> None:
    with pytest.raises(ValueError, match="read-only"):
        state[B0][0] = 7.0


def test_projection_keeps_the_objects_and_their_covariance(state: State) -> None:
    small = state.project([B0])
    assert small.objects == (B0,)
    np.testing.assert_array_equal(small.covariance(B0), np.eye(3))


def test_objects_come_sorted_and_by_type(state: State) -> None:
    assert state.objects == (B0, B1, ARM)
    assert state.of_type(BLOCK) == (B0, B1)
    assert B0 in state
    assert len(state) == 3


def test_a_vector_of_the_wrong_length_is_refused() -> None:
    with pytest.raises(ResyncError, match=r"b0 has shape \(2,\).*3 features: x, y, z"):
        State({B0: [1.0, 2.0]})


def test_unknown_names_are_refused_with_the_valid_ones(state: State) -> None:
    with pytest.raises(UnknownNameError, match=r"'b7'(.|\n)*b0, b1, robot"):
        state[BLOCK("b7")]
    with pytest.raises(UnknownNameError, match=r"'yaw'(.|\n)*x, y, z"):
        state.get(B0, "yaw")
    with pytest.raises(UnknownNameError, match="'yaw'"):
        state.with_features(B0, yaw=1.0)
    with pytest.raises(UnknownNameError, match=r"'cup'(.|\n)*block, robot"):
        State.from_json({"c": {"type": "cup", "features": []}}, TYPES)
