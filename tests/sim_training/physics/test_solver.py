"""What is shipped agrees with what is finely solved, where that is hard: a block between a hand and the floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from resync_robot.sim_training.domains import find_domain, world_task
from resync_robot.sim_training.physics.randomise import draw_solver
from resync_robot.sim_training.physics.solver import REFERENCE, SHIPPED, solver_of
from tests.benchmarks.drag_test import FIRST, centred, drag

CORNERED = find_domain("cornered-insertion-s")


def test_a_dragged_block_follows_as_far_as_in_the_reference() -> None:
    tasks = [centred(FIRST + i) for i in range(5)]
    truth, way, coarse = (drag(tasks, s)[0] for s in (REFERENCE, SHIPPED, replace(SHIPPED, iterations=12, inertia=1.0)))
    assert np.abs(truth).max() > 0.03, "it follows"
    error, coarse_error = (float(np.median(np.abs(w - truth) / np.abs(truth))) for w in (way, coarse))
    assert error < 0.15 < 0.3 < coarse_error


def test_the_reference_solves_the_same_worlds() -> None:
    usual, fine = (world_task(CORNERED, "s1", 3, 0, solver=s) for s in (SHIPPED, REFERENCE))
    assert solver_of(usual.physics) == SHIPPED and solver_of(fine.physics) == REFERENCE
    assert fine.initial == usual.initial and {**fine.physics, "solver": 0} == {**usual.physics, "solver": 0}


def test_practice_draws_solvers_around_what_is_shipped() -> None:
    found = [CORNERED.scenario("s0").sample_practice(np.random.default_rng(s), s).physics["solver"] for s in range(40)]
    again = CORNERED.scenario("s0").sample_practice(np.random.default_rng(3), 3).physics["solver"]
    assert again == found[3] and len({s.iterations for s in found}) > 10
    assert {(s.period, s.inertia) for s in found} == {(SHIPPED.period, SHIPPED.inertia)}
    assert min(s.iterations for s in found) < SHIPPED.iterations < max(s.iterations for s in found)


def test_a_draw_is_a_pure_function_of_its_generator() -> None:
    assert draw_solver(np.random.default_rng(1)) == draw_solver(np.random.default_rng(1))


def test_what_is_no_solver_is_told() -> None:
    with pytest.raises(TypeError, match="is a Solver, not a dict"):
        solver_of({"solver": {"iterations": 3}})
