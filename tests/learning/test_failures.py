"""Gaussians of any size; the culprit is what was hit and not what was handled."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core.errors import TrainingError
from resync_robot.core.relations import between
from resync_robot.core.symbols import SE2, Type
from resync_robot.learning.failures import (
    PairGaussian,
)

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
