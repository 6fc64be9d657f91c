"""The closed form against an independent product of the DH table, and against itself."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from resync_robot.core.errors import MotionError
from resync_robot.core.kinematics import BRANCHES, Kinematics
from resync_robot.core.machines import ARMS
from resync_robot.core.spatial import transform

joints = arrays(np.float64, 6, elements=st.floats(-3.1, 3.1, allow_nan=False))

arms = st.sampled_from([arm.kinematics for arm in ARMS.values()])

# The manufacturer's tables, typed a second time: a slip of the pen in one of the two shows. d1, a2, a3, d4, d5, d6.
LENGTHS = {
    "ur3e": (0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    "ur5e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "ur7e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "ur10e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "ur12e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "ur16e": (0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
}
UR7E = ARMS["ur7e"].kinematics


def product_of_table(name: str, q: np.ndarray) -> np.ndarray:
    d1, a2, a3, d4, d5, d6 = LENGTHS[name]
    table = ((d1, 0, 90), (0, a2, 0), (0, a3, 0), (d4, 0, 90), (d5, 0, -90), (d6, 0, 0))
    pose = np.eye(4)
    for angle, (d, a, alpha) in zip(q, table, strict=True):
        turn = transform(Rotation.from_euler("z", angle).as_matrix(), np.array([0.0, 0.0, d]))
        twist = transform(Rotation.from_euler("x", alpha, degrees=True).as_matrix(), np.array([a, 0.0, 0.0]))
        pose = pose @ turn @ twist
    return pose


@pytest.mark.parametrize("name", ARMS)
@given(joints)
def test_forward_is_the_product_of_the_table(name: str, q: np.ndarray) -> None:
    np.testing.assert_allclose(ARMS[name].kinematics.forward(q), product_of_table(name, q), atol=1e-12)


@given(arms, joints)
def test_the_last_link_frame_is_the_flange(kinematics: Kinematics, q: np.ndarray) -> None:
    np.testing.assert_allclose(kinematics.link_frames(q)[-1], kinematics.forward(q), atol=1e-12)


@given(arms, arrays(np.float64, (3, 6), elements=st.floats(-3.1, 3.1, allow_nan=False)))
def test_a_batch_is_its_members(kinematics: Kinematics, q: np.ndarray) -> None:
    np.testing.assert_allclose(kinematics.forward(q)[1], kinematics.forward(q[1]), atol=1e-12)


def test_torch_gives_what_numpy_gives() -> None:
    import torch

    q = np.random.default_rng(0).uniform(-3, 3, (20, 6))
    pose = UR7E.forward(torch.tensor(q), torch)
    np.testing.assert_allclose(pose.numpy(), UR7E.forward(q), atol=1e-12)
    for branch in BRANCHES:
        with np.errstate(invalid="ignore"):
            expected = UR7E.inverse_branch(UR7E.forward(q), branch)
        np.testing.assert_allclose(UR7E.inverse_branch(pose, branch, torch).numpy(), expected, atol=1e-6)


@given(arms, joints)
def test_axes_are_those_of_the_frames_before_each_joint(kinematics: Kinematics, q: np.ndarray) -> None:
    before = np.concatenate([np.eye(4)[None], kinematics.link_frames(q)[:-1]])
    axes, points = kinematics.joint_axes(q)
    np.testing.assert_allclose(axes, before[:, :3, 2], atol=1e-12)
    np.testing.assert_allclose(points, before[:, :3, 3], atol=1e-12)


@given(arms, joints, st.sampled_from(BRANCHES), st.floats(0.5, 2.0))
def test_one_pose_has_the_solution_of_a_batch_of_one(
    kinematics: Kinematics, q: np.ndarray, branch: tuple[int, int, int], further: float
) -> None:
    """Plain floats against arrays, also where the branch does not reach."""
    pose = kinematics.forward(q)
    pose[:3, 3] *= further
    with np.errstate(invalid="ignore"):
        batch = kinematics.inverse_branch(pose[None], branch)[0]
    one = kinematics.inverse_branch(pose, branch)
    assert np.isfinite(batch).all() == np.isfinite(one).all()
    if np.isfinite(one).all():
        # At a singular pose rounding decides what of a turn is whose; elsewhere, and beyond a turn, they agree.
        np.testing.assert_allclose(kinematics.forward(one), kinematics.forward(batch), atol=1e-6)


@given(arms, joints, st.sampled_from(BRANCHES))
def test_every_branch_that_answers_reaches_the_pose(
    kinematics: Kinematics, q: np.ndarray, branch: tuple[int, int, int]
) -> None:
    pose = kinematics.forward(q)
    with np.errstate(invalid="ignore"):
        solution = kinematics.inverse_branch(pose, branch)
    if np.all(np.isfinite(solution)):
        np.testing.assert_allclose(kinematics.forward(solution), pose, atol=1e-6)


@given(arms, joints)
def test_inverse_reaches_the_pose_and_stays_at_its_seed(kinematics: Kinematics, q: np.ndarray) -> None:
    assume(abs(np.sin(q[4])) > 1e-3)  # else the next test
    pose = kinematics.forward(q)
    solution = kinematics.inverse(pose, seed=q)
    np.testing.assert_allclose(kinematics.forward(solution), pose, atol=1e-6)
    # The seed is itself a solution, so a nearest one differs by no more than where the elbow is stretched.
    np.testing.assert_allclose(solution, q, atol=1e-3)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("wrist", [0.0, 1e-9, 1e-5, np.pi, -np.pi])
def test_aligned_wrist_axes_are_solved_or_refused_never_missed(wrist: float, name: str) -> None:
    kinematics, solved = ARMS[name].kinematics, 0
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


@pytest.mark.parametrize("kinematics", [arm.kinematics for arm in ARMS.values()], ids=ARMS)
def test_a_stretched_elbow_is_solved(kinematics: Kinematics) -> None:
    q = np.array([0.3, -1.2, 0.0, -0.4, 1.1, 0.2])
    pose = kinematics.forward(q)
    np.testing.assert_allclose(kinematics.forward(kinematics.inverse(pose, seed=q)), pose, atol=1e-6)


@pytest.mark.parametrize("position", [(2.0, 0.0, 0.3), (0.0, 0.0, -1.5), (0.02, 0.0, 0.5)])
def test_out_of_reach_is_refused_with_the_place(position: tuple[float, float, float]) -> None:
    down = Rotation.from_euler("x", 180, degrees=True).as_matrix()
    with pytest.raises(MotionError, match=rf"{position[0]:.3f}, {position[1]:.3f}, {position[2]:.3f}"):
        UR7E.inverse(transform(down, np.array(position)), seed=np.zeros(6))


def test_solutions_beyond_the_limits_are_refused() -> None:
    q = np.array([2.0, -1.5, 1.5, -1.5, -1.5, 0.5])
    tight = np.full(6, 0.1)
    with pytest.raises(MotionError):
        UR7E.inverse(UR7E.forward(q), seed=q, limit=tight)


@given(arms, joints, st.integers(-1, 1))
def test_the_turn_of_the_seed_is_kept_where_the_limits_allow(kinematics: Kinematics, q: np.ndarray, turns: int) -> None:
    seed = q.copy()
    seed[5] += 2 * np.pi * turns
    assume(abs(np.sin(q[4])) > 1e-3 and abs(seed[5]) < 2 * np.pi - 0.01)
    assert kinematics.inverse(kinematics.forward(q), seed=seed)[5] == pytest.approx(seed[5], abs=1e-3)
