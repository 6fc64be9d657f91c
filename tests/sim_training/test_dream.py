"""Dreams put each block in turn before and after the recovery, and keep what failed as well as what worked."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from resync_robot.core.rig import load_rig
from resync_robot.core.trajectory import Trajectory, Transition
from resync_robot.core.vocabulary import BLOCK
from resync_robot.learning.failures import PairGaussian
from resync_robot.library_models import model_with_recovery
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.dream import (
    COMBINATIONS,
    REFERENCES,
    DreamSpec,
    dream,
    dream_specs,
    dream_task,
    recover,
    useful,
)
from tests import scenes
from tests.libraries import DOMAIN, recovery_record
from tests.scenes import B0, B1, THE_BOX, R

RIG, CORNERED = load_rig(), find_domain(DOMAIN)
MODEL = model_with_recovery(CORNERED, RIG, recovery_record())
TIGHT = np.diag([1e-8, 1e-8, 1e-6, 1e-6])
GAUSSIANS = {
    "before": PairGaussian(np.array([0.0015, 0.0025, 1.0, 0.0]), TIGHT),
    "after": PairGaussian(np.array([0.050, 0.055, 1.0, 0.0]), TIGHT),
}


def test_every_combination_gets_the_same_quota_and_its_own_seed() -> None:
    specs = dream_specs(12, 5, 100)
    assert len(COMBINATIONS) == 6
    assert Counter((s.when, s.reference) for s in specs) == {**dict.fromkeys(COMBINATIONS, 2), ("attempt", ""): 5}
    assert [s.seed for s in specs] == list(range(100, 117))
    assert {s.source for s in specs} == {f"{w}@{r}" for w, r in COMBINATIONS} | {"attempt"}


@pytest.mark.parametrize(("when", "reference"), COMBINATIONS)
def test_the_reference_is_where_its_gaussian_says_and_the_others_are_free(when: str, reference: str) -> None:
    for seed in range(5):
        task = dream_task(DreamSpec(when, reference, seed), CORNERED, GAUSSIANS)
        block = BLOCK(REFERENCES[reference])
        gaps = scenes.in_box(task.initial, block)[:2]
        np.testing.assert_allclose(gaps, GAUSSIANS[when].mean[:2], atol=1e-3)
        for other in set(task.initial.of_type(BLOCK)) - {block}:
            assert scenes.in_box(task.initial, other)[0] < -0.05
        assert block in task.objects and {B0, B1} <= set(task.objects)


def test_a_dream_after_the_recovery_is_solved_without_it() -> None:
    (trajectory,) = dream(DreamSpec("after", "picked", 1), CORNERED, GAUSSIANS, MODEL, RIG)
    assert trajectory.solved and trajectory.source == "after@picked"
    assert [t.skill for t in trajectory.transitions] == ["Pick", "Insert"]


def test_a_dream_before_the_recovery_fails_and_tries_it() -> None:
    (trajectory,) = dream(DreamSpec("before", "picked", 2), CORNERED, GAUSSIANS, MODEL, RIG)
    tried = [(t.skill, t.succeeded) for t in trajectory.transitions]
    assert tried[0] == ("Pick", False)
    # The recovery of this model is random, so what follows fails too; it is kept all the same.
    assert tried[1][0] == "Recover" and trajectory.transitions[1].objects == (R, B0, THE_BOX)
    assert not trajectory.solved


def test_a_dream_of_a_cornered_base_begins_again_with_the_recovery_first() -> None:
    trajectories = dream(DreamSpec("before", "base", 3), CORNERED, GAUSSIANS, MODEL, RIG)
    assert len(trajectories) == 2
    stuck, again = trajectories
    assert stuck.transitions[-1].skill == "Insert" and not stuck.solved
    assert again.transitions[0].skill == "Recover" and again.transitions[0].objects == (R, B1, THE_BOX)
    assert again.transitions[0].before == stuck.transitions[0].before


def test_the_recovery_is_for_the_block_of_a_failed_pick() -> None:
    state = scenes.scene({"b0": (0.0, 0.0), "b1": (0.1, 0.1)}).initial
    ground = MODEL.skill("Recover").ground
    assert str(recover(ground, MODEL.skill("Pick").ground((R, B0)), state)) == "Recover(r, b0, box)"
    assert recover(ground, MODEL.skill("Insert").ground((R, B0, B1)), state) is None


def test_what_is_kept_is_counted_by_its_source() -> None:
    state = scenes.scene({"b0": (0.0, 0.0)}).initial
    one = (Transition(state, "Pick", (R, B0), state, False),)
    lived = [
        Trajectory(one, frozenset(), True, "after@picked"),
        Trajectory(one, frozenset(), False, "after@picked"),
        Trajectory((), frozenset(), False, "attempt"),
    ]
    kept, counts = useful(lived)
    assert kept == lived[:2]
    assert counts == {"after@picked": {"dreamed": 2, "solved": 1}, "attempt": {"dreamed": 1, "solved": 0}}
