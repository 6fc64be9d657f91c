"""Mining finds the failure that physics makes, names what was hit, and makes more of the same."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core.rig import load_rig
from resync_robot.learning.failures import PairGaussian, find_culprit
from resync_robot.library_models import initial_model
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.mine import attempt_task, is_at_rest, resample_failure
from resync_robot.sim_training.physics.world import SimWorld
from tests import scenes
from tests.libraries import DOMAIN
from tests.scenes import B0, B1, CORNER, THE_BOX, R

RIG, CORNERED = load_rig(), find_domain(DOMAIN)
MODEL = initial_model(CORNERED, RIG)
GOAL = frozenset({CORNERED.predicate("On")(B0, B1)})


def test_a_cornered_pick_is_a_failure_with_its_contacts_and_the_state_before() -> None:
    task = scenes.scene({"b0": (CORNER, -CORNER), "b1": (-0.03, 0.02)}, GOAL)
    attempt = attempt_task(task, MODEL, RIG)
    failure = attempt.failure
    assert (failure.skill, failure.objects) == ("Pick", (R, B0))
    np.testing.assert_allclose(failure.state[B0][:3], task.initial[B0][:3], atol=3e-3)
    assert max(failure.contacts, key=failure.contacts.get) == THE_BOX
    assert not attempt.trajectory.solved and len(attempt.trajectory.transitions) == 1
    culprit = find_culprit([failure], frozenset({R}))
    assert (culprit.skill, culprit.failure_object, culprit.relevant_argument) == ("Pick", THE_BOX, 1)


def test_what_works_is_no_failure() -> None:
    attempt = attempt_task(scenes.scene({"b0": (-0.07, -0.06), "b1": (0.075, 0.06)}, GOAL), MODEL, RIG)
    assert attempt.failure is None
    assert attempt.trajectory.solved and [t.skill for t in attempt.trajectory.transitions] == ["Pick", "Insert"]


def test_only_the_first_failure_is_lived_through() -> None:
    # The base is cornered: picking works, inserting does not, and nothing is tried after that.
    attempt = attempt_task(scenes.scene({"b0": (-0.07, -0.06), "b1": (CORNER, CORNER)}, GOAL), MODEL, RIG)
    assert attempt.failure.skill == "Insert"
    assert [t.succeeded for t in attempt.trajectory.transitions] == [True, False]


@pytest.mark.parametrize(("bottom", "rests"), [(scenes.FLOOR, True), (scenes.FLOOR + 0.1, False)])
def test_a_scene_that_does_not_stand_still_is_no_task(bottom: float, rests: bool) -> None:
    task = scenes.scene({"b0": (0.0, 0.0, 0.0, bottom), "b1": (0.1, 0.1)}, GOAL)
    assert is_at_rest(SimWorld(task, RIG)) is rests
    if not rests:
        assert attempt_task(task, MODEL, RIG) is None


def test_resampled_failures_have_the_drawn_pose_and_differ_in_the_rest() -> None:
    gaussian = PairGaussian(np.array([0.0015, 0.0025, 1.0, 0.0]), np.diag([1e-8, 1e-8, 1e-6, 1e-6]))
    tasks = [resample_failure(CORNERED, "s0", B0, THE_BOX, gaussian, seed) for seed in range(20)]
    gaps = np.array([scenes.in_box(t.initial, B0)[:2] for t in tasks])
    np.testing.assert_allclose(gaps.mean(0), [0.0015, 0.0025], atol=2e-4)
    assert len({t.initial[B1].tobytes() for t in tasks}) == 20
    again = resample_failure(CORNERED, "s0", B0, THE_BOX, gaussian, 3)
    assert (again.initial, again.physics, again.seed) == (tasks[3].initial, tasks[3].physics, 3)
