"""A block that goes along with the hand, and pictures that show what cannot be."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.skill import SkillEnd
from resync_robot.learning.camera_view import Prediction
from resync_robot.learning.recovery_policy import STUD, wall_gaps
from resync_robot.planning.skill_run import run_skill
from resync_robot.policies.camera_recovery import camera_recovery_skill
from resync_robot.policies.carried_block import BEYOND, INSIDE, OVER_STUD, ByState, CarriedBlock
from tests import scenes
from tests.policies.followers import RIG
from tests.policies.test_camera_recovery import SCENE, SETTINGS, Scripted, Seeing
from tests.scenes import B0, THE_BOX, R

TOP = float((SCENE.get(B0, "z") + SCENE.get(B0, "size_z") / 2)[0]) + STUD


def block() -> CarriedBlock:
    return CarriedBlock(SCENE, (R, B0, THE_BOX))


def tip_at(x: float, y: float, above: float) -> np.ndarray:
    return np.array([x, y, TOP + above])


@given(
    st.lists(
        st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.sampled_from([-0.002, 0.0, 0.03])), max_size=12
    )
)
def test_it_goes_as_far_as_the_hand_went_while_it_pressed(path: list[tuple[float, float, float]]) -> None:
    carried, pressed = block(), np.zeros(2)
    tips = [tip_at(*place) for place in path]
    for tip in tips:
        carried.carried.follow(tip)
    for before, after in pairwise(tips):
        if max(before[2], after[2]) < TOP + 0.01:
            pressed += (after - before)[:2]
    np.testing.assert_allclose(carried.carried.away, pressed, atol=1e-12)


def test_what_leaned_and_fell_back_came_along_no_further_than_where_it_stood() -> None:
    carried = block().carried
    for x in (0.0, 0.010, 0.030):
        carried.follow(tip_at(x, 0.0, 0.0))
    # It stood for 12 mm of the way, the last look at it among the 30.
    carried.fell_back(tip_at(0.012, 0.0, 0.0))
    np.testing.assert_allclose(carried.away, [0.012, 0.0], atol=1e-12)
    # Where the hand is on its way back does not matter, and the next press adds to it.
    for x, above in ((0.030, 0.03), (0.0, 0.03), (0.0, 0.0), (0.005, 0.0)):
        carried.follow(tip_at(x, 0.0, above))
    np.testing.assert_allclose(carried.away, [0.017, 0.0], atol=1e-12)
    carried.follow(tip_at(0.0, 0.0, 0.03))
    carried.fell_back(tip_at(0.3, 0.3, 0.0))
    carried.fell_back(None)
    np.testing.assert_allclose(carried.away, [0.017, 0.0], atol=1e-12)


@given(st.floats(0.0, 0.1), st.floats(-np.pi, np.pi))
def test_pictures_are_believed_of_a_place_only_near_where_the_hand_can_have_brought_it(off: float, to: float) -> None:
    carried = block()
    for x in (0.0, 0.02):
        carried.carried.follow(tip_at(x, 0.0, 0.0))
    place = SCENE.get(B0, "x", "y") + [0.02, 0.0]
    seen = place + off * np.array([np.cos(to), np.sin(to)])
    believed = carried.plausible(seen)
    np.testing.assert_allclose(
        believed, seen if off < BEYOND - 1e-9 else place, atol=2e-9 + (off >= BEYOND - 1e-9) * 1e-9
    )


def saying(gaps: np.ndarray) -> Prediction:
    return Prediction(np.zeros((1, 8, 3)), np.ones(1), np.ones(1), np.array([[0.0, 0.0, -0.06, *gaps, 0.0, 0.0]]))


def test_pictures_are_refuted_where_a_wall_is_further_away_than_the_hand_can_have_brought_it() -> None:
    carried, above = block(), tip_at(scenes.CORNER, scenes.CORNER, 0.06)
    carried.carried.follow(above)
    gaps = wall_gaps(carried.projected(above, above))[0].numpy()
    assert not carried.refutes(saying(gaps + BEYOND - 0.002), above)
    assert carried.refutes(saying(gaps + [0.0, BEYOND + 0.002]), above)
    # Nearer to a wall it may well be: it need not have come along.
    assert not carried.refutes(saying(gaps - 0.05), above)
    for x in (scenes.CORNER, scenes.CORNER - 0.03):
        carried.carried.follow(tip_at(x, scenes.CORNER, 0.0))
    assert not carried.refutes(saying(gaps + [0.03, 0.0]), above)


@given(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(-0.02, 0.02))
def test_a_hand_that_sinks_into_the_place_of_a_block_shows_that_it_is_elsewhere(x: float, y: float, to: float) -> None:
    carried, high = block(), tip_at(scenes.CORNER, scenes.CORNER, 0.06)
    middle, size = SCENE.get(B0, "x", "y"), float(SCENE.get(B0, "size_x")[0])
    for pressed in (0.0, to):
        carried.carried.follow(tip_at(middle[0] + pressed, middle[1], 0.0))
    carried.sank(tip_at(middle[0] + to + x, middle[1] + y, -0.02))
    beside = np.abs(spatial.pose_from_features(SCENE[B0][:7])[:2, :2].T @ [x, y]).max()
    assume(abs(beside - (size / 2 - INSIDE)) > 1e-9)
    assert carried.elsewhere == (beside < size / 2 - INSIDE)
    gaps, far = wall_gaps(carried.projected(high, high))[0].numpy(), middle + 0.1
    assert carried.refutes(saying(gaps + 0.05), high) != carried.elsewhere
    assert (carried.plausible(far) == far).all() == carried.elsewhere


class _Pressing:
    """Goes down for some steps, and is done then."""

    def __init__(self, steps: int) -> None:
        self.left = steps

    def act(self, seen: torch.Tensor) -> torch.Tensor:
        self.left -= 1
        return torch.tensor([[0.0, 0.0, -1.0]])

    def done(self, seen: torch.Tensor) -> torch.Tensor:
        return torch.tensor([float(self.left <= 0)])


@pytest.mark.parametrize("knows_state", [True, False])
def test_a_cornered_block_that_is_seen_free_at_once_is_pressed_on_by_the_scan(knows_state: bool) -> None:
    pressing = _Pressing(3)
    by_state = ByState(pressing.act, pressing.done) if knows_state else None
    seeing = Seeing(SCENE)
    policy = Scripted(step=(0.0, 0.0, 0.0), done_at=1)
    skill = camera_recovery_skill("Recover", policy, RIG, SETTINGS, by_state=by_state)
    outcome = run_skill(seeing, skill.ground((R, B0, THE_BOX)))
    assert outcome.ending is SkillEnd.DONE
    assert (pressing.left == 0) == knows_state
    lowest = min(float(tip[2]) for tip in seeing.tips)
    assert (lowest < TOP + SETTINGS.approach_height - 0.02) == knows_state


def test_a_hand_that_meets_nothing_where_the_scan_has_the_block_looks_for_it_again() -> None:
    """As one that lost its block, which stands elsewhere, and presses on air where it was."""
    pressing = _Pressing(1000)
    policy = Scripted(step=(0.0, 0.0, 0.0), done_at=1)
    skill = camera_recovery_skill("Recover", policy, RIG, SETTINGS, by_state=ByState(pressing.act, pressing.done))
    seeing = Seeing(SCENE)
    assert run_skill(seeing, skill.ground((R, B0, THE_BOX))).ending is SkillEnd.DONE
    assert min(float(tip[2]) for tip in seeing.tips) < TOP - STUD, "it has been where the block would be"


@given(st.floats(-0.03, 0.03), st.floats(-0.03, 0.03), st.floats(-0.004, 0.01))
def test_fingers_that_stand_beside_the_stud_where_it_should_bear_them_show_that_the_block_is_elsewhere(
    x: float, y: float, above: float
) -> None:
    carried = block()
    # The upper face bears them, or the stud.
    carried.sank(tip_at(*SCENE.get(B0, "x", "y") + [x, y], above - STUD))
    beside = np.abs(spatial.pose_from_features(SCENE[B0][:7])[:2, :2].T @ [x, y]).max()
    assume(abs(beside - OVER_STUD) > 1e-9 and abs(above - STUD / 2) > 1e-9)
    assert carried.elsewhere == (beside < OVER_STUD and above < STUD / 2)
