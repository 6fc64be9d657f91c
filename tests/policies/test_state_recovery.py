"""The recovery skill around its networks: approach, decide at 10 Hz, stop when beta says so, get out of the way."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from resync_robot.core.skill import SkillEnd, SkillOutcome
from resync_robot.learning.recovery_policy import LOWEST_TIP, OBSERVATION_SIZE, STEP
from resync_robot.planning.skill_run import run_skill
from resync_robot.policies.grasp import travel_height
from resync_robot.policies.scripted import scripted_skills
from resync_robot.policies.state_recovery import (
    DECISION_STEPS,
    RATE_HZ,
    SUREST,
    UNMOVED,
    RecoverySkillSettings,
    recovery_skill,
    skill_from,
    sure_enough,
)
from resync_robot.sim_training.domains.cornered_insertion_s.domain import holding
from resync_robot.sim_training.physics.world import SimWorld
from tests import scenes
from tests.libraries import recovery_record
from tests.policies.followers import RIG, Follower
from tests.scenes import B0, B1, ON_THE_TABLE, THE_BOX, R

SCENE = scenes.scene({"b0": (scenes.CORNER, scenes.CORNER), "b1": (0.0, 0.0)}).initial
SETTINGS = RecoverySkillSettings(max_decisions=6)


def run(
    act: Callable[[Tensor], Tensor],
    done: Callable[[Tensor], Tensor],
    settings: RecoverySkillSettings = SETTINGS,
    begun: float = 0.0,
) -> tuple[SkillOutcome, Follower]:
    world = Follower(SCENE, time=begun)
    skill = skill_from("Recover", act, done, RIG, settings)
    return run_skill(world, skill.ground((R, B0, THE_BOX))), world


def never(seen: Tensor) -> Tensor:
    assert seen.shape == (1, OBSERVATION_SIZE)
    return torch.zeros(1)


def after(decisions: int) -> Callable[[Tensor], Tensor]:
    asked = iter(range(1000))
    return lambda seen: torch.tensor([float(next(asked) >= decisions)])


def still(seen: Tensor) -> Tensor:
    return torch.zeros(1, 3)


def down(seen: Tensor) -> Tensor:
    return torch.tensor([[0.0, 0.0, -1.0]])


def test_it_begins_over_the_block_with_closed_fingers_and_ends_high() -> None:
    outcome, world = run(still, after(2))
    assert outcome == SkillOutcome(SkillEnd.DONE)
    block = SCENE.get(B0, "x", "y", "z")
    start = block + [0, 0, scenes.HEIGHT / 2 + 0.012 + SETTINGS.approach_height]
    closest = min(world.tips, key=lambda tip: float(np.linalg.norm(tip - start)))
    np.testing.assert_allclose(closest, start, atol=1e-4)
    assert world.tips[-1][2] >= travel_height(SCENE, None) - 1e-3
    assert world.opening == pytest.approx(0.0)
    assert world.limits == [SETTINGS.effort_limit, None]


@pytest.mark.parametrize(("probability", "ending"), [(0.9, SkillEnd.TIMEOUT), (0.97, SkillEnd.DONE)])
def test_an_attempt_that_has_moved_nothing_is_done_only_where_that_is_all_but_certain(
    probability: float, ending: SkillEnd
) -> None:
    outcome, _ = run(still, lambda seen: torch.tensor([probability]))
    assert outcome.ending is ending


@given(st.floats(0.0, 1.0), st.floats(0.0, 0.1))
def test_how_sure_an_attempt_has_to_be_hangs_on_whether_it_moved_its_block(sure: float, moved: float) -> None:
    needed = sure_enough(sure, np.array([0.0, moved]))
    assert needed == (sure if moved > UNMOVED else max(sure, SUREST))


def test_without_beta_it_gives_up_after_its_decisions() -> None:
    outcome, world = run(still, never)
    assert outcome.ending is SkillEnd.TIMEOUT and "b0" in outcome.reason
    assert world.tips[-1][2] >= travel_height(SCENE, None) - 1e-3


def test_a_policy_that_leads_nowhere_is_followed_with_noise_other_noise_each_time() -> None:
    """Else it would stand still in the same place until it gives up, in each attempt anew."""
    patient = RecoverySkillSettings(max_decisions=12, patience=6)
    impatient = [run(still, never, patient, begun)[1].tips for begun in (0.0, 5.0)]
    calm = run(still, never, RecoverySkillSettings(max_decisions=12))[1].tips
    begins = next(i for i, (a, b) in enumerate(zip(impatient[0], calm, strict=False)) if not np.allclose(a, b))
    # Half of the decisions, and the way up, are behind the first one with noise.
    assert begins >= len(calm) - 12 * DECISION_STEPS - 120
    wandered = np.ptp(np.array(impatient[0][begins : begins + 6 * DECISION_STEPS]), axis=0)
    assert np.all(wandered > 0.001)
    assert any(not np.allclose(a, b) for a, b in zip(*impatient, strict=False))


def test_with_something_between_the_pads_it_refuses_and_stays_where_it_is() -> None:
    world = Follower(SCENE, between=0.06)
    begun = world.rig.tip_pose(world.arm)[:3, 3]
    outcome = run_skill(world, skill_from("Recover", still, never, RIG, SETTINGS).ground((R, B0, THE_BOX)))
    assert outcome.ending is SkillEnd.REFUSED and "60 mm apart" in outcome.reason
    np.testing.assert_allclose(world.tips, np.tile(begun, (len(world.tips), 1)), atol=1e-6)


def test_a_block_on_the_table_is_refused_for_the_tips_stay_over_the_box() -> None:
    world = Follower(scenes.scene(ON_THE_TABLE).initial)
    outcome = run_skill(world, skill_from("Recover", still, never, RIG, SETTINGS).ground((R, B0, THE_BOX)))
    assert outcome.ending is SkillEnd.REFUSED and "b0 is not in box" in outcome.reason


def test_a_heavy_block_stays_in_the_hand_that_refuses() -> None:
    world = SimWorld(scenes.scene({"b0": (-0.07, -0.06), "b1": (0.075, 0.06)}, masses={"b0": 0.18, "b1": 0.1}), RIG)
    pick = next(s for s in scripted_skills(RIG) if s.name == "Pick")
    assert run_skill(world, pick.ground((R, B0))).done
    recover = skill_from("Recover", still, never, RIG, SETTINGS)
    assert run_skill(world, recover.ground((R, B1, THE_BOX))).ending is SkillEnd.REFUSED
    assert holding(world.perceive(), (R, B0))


def test_a_decision_lasts_a_tenth_of_a_second_and_moves_at_most_a_step() -> None:
    decided: list[int] = []

    def act(seen: Tensor) -> Tensor:
        decided.append(1)
        return torch.tensor([[-1.0, 1.0, -1.0]])

    _, world = run(act, after(3))
    assert len(decided) == 3
    seconds = DECISION_STEPS / RATE_HZ
    assert seconds == pytest.approx(0.1)
    world_steps = np.diff(np.array(world.tips), axis=0)
    assert np.abs(world_steps).max() <= max(SETTINGS.travel_speed / RATE_HZ, STEP / DECISION_STEPS) * 1.01


def test_the_tip_is_never_sent_below_its_floor() -> None:
    _, world = run(down, never)
    assert min(tip[2] for tip in world.tips) >= scenes.FLOOR + LOWEST_TIP - 1e-6


def test_a_record_becomes_a_skill_that_runs() -> None:
    skill = recovery_skill("Recover", recovery_record(), RIG, RecoverySkillSettings(max_decisions=2))
    assert skill.live_state and [t.name for t in skill.types] == ["robot", "block", "box"]
    outcome = run_skill(Follower(SCENE), skill.ground((R, B0, THE_BOX)))
    assert outcome.ending in (SkillEnd.DONE, SkillEnd.TIMEOUT)
