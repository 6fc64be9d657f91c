"""The model of success where failures say less than successes, for the skill fails for nothing, too."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.learning.success_model import SuccessModel, among_balanced, corrected_loss
from resync_robot.learning.terminals import train_terminal
from resync_robot.sim_training.claims import LATELY, Claims


def attempts(count: int, reliable: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """On the line: nothing obstructs to the right of 0, and nothing succeeds to the left of it."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (count, 1))
    return x, (x[:, 0] > 0) & (rng.random(count) < reliable)


RIGHT, LEFT = np.full((1, 1), 0.7), np.full((1, 1), -0.7)


@pytest.mark.parametrize("reliable", [1.0, 0.6])
def test_it_tells_what_is_free_although_the_skill_fails_for_nothing(reliable: float) -> None:
    model = SuccessModel(1, seed=0)
    x, succeeded = attempts(1200, reliable)
    model.add(x, succeeded)
    free = attempts(2000, reliable, seed=1)
    model.add_free(free[1][free[0][:, 0] > 0])
    assert model.reliability == pytest.approx(reliable, abs=0.05)
    for _ in range(10):
        model.fit()
    assert model.probability(RIGHT)[0] > 0.9 and model.probability(LEFT)[0] < 0.1


def test_without_that_knowledge_it_would_not() -> None:
    model = SuccessModel(1, seed=0)
    model.add(*attempts(1200, 0.6))
    for _ in range(10):
        model.fit()
    assert model.reliability == 1.0 and model.probability(RIGHT)[0] < 0.85


def test_it_travels_with_the_weights() -> None:
    model, other = SuccessModel(1, seed=0), SuccessModel(1, seed=1)
    model.add_free(np.array([True, False, True]))
    other.load(model.weights())
    assert other.reliability == model.reliability == 0.75


def test_a_terminal_function_allows_for_it_as_well() -> None:
    x, succeeded = attempts(1500, 0.6)
    features, labels = torch.as_tensor(x, dtype=torch.float32), torch.as_tensor(succeeded).long()
    plain, _ = train_terminal(features, labels, 0)
    corrected, _ = train_terminal(features, labels, 0, reliability=0.6)
    right = torch.as_tensor(RIGHT, dtype=torch.float32)
    assert plain.probability(right)[0] < 0.85 < 0.9 < corrected.probability(right)[0]


@given(st.floats(0.2, 1.0), st.floats(0.05, 0.95))
def test_among_balanced_outcomes_it_is_bayes_rule(reliability: float, share: float) -> None:
    odds = reliability / max(1 - reliability, 1e-12) * (1 - share) / share
    assert among_balanced(reliability, share) == pytest.approx(odds / (1 + odds), abs=1e-6)


def test_the_loss_of_a_reliable_skill_is_the_usual_one() -> None:
    logits, target = torch.linspace(-3, 3, 7), torch.tensor([0.0, 1, 0, 1, 0, 1, 1])
    usual = torch.nn.functional.binary_cross_entropy_with_logits(logits, target)
    assert corrected_loss(logits, target, 1.0) == pytest.approx(float(usual))
    assert corrected_loss(logits, target, 0.999999) == pytest.approx(float(usual), rel=1e-3)


def test_claims_are_held_to_what_a_skill_that_fails_for_nothing_can_confirm() -> None:
    strict, fair = Claims(0.8, 0.95, 0.75), Claims(0.8, 0.95, 0.75)
    fair.reliability = 0.6
    for i in range(2 * LATELY):
        for claims in (strict, fair):
            claims.heard(i % 10 < 6)
    assert fair.believed and not strict.believed
    assert fair.claimed_from < strict.claimed_from
