"""A block that begins to lean lifts the hand on it, and is let go; one that slides is not. A hand beside it notices."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.joints import JointTarget
from resync_robot.learning.recovery_policy import STUD
from resync_robot.policies.cartesian import GIVE_IN_STEP, Hand
from resync_robot.policies.tip_over_guard import (
    ABOVE,
    BENEATH,
    FELT,
    LET_GO_RISE,
    PRESSED,
    RISE,
    RISE_STEPS,
    TipOverGuard,
    press_on,
)
from tests import scenes
from tests.policies.followers import RIG, Follower

SCENE = scenes.scene({"b0": (scenes.CORNER, scenes.CORNER), "b1": (0.0, 0.0)}).initial
PERIOD, FLOOR = 0.02, 0.06
HEIGHTS = st.floats(0.0, 0.2)
HARD = 60.0
"""N, as an arm presses that its effort limit holds."""


@dataclass
class Top(Follower):
    """The hand gets no further down than the top of a block, which rises by `steep` for each m that it is dragged
    while it is pressed, and falls back when it is let go."""

    steep: float = 0.0
    dragged: float = 0.0
    longest: float = 0.0

    def act(self, target: JointTarget, duration: float) -> None:
        before = self.rig.tip_pose(self.arm)[0, 3]
        tip = self.rig.tip_pose(target.arm).copy()
        pressed = tip[2, 3] < FLOOR
        self.dragged = self.dragged + abs(tip[0, 3] - before) if pressed else 0.0
        self.longest = max(self.longest, self.dragged)
        tip[2, 3] = max(tip[2, 3], FLOOR + self.steep * self.dragged)
        self.force = np.array([0.0, 0.0, HARD * pressed])
        flange = spatial.inverse(self.rig.arm.world_T_base) @ tip @ spatial.inverse(self.rig.gripper.flange_T_tip)
        kinematics = self.rig.arm.kinematics
        arm = kinematics.inverse_along(flange, self.arm, kinematics.branch_of(self.arm))
        super().act(JointTarget(arm, target.opening), duration)


def go(world: Follower, hand: Hand, goal: np.ndarray, guard: TipOverGuard) -> bool:
    motion = press_on(hand, goal, 5, guard)
    target = next(motion)
    while True:
        world.act(target, PERIOD)
        try:
            target = motion.send(world.observe())
        except StopIteration as ended:
            return ended.value


def pressing(world: Follower, guard: TipOverGuard) -> Hand:
    """A hand that was sent 2 cm beneath the floor of its world."""
    hand = Hand(RIG, world.observe(), PERIOD, stray=np.inf)
    down = np.array([*hand.position[:2], FLOOR - 0.02])
    for goal in np.linspace(hand.position, down, 21)[1:]:
        go(world, hand, goal, guard)
    return hand


def drag(steep: float, decisions: int = 12) -> tuple[list[bool], Top]:
    """Press from above, then drag along x in steps of 1 cm."""
    world, guard = Top(SCENE, steep=steep), TipOverGuard()
    hand = pressing(world, guard)
    whole = []
    for _ in range(decisions):
        goal = np.array([hand.position[0] + 0.01, hand.position[1], FLOOR - 0.02])
        whole.append(go(world, hand, goal, guard))
    return whole, world


def test_a_block_that_slides_is_dragged_on() -> None:
    whole, world = drag(steep=0.0)
    assert all(whole)
    assert max(tip[2] for tip in world.tips[-60:]) == pytest.approx(FLOOR, abs=1e-5)
    assert world.longest == pytest.approx(0.12, abs=0.002)


def test_a_block_that_leans_is_let_go_and_pressed_again() -> None:
    whole, world = drag(steep=0.4)
    # 2 mm at a steepness of 0.4 are 5 mm of way. From where it let go the hand needs a step to come down again.
    assert (True, True) not in pairwise(whole) and whole.count(False) >= 5
    heights = np.array([tip[2] for tip in world.tips])
    ups = heights[1:][(heights[:-1] < FLOOR + RISE + LET_GO_RISE - 0.005) & (np.diff(heights) > 0)]
    assert ups.max() == pytest.approx(FLOOR + RISE + LET_GO_RISE, abs=0.006)
    # Never dragged on for longer than it takes to feel it.
    assert world.longest < 0.016


def test_a_hand_that_is_done_pressing_goes_straight_up() -> None:
    world, guard = Top(SCENE), TipOverGuard()
    hand = pressing(world, guard)
    # Held by what it presses on, the tip is 2 cm behind where it is drawn to.
    place = hand.tip()
    hand.position += [0.02, 0.0, 0.0]
    world.tips.clear()
    # Pressing less is no lifting, however much less.
    aside = hand.position + [0.005, 0.0, 0.012]
    assert go(world, hand, aside, guard)
    np.testing.assert_allclose(hand.position, aside)
    place = hand.tip()
    assert go(world, hand, hand.position + [0.005, 0.0, 0.005], guard)
    np.testing.assert_allclose(hand.position, [*place[:2], FLOOR - 0.003], atol=1e-6)
    # In the air a hand goes where it is sent.
    go(world, hand, hand.position + [0.0, 0.0, 0.05], guard)
    aside = hand.position + [0.01, 0.0, 0.015]
    go(world, hand, aside, guard)
    np.testing.assert_allclose(hand.position, aside)


def test_a_hand_that_slid_off_the_block_notices_and_rises() -> None:
    world = Top(SCENE)
    standing, off = TipOverGuard(top=FLOOR + BENEATH - 1e-3), TipOverGuard(top=FLOOR + BENEATH + 1e-3)
    hand = pressing(world, standing)
    assert go(world, hand, hand.position + [0.01, 0.0, 0.0], standing)
    assert not go(world, hand, hand.position + [0.01, 0.0, 0.0], off)
    assert hand.tip()[2] == pytest.approx(FLOOR + LET_GO_RISE, abs=1e-4)


def at(z: float, x: float = 0.0) -> np.ndarray:
    return np.array([x, 0.0, z])


@given(HEIGHTS, HEIGHTS, HEIGHTS)
def test_beside_a_block_is_beneath_its_top_whatever_it_was_sent(top: float, tip: float, sent: float) -> None:
    assert (TipOverGuard(top=top).gives_way(at(tip), sent, HARD)) == (tip < top - BENEATH)
    assert not TipOverGuard().gives_way(at(tip), sent, HARD)


@given(st.lists(st.tuples(HEIGHTS, HEIGHTS), max_size=40), HEIGHTS)
def test_a_hand_in_the_air_feels_nothing(steps: list[tuple[float, float]], height: float) -> None:
    guard = TipOverGuard()
    for tip, sent in steps:
        guard.gives_way(at(tip), sent, HARD)
    assert not guard.gives_way(at(height), height - PRESSED + 1e-6, HARD)
    # And nothing of what it stood on before.
    assert not guard.gives_way(at(height + 0.01), height - PRESSED, HARD)


@given(st.lists(HEIGHTS, min_size=1, max_size=40))
def test_only_a_rise_above_the_lowest_that_lasts_is_a_lean(heights: list[float]) -> None:
    guard = TipOverGuard()
    felt = [guard.gives_way(at(z), z - 2 * PRESSED, HARD) for z in heights]
    risen = heights > np.minimum.accumulate(heights) + RISE
    assert felt == [bool(risen[max(0, i + 1 - RISE_STEPS) : i + 1].sum() == RISE_STEPS) for i in range(len(heights))]


@given(st.lists(st.floats(0.0, 0.0006), min_size=1, max_size=20), st.integers(RISE_STEPS, 10))
def test_it_remembers_where_a_block_stood_that_leans_now(standing: list[float], leaning: int) -> None:
    """Each control step takes the hand 1 mm on."""
    guard = TipOverGuard()
    for i, z in enumerate(standing):
        assert not guard.gives_way(at(z, 0.001 * i), z - 2 * PRESSED, HARD)
    felt = [guard.gives_way(at(0.003 + 0.001 * i, 1.0), -2 * PRESSED, HARD) for i in range(leaning)]
    assert felt.index(True) == RISE_STEPS - 1
    assert guard.stood_at is not None
    assert guard.stood_at[0] == pytest.approx(0.001 * (len(standing) - 1))
    # In the air nothing stands beneath it.
    guard.gives_way(at(0.1), 0.1, 0.0)
    assert guard.stood_at is None


STRUCK = [14.0, 10.7, 9.2, 10.0, 11.6, 11.5, 10.3, 10.3, 11.5, 11.2, 11.0, 10.2, 11.0]
"""mm above the block's upper face, of a hand that presses on a block that stood, control step by control step."""


@pytest.mark.parametrize("known", [False, True])
def test_a_hand_that_wobbles_after_it_has_struck_feels_no_lean(known: bool) -> None:
    guard = TipOverGuard(top=0.0) if known else TipOverGuard()
    assert not any(guard.gives_way(at(z / 1000), -0.01, HARD) for z in STRUCK)


def test_no_hand_rests_above_the_stud_of_a_block_that_stands() -> None:
    leaning = [*STRUCK, 11.9, 13.1, 14.4, 15.8]
    known, unknown = TipOverGuard(top=0.0), TipOverGuard()
    assert [known.gives_way(at(z / 1000), -0.01, HARD) for z in leaning].index(True) == len(STRUCK) + 1
    assert [unknown.gives_way(at(z / 1000), -0.01, HARD) for z in leaning].index(True) == len(STRUCK) + 2
    # On the way down it has not touched anything yet.
    assert not any(
        TipOverGuard(top=0.0).gives_way(at(z), z - 2 * PRESSED, HARD) for z in np.linspace(0.05, STUD + 2 * ABOVE, 9)
    )


YIELDING = [(0.1, 1), (-1.6, 54), (-2.5, 93), (-3.2, 110), (-3.1, 113), (-2.8, 102), (-2.3, 78), (-2.0, 66), (-1.4, 61)]
FADING = [(-1.2, 46), (-1.1, 43), (-0.9, 41), (-0.9, 30), (-0.7, 20), (0.1, 8), (1.2, 5), (1.3, 2)]
"""mm above the stud, and N, of an emulated UR7e that strikes a block that stands, and drags it as the force fades."""


@pytest.mark.parametrize("known", [False, True])
def test_a_hand_that_presses_less_than_it_did_feels_no_lean(known: bool) -> None:
    guard = TipOverGuard(top=-STUD) if known else TipOverGuard()
    assert not any(guard.gives_way(at(z / 1000), -0.02, f) for z, f in YIELDING + FADING)
    # Pushed up as hard as before it does.
    assert any(guard.gives_way(at(z / 1000), -0.02, 61.0) for z in (1.2, 1.3, 1.4))


@given(HEIGHTS, st.floats(0.0, FELT, exclude_max=True))
def test_no_block_lifts_a_hand_that_hardly_feels_it(rise: float, force: float) -> None:
    guard = TipOverGuard()
    assert not guard.gives_way(at(0.0), -1.0, HARD)
    assert not any(guard.gives_way(at(rise), -1.0, force) for _ in range(2 * RISE_STEPS))


@pytest.mark.parametrize("ahead", [0.0, 0.05, 0.15])
def test_a_hand_that_was_sent_far_ahead_comes_back_without_a_jump(ahead: float) -> None:
    lifting, sinking = TipOverGuard(), TipOverGuard(top=FLOOR + BENEATH + 1e-3)
    for guard, up in ((lifting, 0.015), (sinking, 0.0)):
        world = Top(SCENE)
        hand = pressing(world, TipOverGuard())
        hand.position += [ahead, 0.0, -0.02]
        before, sent = hand.position.copy(), []
        motion = press_on(hand, hand.position + [0.0, 0.0, up], 5, guard)
        next(motion)
        while True:
            sent.append(hand.position.copy())
            try:
                motion.send(world.observe())
            except StopIteration:
                break
        steps = np.linalg.norm(np.diff([before, *sent], axis=0), axis=1)
        assert steps.max() < GIVE_IN_STEP + up / 5 + 1e-6
