"""Relations that know no domain: in the plane and in space, whatever the symmetry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.errors import PlanningError
from resync_robot.core.relations import Relation, alone, between, blank, features, moved, seen
from resync_robot.core.state import State
from resync_robot.core.symbols import ROUND, SE2, SE3, Type

PLANAR = ("width", "depth")
SPATIAL = ("width", "depth", "height")
symmetries = st.sampled_from([ROUND, 1, 2, 4])
poses = st.sampled_from([SE2, SE3])
seeds = st.integers(0, 2**31)


def kind(name: str, pose: tuple[str, ...], symmetry: int, body: bool = True) -> Type:
    extents = (PLANAR if pose == SE2 else SPATIAL) if body else ()
    return Type(name, (*pose, *extents, "mass"), pose=pose, extents=extents, symmetry=symmetry)


def rows(of: Type, rng: np.random.Generator, count: int = 5) -> np.ndarray:
    """Objects anywhere, turned and tilted in any way; a square body is a square."""
    found = rng.uniform(0.1, 1.0, (count, len(of.features)))
    found[:, : of.dimensions] = rng.uniform(-2, 2, (count, of.dimensions))
    if of.pose == SE2:
        found[:, 2] = rng.uniform(-3, 3, count)
    else:
        found[:, 3:7] = rng.normal(size=(count, 4))
        found[:, 3:7] /= np.linalg.norm(found[:, 3:7], axis=1, keepdims=True)
    if of.extents and of.symmetry in (4, ROUND):
        at = len(of.pose)
        found[:, at + 1] = found[:, at]
    return found


def pose_of(of: Type, row: np.ndarray) -> np.ndarray:
    if of.pose == SE3:
        return spatial.pose_from_features(row[:7])
    return spatial.transform(spatial.rotation_about("z", row[2]), np.array([row[0], row[1], 0.0]))


def at_pose(of: Type, row: np.ndarray, pose: np.ndarray) -> np.ndarray:
    if of.pose == SE3:
        return np.concatenate([spatial.features_from_pose(pose), row[7:]])
    return np.concatenate([pose[:2, 3], [np.arctan2(pose[1, 0], pose[0, 0])], row[3:]])


def turned(of: Type, row: np.ndarray, angle: float) -> np.ndarray:
    """The object after a turn about its own z axis."""
    return at_pose(of, row, pose_of(of, row) @ spatial.transform(spatial.rotation_about("z", angle)))


def a_turn(symmetry: int, rng: np.random.Generator) -> float:
    """One after which nothing has changed."""
    return rng.uniform(-3, 3) if symmetry == ROUND else 2 * np.pi / symmetry * rng.integers(symmetry)


@settings(max_examples=60, deadline=None)
@given(poses, symmetries, symmetries, seeds)
def test_what_is_placed_is_seen_as_it_was_wanted(pose: tuple[str, ...], of_a: int, of_b: int, seed: int) -> None:
    a, b, rng = kind("a", pose, of_a), kind("b", pose, of_b), np.random.default_rng(seed)
    relation = between(a, b)
    here, there, elsewhere = rows(a, rng), rows(b, rng), rows(a, rng)
    wanted = relation.see(here, there)
    placed = np.stack(
        [relation.place(row, other, want, rng) for row, other, want in zip(elsewhere, there, wanted, strict=True)]
    )
    np.testing.assert_allclose(relation.see(placed, there), wanted, atol=1e-9)
    np.testing.assert_array_equal(placed[:, len(pose) :], elsewhere[:, len(pose) :])


@settings(max_examples=40, deadline=None)
@given(poses, st.sampled_from([1, 2, 4]), st.sampled_from([1, 2, 4]), seeds)
def test_placing_after_seeing_changes_nothing_but_for_the_symmetry(
    pose: tuple[str, ...], of_a: int, of_b: int, seed: int
) -> None:
    a, b, rng = kind("a", pose, of_a), kind("b", pose, of_b), np.random.default_rng(seed)
    relation, row, other = between(a, b), rows(a, rng, 1)[0], rows(b, rng, 1)[0]
    placed = relation.place(row, other, relation.see(row[None], other[None])[0], rng)
    # Seen from any of b's equal headings, in any of a's own, it is where it was.
    frame = pose_of(b, other)
    here, now = (spatial.inverse(frame) @ pose_of(a, r) for r in (row, placed))
    turns = [
        spatial.transform(spatial.rotation_about("z", 2 * np.pi * i / of_b))
        @ here
        @ spatial.transform(spatial.rotation_about("z", 2 * np.pi * j / of_a))
        for i in range(of_b)
        for j in range(of_a)
    ]
    assert min(np.abs(t - now).max() for t in turns) < 1e-8


def test_placing_reaches_every_heading_that_looks_the_same() -> None:
    a, b, rng = kind("a", SE2, 2), kind("b", SE2, 4), np.random.default_rng(0)
    row, other = np.array([0.5, 0.1, 0.2, 0.1, 0.1, 1.0]), np.array([0.0, 0.0, 0.0, 0.1, 0.1, 1.0])
    relation = between(a, b)
    wanted = relation.see(row[None], other[None])[0]
    placed = {tuple(np.round(relation.place(row, other, wanted, rng)[:3], 6)) for _ in range(200)}
    assert len({p[:2] for p in placed}) == 4 and len(placed) == 8


@settings(max_examples=40, deadline=None)
@given(poses, symmetries, symmetries, seeds)
def test_moving_the_whole_scene_changes_nothing(pose: tuple[str, ...], of_a: int, of_b: int, seed: int) -> None:
    a, b, rng = kind("a", pose, of_a), kind("b", pose, of_b), np.random.default_rng(seed)
    here, there = rows(a, rng), rows(b, rng)
    if pose == SE2:
        motion = spatial.transform(
            spatial.rotation_about("z", rng.uniform(-3, 3)), np.array([*rng.normal(size=2), 0.0])
        )
    else:
        motion = spatial.transform(spatial.rotation_from_vector(rng.normal(size=3)), rng.normal(size=3))
    both = [
        np.stack([at_pose(k, row, motion @ pose_of(k, row)) for row in some]) for k, some in ((a, here), (b, there))
    ]
    np.testing.assert_allclose(features(a, both[0], b, both[1]), features(a, here, b, there), atol=1e-8)
    np.testing.assert_allclose(between(a, b).see(*both), between(a, b).see(here, there), atol=1e-8)


@settings(max_examples=60, deadline=None)
@given(poses, symmetries, symmetries, seeds)
def test_scenes_that_look_the_same_are_seen_as_the_same(pose: tuple[str, ...], of_a: int, of_b: int, seed: int) -> None:
    a, b, rng = kind("a", pose, of_a), kind("b", pose, of_b), np.random.default_rng(seed)
    here, there = rows(a, rng), rows(b, rng)
    again = np.stack([turned(a, row, a_turn(of_a, rng)) for row in here])
    beside = np.stack([turned(b, row, a_turn(of_b, rng)) for row in there])
    np.testing.assert_allclose(features(a, again, b, beside), features(a, here, b, there), atol=1e-8)


def test_other_turns_are_told_apart() -> None:
    a, b, rng = kind("a", SE2, 2), kind("b", SE2, 4), np.random.default_rng(0)
    here, there = rows(a, rng), rows(b, rng)
    before = between(a, b).see(here, there)
    for k, which in ((a, 0), (b, 1)):
        both = [here, there]
        both[which] = np.stack([turned(k, row, np.pi / 3) for row in both[which]])
        assert np.abs(between(a, b).see(*both) - before).max(1).min() > 0.01


PUCK = Type("puck", (*SE2, "radius_x", "radius_y"), pose=SE2, extents=("radius_x", "radius_y"), symmetry=ROUND)
BAR = Type("bar", (*SE2, "length", "thickness"), pose=SE2, extents=("length", "thickness"), symmetry=2)
CAR = Type("car", (*SE2, "activated"), pose=SE2)


def test_a_planar_domain_is_seen_in_the_frame_of_the_other() -> None:
    car, bar = np.array([[1.0, 2.0, np.pi / 2, 1.0]]), np.array([[1.0, 3.0, np.pi, 0.4, 0.2]])
    relation = between(BAR, CAR)
    assert relation.names == ("x", "y", "cos", "sin")
    assert len(relation.names) == len(relation.resolution) == relation.see(bar, car).shape[1]
    # One metre ahead of the car, lying across; a bar has two headings that look the same.
    np.testing.assert_allclose(relation.see(bar, car), [[1.0, 0.0, -1.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(features(BAR, bar, CAR, car), [[1.0, 0.0, -1.0, 0.0, 0.4, 0.2, 1.0]], atol=1e-12)
    far = np.array([[7.0, -5.0]])
    for some in (car, bar):
        some[:, :2] += far
    np.testing.assert_allclose(relation.see(bar, car), [[1.0, 0.0, -1.0, 0.0]], atol=1e-12)


@given(st.floats(0.0, 0.5), st.floats(-3, 3), st.floats(-3, 3))
def test_the_gap_between_two_bodies_is_seen_whatever_their_sizes(gap: float, turn: float, spin: float) -> None:
    size = np.array([0.4, 0.2])
    bar, puck = np.array([[0.3, -0.2, turn, *size]]), np.array([[0.0, 0.0, spin, 0.1, 0.1]])
    puck[0, :2] = bar[0, :2] + (size[0] / 2 + gap + 0.05) * np.array([np.cos(turn), np.sin(turn)])
    columns = len(between(PUCK, BAR).names)
    seen_gaps = features(PUCK, puck, BAR, bar)[0, columns : columns + 2]
    np.testing.assert_allclose(seen_gaps, [gap, -0.15], atol=1e-9)
    # Seen from the puck, which has no sides, the first gap is the one towards the bar.
    across = features(BAR, bar, PUCK, puck)[0, columns]
    assert across == pytest.approx(gap, abs=1e-9)


def test_a_hand_that_points_down_has_a_heading_and_so_has_a_thing_that_lies() -> None:
    hand, thing = kind("hand", SE3, 2, body=False), kind("thing", SE3, 4)
    down = spatial.transform(spatial.rotation_about("x", np.pi), np.array([0.0, 0.0, 0.2]))
    grasp = at_pose(hand, np.zeros(8), spatial.transform(spatial.rotation_about("z", 0.3)) @ down)
    on_its_side = spatial.transform(spatial.rotation_about("y", np.pi / 2 - 0.1), np.array([0.3, 0.1, 0.0]))
    lying = at_pose(thing, np.zeros(11), on_its_side)
    base = at_pose(thing, np.zeros(11), np.eye(4))
    assert between(hand, thing).names == ("x", "y", "z", "up_x", "up_y", "up_z", "cos", "sin")
    wanted = [0, 0, 0.2, 0, 0, -1, np.cos(0.6), np.sin(0.6)]
    np.testing.assert_allclose(between(hand, thing).see(grasp[None], base[None])[0], wanted, atol=1e-9)
    relation, rng = between(thing, thing), np.random.default_rng(0)
    flat = relation.see(lying[None], base[None])[0]
    np.testing.assert_allclose(
        relation.see(relation.place(base, base, flat, rng)[None], base[None])[0], flat, atol=1e-9
    )


def test_nothing_jumps_where_a_square_is_passed_at_its_corner() -> None:
    """A hand goes round a block, and a car round a puck, without turning."""
    hand, block, car = kind("hand", SE3, 2, body=False), kind("block", SE3, 4), kind("car", SE2, 1)
    puck, angles = kind("puck", SE2, ROUND), np.linspace(-np.pi, np.pi, 2001)
    for a, b in ((hand, block), (block, block), (car, puck), (puck, puck)):
        some = np.tile(rows(a, np.random.default_rng(1), 1), (len(angles), 1))
        some[:, :2] = 0.5 * np.stack([np.cos(angles), np.sin(angles)], -1)
        there = np.tile(blank(b), (len(angles), 1))
        steps = np.abs(np.diff(features(a, some, b, there), axis=0))
        assert steps.max() < 0.02


def test_a_hand_over_a_square_knows_how_it_would_grasp() -> None:
    hand, block, rng = kind("hand", SE3, 2, body=False), kind("block", SE3, 4), np.random.default_rng(0)
    columns = len(between(hand, block).names)
    grasps = np.tile(blank(hand), (8, 1))
    grasps[:, :3] = rng.normal(0, 1e-4, (8, 3))
    grasps[:, 3:7] = spatial.quat_from_yaw(0.2 + np.pi / 2 * np.arange(8))
    common = features(hand, grasps, block, np.tile(blank(block), (8, 1)))[:, columns : columns + 2]
    np.testing.assert_allclose(common, np.tile([np.cos(0.8), np.sin(0.8)], (8, 1)), atol=1e-9)


def test_columns_off_the_circle_mean_the_nearest_on_it() -> None:
    relation, rng = between(BAR, CAR), np.random.default_rng(0)
    bar, car = np.array([0.0, 0.0, 0.0, 0.4, 0.2]), np.array([0.0, 0.0, 0.0, 1.0])
    placed = relation.place(bar, car, np.array([0.3, 0.1, 0.6, 0.6]), rng)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(relation.see(placed[None], car[None])[0], [0.3, 0.1, half, half], atol=1e-9)


def _distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a[:, :2] - b[:, :2], axis=1, keepdims=True)


def _at_distance(row: np.ndarray, other: np.ndarray, relative: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    angle = rng.uniform(-np.pi, np.pi)
    return np.array([*(other[:2] + relative[0] * np.array([np.cos(angle), np.sin(angle)])), *row[2:]])


def test_what_a_domain_declares_holds_in_either_order() -> None:
    near = Relation(names=("distance",), resolution=(1e-3,), see=_distance, place=_at_distance)
    declared = {(BAR, CAR): near}
    bar, car = BAR("bar"), CAR("car")
    state = State({bar: np.array([1.0, 1.0, 0.3, 0.4, 0.2]), car: np.array([0.0, 0.0, 0.5, 1.0])})
    assert seen(state, bar, car, declared) == seen(state, car, bar, declared) == pytest.approx(np.sqrt(2))
    for a, b in ((bar, car), (car, bar)):
        after = moved(state, a, b, np.array([0.7]), np.random.default_rng(0), declared)
        assert seen(after, a, b, declared) == pytest.approx(0.7)
        np.testing.assert_array_equal(after[b], state[b])
    # Without features of its own, a declared relation is given with all that is no pose.
    given_of = features(BAR, state[bar][None], CAR, state[car][None], declared)
    np.testing.assert_allclose(given_of, [[np.sqrt(2), 0.4, 0.2, 1.0]])
    with_own = {(BAR, CAR): Relation(**{**vars(near), "features": lambda a, b: a[:, 3:4] * b[:, 3:4]})}
    assert features(CAR, state[car][None], BAR, state[bar][None], with_own).tolist() == [[0.4]]
    assert features(BAR, state[bar][None], BAR, state[bar][None], with_own).shape == (1, 10), "others as they were"


def test_what_has_no_place_is_seen_and_cannot_be_placed() -> None:
    switch = Type("switch", ("on",))
    state = State({switch("s"): np.ones(1), CAR("car"): np.array([1.0, 2.0, 0.0, 1.0])})
    assert features(switch, np.ones((1, 1)), CAR, state[CAR("car")][None]).tolist() == [[1.0, 1.0, 2.0, 1.0, 0.0, 1.0]]
    assert alone(switch, np.ones((1, 1))).tolist() == [[1.0]] and blank(switch).tolist() == [[0.0]]
    with pytest.raises(PlanningError, match=r"a switch has no place\n.*declare the pose"):
        moved(state, switch("s"), CAR("car"), np.zeros(0), np.random.default_rng(0))


def test_the_plane_and_space_do_not_mix() -> None:
    with pytest.raises(PlanningError, match=r"a car has its pose in 2 dimensions and a thing in 3\n.*SE2 or SE3"):
        between(CAR, kind("thing", SE3, 1))


def test_one_object_is_seen_where_it_is_and_blank_rows_are_accepted() -> None:
    np.testing.assert_allclose(
        alone(BAR, np.array([[1.0, 2.0, np.pi / 2, 0.4, 0.2]])), [[1, 2, -1, 0, 0.4, 0.2]], atol=1e-12
    )
    for pose in (SE2, SE3):
        for symmetry in (ROUND, 1, 4):
            of = kind("a", pose, symmetry)
            assert np.isfinite(features(of, blank(of), of, blank(of))).all() and np.isfinite(alone(of, blank(of))).all()
