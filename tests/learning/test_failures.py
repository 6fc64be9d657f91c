"""Gaussians of any size; the culprit is what was hit and not what was handled."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core.errors import TrainingError
from resync_robot.core.relations import between
from resync_robot.core.state import State
from resync_robot.core.symbols import SE2, Type
from resync_robot.learning.failures import (
    CONTACT_THRESHOLD_N,
    Failure,
    PairGaussian,
    find_culprit,
)
from tests import scenes
from tests.scenes import B0, B1, THE_BOX, R

RESOLUTION = (5e-4, 5e-4, 1e-2, 1e-2)


@pytest.mark.parametrize("size", [1, 3, 8])
def test_a_gaussian_is_sampled_with_its_own_mean_and_spread(size: int) -> None:
    mean, spread = np.linspace(0.01, 0.05, size), np.linspace(1e-3, 2e-3, size)
    gaussian, rng = PairGaussian(mean, np.diag(spread**2)), np.random.default_rng(0)
    samples = np.array([gaussian.sample(rng) for _ in range(2000)])
    np.testing.assert_allclose(samples.mean(0), mean, atol=2e-4)
    np.testing.assert_allclose(samples.std(0), spread, rtol=0.1)


def test_fit_recovers_a_gaussian_and_json_keeps_it() -> None:
    rng = np.random.default_rng(0)
    truth = PairGaussian(np.array([0.02, 0.06, 0.8, 0.1]), np.diag([1e-4, 1e-4, 1e-2, 1e-2]))
    data = rng.multivariate_normal(truth.mean, truth.covariance, 3000)
    fitted = PairGaussian.fit(list(data), RESOLUTION)
    np.testing.assert_allclose(fitted.mean, truth.mean, atol=5e-3)
    np.testing.assert_allclose(np.diag(fitted.covariance), np.diag(truth.covariance), rtol=0.15)
    back = PairGaussian.from_json(fitted.to_json())
    assert np.array_equal(back.mean, fitted.mean) and np.array_equal(back.covariance, fitted.covariance)


def test_samples_that_agree_can_still_be_drawn_from() -> None:
    fitted = PairGaussian.fit([np.array([0.001, 0.002, 1.0, 0.0])] * 3, RESOLUTION)
    assert fitted.sample(np.random.default_rng(0))[:2] == pytest.approx((0.001, 0.002), abs=0.003)
    one = PairGaussian.fit([np.ones(1)] * 3, (1e-3,))
    assert one.covariance == pytest.approx(1e-6)


def test_failures_in_the_plane_are_drawn_anew_beside_another_object_elsewhere() -> None:
    wall, puck = Type("wall", SE2, pose=SE2, symmetry=2), Type("puck", (*SE2, "mass"), pose=SE2)
    relation, rng = between(wall, puck), np.random.default_rng(0)
    pucks = np.column_stack([rng.uniform(-2, 2, (40, 2)), rng.uniform(-3, 3, 40), np.ones(40)])
    wanted = np.array([0.3, -0.1, np.cos(0.8), np.sin(0.8)])
    failed = np.stack([relation.place(np.zeros(3), p, wanted + rng.normal(0, 0.01, 4), rng) for p in pucks])
    gaussian = PairGaussian.fit(list(relation.see(failed, pucks)), relation.resolution)
    np.testing.assert_allclose(gaussian.mean, wanted, atol=0.01)
    there = np.array([9.0, -7.0, 1.0, 2.0])
    again = np.stack([relation.place(np.zeros(3), there, gaussian.sample(rng), rng) for _ in range(400)])
    apart = np.linalg.norm(again[:, :2] - there[:2], axis=1)
    assert apart.mean() == pytest.approx(np.hypot(0.3, 0.1), abs=5e-3) and 0.005 < apart.std() < 0.02
    # The wall has two headings that look the same; both are drawn.
    turned = (again[:, 2] - there[2] - 0.4) % (2 * np.pi)
    assert 0.3 < np.mean(np.abs(turned - np.pi) < 0.5) < 0.7


@pytest.mark.parametrize(
    ("mean", "covariance"),
    [([0.0], [1.0]), ([], []), (0.0, 1.0), ([0.0, 0.0], [[1.0]]), ([0.0], [[np.nan]]), ([0.0], [[-1.0]])],
)
def test_what_is_no_gaussian_cannot_be_read(mean: object, covariance: object) -> None:
    with pytest.raises(ValueError):
        PairGaussian.from_json({"mean": mean, "covariance": covariance})


def test_a_gaussian_of_other_columns_is_refused() -> None:
    data = PairGaussian(np.zeros(3), np.eye(3)).to_json()
    assert PairGaussian.from_json(data, 3).mean.shape == (3,)
    with pytest.raises(ValueError, match="4 and 4 x 4 numbers"):
        PairGaussian.from_json(data, 4)


def test_two_failures_make_no_gaussian() -> None:
    with pytest.raises(TrainingError, match="three"):
        PairGaussian.fit([np.zeros(4)] * 2, RESOLUTION)


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


def test_the_nearest_argument_is_found_in_the_plane_and_may_have_no_place() -> None:
    car, puck, timer = Type("car", SE2, pose=SE2, exact=True), Type("puck", SE2, pose=SE2), Type("timer", ("left",))
    objects = (car("c"), timer("t"), puck("far"), puck("near"))
    state = State(
        {
            car("c"): np.zeros(3),
            timer("t"): np.zeros(1),
            puck("far"): np.array([2.0, 0.0, 0.0]),
            puck("near"): np.array([0.9, 0.0, 0.0]),
            puck("wall"): np.array([1.0, 0.0, 3.0]),
        }
    )
    culprit = find_culprit([Failure(state, "Push", objects, {puck("wall"): HARD})], frozenset({car("c")}))
    assert culprit.relevant_argument == 3
    culprit = find_culprit([Failure(state, "Push", objects, {timer("late"): HARD})], frozenset({car("c")}))
    assert culprit.relevant_argument == 1, "nothing is nearer to what has no place; the robot is never meant"


@pytest.mark.parametrize("contacts", [{}, {"box": SOFT}, {"b0": HARD}, {"r": HARD}])
def test_failures_that_no_contact_explains_are_an_error(contacts: dict[str, float]) -> None:
    with pytest.raises(TrainingError, match="1 failures"):
        find_culprit([failure(**contacts)], frozenset({R}))
