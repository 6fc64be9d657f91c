"""Relative poses forget which corner, and give it back; the culprit is what was hit and not what was handled."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from resync_robot.core.errors import TrainingError
from resync_robot.core.state import State
from resync_robot.learning.failures import (
    CONTACT_THRESHOLD_N,
    Failure,
    PairGaussian,
    find_culprit,
    place_relative,
    relative_pose,
)
from tests import scenes
from tests.scenes import B0, B1, THE_BOX, R


def placed(x: float, y: float, yaw: float, box: np.ndarray) -> State:
    return State({B0: scenes.block_features(x, y, yaw, box=box), THE_BOX: box})


@given(
    small=st.floats(0.0, 0.05),
    more=st.floats(1e-6, 0.04),
    angle=st.floats(-0.78, 0.78),
    box_yaw=st.floats(-3, 3),
    seed=st.integers(0, 1000),
)
def test_a_placed_block_has_the_relative_pose_it_was_placed_at(
    small: float, more: float, angle: float, box_yaw: float, seed: int
) -> None:
    box = scenes.box_features(box_yaw, (0.29, 0.31))
    size = np.array([scenes.WIDTH, scenes.WIDTH, scenes.HEIGHT])
    wanted = (small, small + more, angle)
    x, y, yaw = place_relative(box, size, wanted, np.random.default_rng(seed))
    found = relative_pose(placed(x, y, yaw, box), B0, THE_BOX)
    np.testing.assert_allclose(found, [small, small + more, np.cos(4 * angle), np.sin(4 * angle)], atol=1e-6)


def test_placing_reaches_every_corner_and_both_axes() -> None:
    rng = np.random.default_rng(0)
    size = np.array([scenes.WIDTH] * 2 + [scenes.HEIGHT])
    places = [place_relative(scenes.box_features(), size, (0.0, 0.06, 0.1), rng) for _ in range(100)]
    corners = {(x > 0, y > 0, abs(x) > abs(y)) for x, y, _ in places}
    assert len(corners) == 8


@given(
    x=st.floats(0.01, 0.11),
    y=st.floats(0.01, 0.11),
    yaw=st.floats(-3, 3),
    quarters=st.integers(0, 3),
    flip=st.sampled_from([(1, 1), (1, -1), (-1, 1), (-1, -1)]),
)
def test_one_corner_stands_for_all(x: float, y: float, yaw: float, quarters: int, flip: tuple[int, int]) -> None:
    # On the diagonal a heading has no sense of turn to keep.
    assume(abs(x - y) > 1e-6)
    box = scenes.box_features()
    here = relative_pose(placed(x, y, yaw, box), B0, THE_BOX)
    mirrored = placed(flip[0] * x, flip[1] * y, flip[0] * flip[1] * yaw + quarters * np.pi / 2, box)
    np.testing.assert_allclose(relative_pose(mirrored, B0, THE_BOX), here, atol=1e-6)
    swapped = placed(y, x, -yaw, box)
    np.testing.assert_allclose(relative_pose(swapped, B0, THE_BOX), here, atol=1e-6)


def test_a_gaussian_is_sampled_with_its_own_mean_and_spread() -> None:
    mean = np.array([0.01, 0.05, np.cos(0.8), np.sin(0.8)])
    gaussian = PairGaussian(mean, np.diag([1e-6, 4e-6, 1e-4, 1e-4]))
    rng = np.random.default_rng(0)
    samples = np.array([gaussian.sample(rng) for _ in range(2000)])
    np.testing.assert_allclose(samples.mean(0), [0.01, 0.05, 0.2], atol=1e-3)
    np.testing.assert_allclose(samples[:, :2].std(0), [1e-3, 2e-3], rtol=0.1)
    assert np.all(samples[:, 0] <= samples[:, 1])
    assert np.all(np.abs(samples[:, 2]) <= np.pi / 4)


def test_fit_recovers_a_gaussian_and_json_keeps_it() -> None:
    rng = np.random.default_rng(0)
    truth = PairGaussian(np.array([0.02, 0.06, 0.8, 0.1]), np.diag([1e-4, 1e-4, 1e-2, 1e-2]))
    data = rng.multivariate_normal(truth.mean, truth.covariance, 3000)
    fitted = PairGaussian.fit(list(data))
    np.testing.assert_allclose(fitted.mean, truth.mean, atol=5e-3)
    np.testing.assert_allclose(np.diag(fitted.covariance), np.diag(truth.covariance), rtol=0.15)
    back = PairGaussian.from_json(fitted.to_json())
    assert np.array_equal(back.mean, fitted.mean) and np.array_equal(back.covariance, fitted.covariance)


def test_samples_that_agree_can_still_be_drawn_from() -> None:
    pose = PairGaussian.fit([np.array([0.001, 0.002, 1.0, 0.0])] * 3).sample(np.random.default_rng(0))
    assert pose[:2] == pytest.approx((0.001, 0.002), abs=0.003)


def test_two_failures_make_no_gaussian() -> None:
    with pytest.raises(TrainingError, match="three"):
        PairGaussian.fit([np.zeros(4)] * 2)


STATE = scenes.scene({"b0": (0.119, 0.119), "b1": (0.0, 0.0)}).initial
HARD, SOFT = CONTACT_THRESHOLD_N + 1, CONTACT_THRESHOLD_N - 1


def failure(skill: str = "Pick", objects: tuple = (R, B0), **contacts: float) -> Failure:
    named = {o.name: o for o in STATE}
    return Failure(STATE, skill, objects, {named[n]: f for n, f in contacts.items()})


def test_the_culprit_is_what_was_hit_most_often() -> None:
    failures = [failure(box=HARD, b1=HARD), failure(box=HARD), failure(b1=SOFT)]
    culprit = find_culprit(failures, frozenset({R}))
    assert (culprit.skill, culprit.failure_object, culprit.relevant_argument) == ("Pick", THE_BOX, 1)


def test_what_the_skill_handles_is_not_to_blame_however_hard_it_was_pressed() -> None:
    failures = [failure("Insert", (R, B1, B0), b0=500.0, b1=500.0, box=HARD)]
    culprit = find_culprit(failures, frozenset({R}))
    assert culprit.failure_object == THE_BOX
    # Neither block is cornered by being an argument: the one nearer to the culprit is the relevant one.
    assert culprit.relevant_argument in (1, 2)


def test_the_relevant_object_is_the_argument_nearest_to_the_culprit() -> None:
    far, near = scenes.scene({"b0": (0.12, 0.12), "b1": (0.02, 0.0)}).initial, (R, B0, B1)
    culprit = find_culprit([Failure(far, "Insert", near, {THE_BOX: HARD})], frozenset({R}))
    assert culprit.relevant_argument == 2


@pytest.mark.parametrize("contacts", [{}, {"box": SOFT}, {"b0": HARD}, {"r": HARD}])
def test_failures_that_no_contact_explains_are_an_error(contacts: dict[str, float]) -> None:
    with pytest.raises(TrainingError, match="1 failures"):
        find_culprit([failure(**contacts)], frozenset({R}))
