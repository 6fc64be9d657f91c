"""Poses form a group, and every way of writing a rotation says the same."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from resync_robot.core import spatial

numbers = st.floats(-3.0, 3.0, allow_nan=False)
positions = arrays(np.float64, 3, elements=numbers)
angles = st.floats(-np.pi, np.pi, allow_nan=False)


@st.composite
def quaternions(draw: st.DrawFn) -> np.ndarray:
    quat = draw(arrays(np.float64, 4, elements=st.floats(-1.0, 1.0, allow_nan=False)))
    assume(np.linalg.norm(quat) > 0.1)
    return quat / np.linalg.norm(quat)


@st.composite
def poses(draw: st.DrawFn) -> np.ndarray:
    return spatial.transform(spatial.matrix_from_quat(draw(quaternions())), draw(positions))


@given(poses())
def test_inverse_undoes_on_both_sides(pose: np.ndarray) -> None:
    np.testing.assert_allclose(pose @ spatial.inverse(pose), np.eye(4), atol=1e-12)
    np.testing.assert_allclose(spatial.inverse(pose) @ pose, np.eye(4), atol=1e-12)


@given(poses(), poses())
def test_inverse_of_a_product_swaps_the_factors(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(spatial.inverse(a @ b), spatial.inverse(b) @ spatial.inverse(a), atol=1e-12)


@given(poses(), poses(), arrays(np.float64, (5, 3), elements=numbers))
def test_apply_composes(a: np.ndarray, b: np.ndarray, points: np.ndarray) -> None:
    np.testing.assert_allclose(spatial.apply(a @ b, points), spatial.apply(a, spatial.apply(b, points)), atol=1e-12)


@given(quaternions())
def test_quaternion_to_matrix_and_back(quat: np.ndarray) -> None:
    back = spatial.quat_from_matrix(spatial.matrix_from_quat(quat))
    assert back[0] >= 0
    # q and -q are the same rotation.
    assert abs(np.dot(back, quat)) == pytest.approx(1.0, abs=1e-12)


@given(quaternions())
def test_matrix_agrees_with_scipy(quat: np.ndarray) -> None:
    expected = Rotation.from_quat(quat, scalar_first=True).as_matrix()
    np.testing.assert_allclose(spatial.matrix_from_quat(quat), expected, atol=1e-12)


@pytest.mark.parametrize("axis", "xyz")
def test_half_turns_survive_the_round_trip(axis: str) -> None:
    half_turn = spatial.rotation_about(axis, np.pi)
    np.testing.assert_allclose(spatial.matrix_from_quat(spatial.quat_from_matrix(half_turn)), half_turn, atol=1e-12)


@given(st.sampled_from("xyz"), angles)
def test_rotation_about_agrees_with_scipy(axis: str, angle: float) -> None:
    expected = Rotation.from_euler(axis, angle).as_matrix()
    np.testing.assert_allclose(spatial.rotation_about(axis, angle), expected, atol=1e-12)


@given(poses())
def test_features_to_pose_and_back(pose: np.ndarray) -> None:
    np.testing.assert_allclose(spatial.pose_from_features(spatial.features_from_pose(pose)), pose, atol=1e-12)


@given(arrays(np.float64, 3, elements=st.floats(-1.7, 1.7, allow_nan=False)))
def test_rotation_vector_and_back(vector: np.ndarray) -> None:
    # Shorter than pi, so that the vector of a rotation is unique.
    np.testing.assert_allclose(spatial.rotation_vector(spatial.rotation_from_vector(vector)), vector, atol=1e-8)


@given(angles)
def test_yaw_and_back(yaw: float) -> None:
    assert spatial.wrap(spatial.yaw_of(spatial.quat_from_yaw(yaw)) - yaw) == pytest.approx(0.0, abs=1e-9)


@given(st.floats(-50, 50, allow_nan=False), st.sampled_from([np.pi / 2, np.pi, 2 * np.pi]))
def test_wrap_keeps_the_angle_and_the_range(angle: float, period: float) -> None:
    wrapped = float(spatial.wrap(angle, period))
    turns = (angle - wrapped) / period
    assert -period / 2 <= wrapped <= period / 2
    assert turns == pytest.approx(round(turns), abs=1e-9)


def test_batches_give_what_single_poses_give() -> None:
    rng = np.random.default_rng(0)
    quats, shifts = rng.normal(size=(4, 6, 4)), rng.normal(size=(4, 6, 3))
    batch = spatial.transform(spatial.matrix_from_quat(quats), shifts)
    single = spatial.transform(spatial.matrix_from_quat(quats[2, 3]), shifts[2, 3])
    np.testing.assert_allclose(batch[2, 3], single)
    np.testing.assert_allclose(spatial.inverse(batch)[2, 3], spatial.inverse(single))
    np.testing.assert_allclose(spatial.features_from_pose(batch)[2, 3], spatial.features_from_pose(single))


def test_transform_of_nothing_is_the_identity() -> None:
    np.testing.assert_array_equal(spatial.transform(), np.eye(4))
