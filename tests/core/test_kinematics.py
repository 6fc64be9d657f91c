"""The closed form against an independent product of the DH table, and against itself."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from resync_robot.core import kinematics
from resync_robot.core.errors import MotionError
from resync_robot.core.spatial import transform

joints = arrays(np.float64, 6, elements=st.floats(-3.1, 3.1, allow_nan=False))

# The manufacturer's table, typed a second time: a slip of the pen in one of the two shows.
DH_TABLE = (  # d, a, alpha
    (0.1625, 0.0, 90.0),
    (0.0, -0.425, 0.0),
    (0.0, -0.3922, 0.0),
    (0.1333, 0.0, 90.0),
    (0.0997, 0.0, -90.0),
    (0.0996, 0.0, 0.0),
)


def product_of_table(q: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    for angle, (d, a, alpha) in zip(q, DH_TABLE, strict=True):
        turn = transform(Rotation.from_euler("z", angle).as_matrix(), np.array([0.0, 0.0, d]))
        twist = transform(Rotation.from_euler("x", alpha, degrees=True).as_matrix(), np.array([a, 0.0, 0.0]))
        pose = pose @ turn @ twist
    return pose


@given(joints)
def test_forward_is_the_product_of_the_table(q: np.ndarray) -> None:
    np.testing.assert_allclose(kinematics.forward(q), product_of_table(q), atol=1e-12)


@given(joints)
def test_the_last_link_frame_is_the_flange(q: np.ndarray) -> None:
    np.testing.assert_allclose(kinematics.link_frames(q)[-1], kinematics.forward(q), atol=1e-12)


@given(arrays(np.float64, (3, 6), elements=st.floats(-3.1, 3.1, allow_nan=False)))
def test_a_batch_is_its_members(q: np.ndarray) -> None:
    np.testing.assert_allclose(kinematics.forward(q)[1], kinematics.forward(q[1]), atol=1e-12)


def test_torch_gives_what_numpy_gives() -> None:
    import torch

    q = np.random.default_rng(0).uniform(-3, 3, (20, 6))
    pose = kinematics.forward(torch.tensor(q), torch)
    np.testing.assert_allclose(pose.numpy(), kinematics.forward(q), atol=1e-12)
    for branch in kinematics.BRANCHES:
        with np.errstate(invalid="ignore"):
            expected = kinematics.inverse_branch(kinematics.forward(q), branch)
        np.testing.assert_allclose(kinematics.inverse_branch(pose, branch, torch).numpy(), expected, atol=1e-6)


@given(joints, st.sampled_from(kinematics.BRANCHES))
def test_every_branch_that_answers_reaches_the_pose(q: np.ndarray, branch: tuple[int, int, int]) -> None:
    pose = kinematics.forward(q)
    with np.errstate(invalid="ignore"):
        solution = kinematics.inverse_branch(pose, branch)
    if np.all(np.isfinite(solution)):
        np.testing.assert_allclose(kinematics.forward(solution), pose, atol=1e-6)


@given(joints)
def test_inverse_reaches_the_pose_and_stays_at_its_seed(q: np.ndarray) -> None:
    assume(abs(np.sin(q[4])) > 1e-3)  # else the next test
    pose = kinematics.forward(q)
    solution = kinematics.inverse(pose, seed=q)
    np.testing.assert_allclose(kinematics.forward(solution), pose, atol=1e-6)
    # The seed is itself a solution, so a nearest one differs by no more than where the elbow is stretched.
    np.testing.assert_allclose(solution, q, atol=1e-3)


@pytest.mark.parametrize("wrist", [0.0, 1e-9, 1e-5, np.pi, -np.pi])
def test_aligned_wrist_axes_are_solved_or_refused_never_missed(wrist: float) -> None:
    solved = 0
    for q in np.random.default_rng(1).uniform(-3, 3, (100, 6)):
        q[4] = wrist
        pose = kinematics.forward(q)
        try:
            solution = kinematics.inverse(pose, seed=q)
        except MotionError:
            continue
        solved += 1
        np.testing.assert_allclose(kinematics.forward(solution), pose, atol=1e-6)
    assert solved >= 90


def test_a_stretched_elbow_is_solved() -> None:
    q = np.array([0.3, -1.2, 0.0, -0.4, 1.1, 0.2])
    pose = kinematics.forward(q)
    np.testing.assert_allclose(kinematics.forward(kinematics.inverse(pose, seed=q)), pose, atol=1e-6)


@pytest.mark.parametrize("position", [(2.0, 0.0, 0.3), (0.0, 0.0, -1.5), (0.02, 0.0, 0.5)])
def test_out_of_reach_is_refused_with_the_place(position: tuple[float, float, float]) -> None:
    down = Rotation.from_euler("x", 180, degrees=True).as_matrix()
    with pytest.raises(MotionError, match=rf"{position[0]:.3f}, {position[1]:.3f}, {position[2]:.3f}"):
        kinematics.inverse(transform(down, np.array(position)), seed=np.zeros(6))


def test_solutions_beyond_the_limits_are_refused() -> None:
    q = np.array([2.0, -1.5, 1.5, -1.5, -1.5, 0.5])
    tight = np.full(6, 0.1)
    with pytest.raises(MotionError):
        kinematics.inverse(kinematics.forward(q), seed=q, limit=tight)


@given(joints, st.integers(-1, 1))
def test_the_turn_of_the_seed_is_kept_where_the_limits_allow(q: np.ndarray, turns: int) -> None:
    seed = q.copy()
    seed[5] += 2 * np.pi * turns
    assume(abs(np.sin(q[4])) > 1e-3 and abs(seed[5]) < 2 * np.pi - 0.01)
    assert kinematics.inverse(kinematics.forward(q), seed=seed)[5] == pytest.approx(seed[5], abs=1e-3)
