"""Atoms over samples of what the poses may be: sure where all agree, false where they do not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from resync_robot.core.state import State
from resync_robot.core.symbols import Object, Predicate
from resync_robot.core.vocabulary import BLOCK
from resync_robot.deployment.uncertain_atoms import SampledAbstraction, SamplingSettings, objects_in, samples
from resync_robot.planning.abstract import Abstraction, Not
from resync_robot.planning.atom_beliefs import AtomBeliefs
from tests import scenes

LEFT = Predicate("Left", (BLOCK,))
EDGE, SIGMA = 0.480, 0.002
B0, B1 = scenes.B0, scenes.B1


def left(state: State, objects: tuple[Object, ...]) -> float:
    return float(state.get(objects[0], "x")[0] < EDGE)


GIVEN = Abstraction((LEFT, Not(LEFT).predicate), {"Left": left, Not(LEFT).predicate.name: Not(LEFT)})
NOT_LEFT = Not(LEFT).predicate


def believed(x: float, sigma: float = SIGMA) -> State:
    """b0 at `x` with that sigma; b1 far to the left, known as well."""
    true = scenes.scene({"b0": (0.0, 0.0), "b1": (-0.1, 0.1)}).initial.with_features(B0, x=x)
    return State(
        {o: true[o] for o in true.objects},
        {B0: np.diag([sigma**2] * 3 + [0] * 7), B1: np.diag([sigma**2] * 3 + [0] * 7)},
    )


def test_samples_have_the_mean_and_covariance_of_the_state() -> None:
    state = believed(0.5)
    drawn = np.array([s[B0] for s in samples(state, 4000)])
    np.testing.assert_allclose(drawn.mean(axis=0), state[B0], atol=2e-4)
    np.testing.assert_allclose(np.cov(drawn.T)[:3, :3], state.covariance(B0)[:3, :3], atol=4e-7)
    np.testing.assert_allclose(np.linalg.norm(drawn[:, 3:7], axis=1), 1.0)
    assert all(np.array_equal(s[scenes.THE_BOX], state[scenes.THE_BOX]) for s in samples(state, 3))


@given(st.floats(-3.0, 3.0))
def test_the_share_is_the_probability_that_the_pose_gives_it(away: float) -> None:
    doubting = SampledAbstraction(GIVEN, SamplingSettings(samples=1000))
    share = doubting.shares(believed(EDGE - away * SIGMA))[LEFT(B0)]
    assert share == pytest.approx(norm.cdf(away), abs=0.06)


def test_near_the_edge_neither_an_atom_nor_its_negation_holds() -> None:
    doubting = SampledAbstraction(GIVEN)
    near = believed(EDGE - 0.2 * SIGMA)
    assert set(doubting.doubtful(near)) == {LEFT(B0), NOT_LEFT(B0)}
    assert objects_in(doubting.doubtful(near)) == (B0,)
    assert doubting.true_atoms(near) == {LEFT(B1)}
    # Looking better at the same place decides it.
    assert doubting.doubtful(believed(EDGE - 0.2 * SIGMA, SIGMA / 20)) == {}
    assert LEFT(B0) in doubting.true_atoms(believed(EDGE - 0.2 * SIGMA, SIGMA / 20))


def test_far_from_the_edge_nothing_is_in_doubt() -> None:
    doubting = SampledAbstraction(GIVEN)
    for x, atom in ((EDGE - 5 * SIGMA, LEFT(B0)), (EDGE + 5 * SIGMA, NOT_LEFT(B0))):
        assert doubting.doubtful(believed(x)) == {}
        assert atom in doubting.true_atoms(believed(x))


def test_the_likelier_side_is_what_a_plan_may_rely_on_where_it_must() -> None:
    for away, likelier in ((-0.4, LEFT(B0)), (0.4, NOT_LEFT(B0))):
        beliefs = AtomBeliefs({})
        beliefs.perceived(SampledAbstraction(GIVEN).shares(believed(EDGE + away * SIGMA)))
        assert beliefs.certain() == {LEFT(B1)} and beliefs.likely().keys() == {likelier}


def test_draws_hang_on_the_name_alone_and_vary_smoothly_with_the_covariance() -> None:
    true = believed(0.5)
    alone = State({B1: true[B1]}, {B1: true.covariance(B1)})
    assert np.array_equal([s[B1] for s in samples(true, 5)], [s[B1] for s in samples(alone, 5)])
    # Equal variances have no axes of their own; a touch of correlation either way gives them opposite ones.
    drawn = []
    for touch in (1e-12, -1e-12):
        covariance = np.diag([SIGMA**2] * 3 + [0.0] * 7)
        covariance[0, 1] = covariance[1, 0] = touch
        state = State({o: true[o] for o in true.objects}, {B0: covariance})
        drawn.append(np.array([s[B0] for s in samples(state, 20)]))
    np.testing.assert_allclose(drawn[0], drawn[1], atol=1e-7)


def test_a_state_that_is_exact_is_judged_as_before() -> None:
    exact = scenes.scene({"b0": (0.0, 0.0), "b1": (-0.1, 0.1)}).initial
    doubting = SampledAbstraction(GIVEN)
    assert doubting.abstract(exact) == GIVEN.abstract(exact)
    assert doubting.doubtful(exact) == {}
