from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core.spatial import matrix_from_quat, quat_from_matrix, quat_from_yaw, rotation_about, yaw_of
from resync_robot.core.symbols import SE2, SE3, Type
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.learning import features
from resync_robot.learning.features import perturb
from resync_robot.sim_training.domains.cornered_insertion_s.corner import RELATIONS

angles = st.floats(-3.1, 3.1)
offsets = st.floats(-0.4, 0.4)


def relative_features(types: tuple[Type, ...], rows: tuple[np.ndarray, ...]) -> np.ndarray:
    return features.relative_features(types, rows, RELATIONS)


def block(x: float, y: float, yaw: float, z: float = 0.0225) -> np.ndarray:
    return np.array([[x, y, z, *quat_from_yaw(yaw), 0.06, 0.06, 0.045]])


def box(inner_x: float = 0.3, inner_y: float = 0.3) -> np.ndarray:
    return np.array([[0, 0, 0, *quat_from_yaw(0.0), inner_x, inner_y, 0.11, 0.03]])


def robot() -> np.ndarray:
    return np.array([[0.4, 0.1, 0.3, 0.0, 1.0, 0.0, 0.0, 0.1]])


def moved(rows: np.ndarray, angle: float, shift: tuple[float, float]) -> np.ndarray:
    """The same object after the whole scene was turned about the vertical and shifted."""
    rotation, result = rotation_about("z", angle), rows.copy()
    result[:, :3] = rows[:, :3] @ rotation.T + [*shift, 0]
    result[:, 3:7] = quat_from_matrix(rotation @ matrix_from_quat(rows[:, 3:7]))
    return result


PAIRS = [
    ((BLOCK, BOX), block(0.1, 0.05, 0.4), box(0.3, 0.26)),
    ((BLOCK, BLOCK), block(0.1, 0.05, 0.4), block(-0.1, 0.02, 1.0)),
    ((ROBOT, BLOCK), robot(), block(-0.1, 0.02, 1.0)),
    ((ROBOT, BOX), robot(), box()),
    ((BOX, BLOCK), box(), block(-0.1, 0.02, 1.0)),
]


@pytest.mark.parametrize(
    ("types", "a", "b"), PAIRS, ids=lambda p: "-".join(t.name for t in p) if isinstance(p, tuple) else ""
)
@given(angle=angles, shift=st.tuples(offsets, offsets))
@settings(max_examples=20, deadline=None)
def test_pairs_do_not_see_where_the_scene_lies(types, a, b, angle, shift) -> None:
    here = relative_features(types, (a, b))
    there = relative_features(types, (moved(a, angle, shift), moved(b, angle, shift)))
    np.testing.assert_allclose(here, there, atol=1e-9)


@given(x=offsets, y=offsets, yaw=angles)
@settings(max_examples=60, deadline=None)
def test_every_corner_of_a_square_box_is_the_same(x: float, y: float, yaw: float) -> None:
    def seen(x: float, y: float, yaw: float) -> np.ndarray:
        return relative_features((BLOCK, BOX), (block(x, y, yaw), box()))

    reference = seen(x, y, yaw)
    np.testing.assert_allclose(seen(-y, x, yaw + np.pi / 2), reference, atol=1e-9)  # a quarter turn
    np.testing.assert_allclose(seen(-x, y, -yaw), reference, atol=1e-9)  # a mirror
    np.testing.assert_allclose(seen(y, x, np.pi / 2 - yaw), reference, atol=1e-9)  # the diagonal


@given(x=offsets, y=offsets, yaw=angles)
@settings(max_examples=30, deadline=None)
def test_an_oblong_box_knows_its_long_side(x: float, y: float, yaw: float) -> None:
    oblong = relative_features((BLOCK, BOX), (block(x, y, yaw), box(0.4, 0.3)))
    turned_box = relative_features((BLOCK, BOX), (block(-y, x, yaw + np.pi / 2), box(0.3, 0.4)))
    np.testing.assert_allclose(oblong, turned_box, atol=1e-9)


def test_unary_nullary_triple_and_unknown_types() -> None:
    lid = Type("lid", (*SE3, "open"), pose=SE3)
    lids = np.array([[0.0, 0, 0, 1, 0, 0, 0, 0.5], [0.1, 0, 0, 1, 0, 0, 0, 0.7]])
    blocks = np.repeat(block(0.1, 0.0, 0.0), 2, 0)
    assert relative_features((lid,), (lids,)).shape[0] == 2
    assert relative_features((lid, BLOCK), (lids, blocks)).shape[0] == 2
    assert relative_features((lid, BLOCK, BLOCK), (lids, blocks, blocks)).shape[0] == 2
    switch = Type("switch", ("on",))
    assert relative_features((switch, BLOCK), (np.ones((2, 1)), blocks)).shape == (2, 10)


def test_noise_has_the_size_of_perception_and_spares_the_robot() -> None:
    many = np.repeat(block(0.1, 0.2, 0.5), 20_000, 0)
    noisy = perturb(BLOCK, many, np.random.default_rng(0))
    error = noisy[:, :3] - many[:, :3]
    np.testing.assert_allclose(error.std(0), 0.002, rtol=0.05)
    np.testing.assert_allclose(np.rad2deg((yaw_of(noisy[:, 3:7]) - 0.5).std()), 0.5, rtol=0.05)
    np.testing.assert_allclose(np.linalg.norm(noisy[:, 3:7], axis=1), 1.0)
    np.testing.assert_array_equal(noisy[:, 7:], many[:, 7:])
    np.testing.assert_array_equal(perturb(ROBOT, robot(), np.random.default_rng(0)), robot())
    np.testing.assert_array_equal(noisy, perturb(BLOCK, many, np.random.default_rng(0)))


def test_noise_goes_where_the_pose_is_declared() -> None:
    puck = Type("puck", (*SE2, "radius"), pose=SE2)
    many = np.tile([1.0, 2.0, 0.5, 0.1], (20_000, 1))
    error = perturb(puck, many, np.random.default_rng(0)) - many
    np.testing.assert_allclose(error.std(0), [0.002, 0.002, np.deg2rad(0.5), 0.0], rtol=0.05)
    for spared in (Type("car", SE2, pose=SE2, exact=True), Type("timer", ("x", "y", "theta"))):
        np.testing.assert_array_equal(perturb(spared, many[:, :3], np.random.default_rng(0)), many[:, :3])


@given(x=st.floats(-0.5, 0.5), y=st.floats(0.2, 0.5), other=st.floats(-0.5, 0.5))
def test_outside_of_a_box_its_walls_look_the_same_from_everywhere(x: float, y: float, other: float) -> None:
    seen = [relative_features((BLOCK, BOX), (block(at, y, 0.0), box())) for at in (x, other)]
    np.testing.assert_allclose(seen[0][:, :2], seen[1][:, :2])
    inside = relative_features((BLOCK, BOX), (block(0.0, 0.0, 0.0), box()))
    assert not np.allclose(seen[0][:, :2], inside[:, :2])


@given(gap=st.floats(0.0, 0.05), size=st.floats(0.045, 0.07), inner=st.floats(0.26, 0.34), yaw=angles)
def test_the_gap_to_a_wall_is_seen_whatever_the_sizes_and_headings(
    gap: float, size: float, inner: float, yaw: float
) -> None:
    half = size / 2 * (abs(np.cos(yaw)) + abs(np.sin(yaw)))
    at = block(inner / 2 - half - gap, 0.0, yaw)
    at[0, 7:9] = size
    assert relative_features((BLOCK, BOX), (at, box(inner, 0.5)))[0, 0] == pytest.approx(gap, abs=1e-9)
