"""A block that begins to lean lifts the hand on it, and is let go; one that slides is not."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from policies.cartesian import Hand
from policies.footing import LET_GO_RISE, PRESSED, RISE, Footing, press_on
from resync_robot.core import kinematics, spatial
from resync_robot.core.joints import JointTarget
from tests import scenes
from tests.policies.followers import RIG, Follower

SCENE = scenes.scene({"b0": (scenes.CORNER, scenes.CORNER), "b1": (0.0, 0.0)}).initial
PERIOD, FLOOR = 0.02, 0.06
HEIGHTS = st.floats(0.0, 0.2)


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
        flange = spatial.inverse(self.rig.arm.world_T_base) @ tip @ spatial.inverse(self.rig.gripper.flange_T_tip)
        arm = kinematics.inverse_along(flange, self.arm, kinematics.branch_of(self.arm))
        super().act(JointTarget(arm, target.opening), duration)


def drag(steep: float, decisions: int = 12) -> tuple[list[bool], Top]:
    """Press from above, then drag along x in steps of 1 cm."""
    world = Top(SCENE, steep=steep)
    hand = Hand(RIG, world.observe(), PERIOD, stray=np.inf)
    footing, whole = Footing(), []
    down = np.array([*hand.position[:2], FLOOR - 0.02])
    ways = [np.linspace(hand.position, down, 21)[i] for i in range(1, 21)]
    for goal in [*ways, *([None] * decisions)]:
        if goal is None:
            goal = np.array([hand.position[0] + 0.01, hand.position[1], FLOOR - 0.02])
        motion = press_on(hand, goal, 5, footing)
        try:
            target = next(motion)
            while True:
                world.act(target, PERIOD)
                target = motion.send(world.observe())
        except StopIteration as ended:
            whole.append(ended.value)
    return whole[20:], world


def test_a_block_that_slides_is_dragged_on() -> None:
    whole, world = drag(steep=0.0)
    assert all(whole)
    assert max(tip[2] for tip in world.tips[-60:]) == pytest.approx(FLOOR, abs=1e-5)
    assert world.longest == pytest.approx(0.12, abs=0.002)


def test_a_block_that_leans_is_let_go_and_pressed_again() -> None:
    whole, world = drag(steep=0.4)
    # 2 mm at a steepness of 0.4 are 5 mm of way. From where it let go the hand needs a step to come down again.
    assert not any(a and b for a, b in pairwise(whole)) and whole.count(False) >= 5
    heights = np.array([tip[2] for tip in world.tips])
    ups = heights[1:][(heights[:-1] < FLOOR + RISE + LET_GO_RISE - 0.005) & (np.diff(heights) > 0)]
    assert ups.max() == pytest.approx(FLOOR + RISE + LET_GO_RISE, abs=0.006)
    # Never dragged on for longer than it takes to feel it.
    assert world.longest < 0.016


@given(st.lists(st.tuples(HEIGHTS, HEIGHTS), max_size=40), HEIGHTS)
def test_a_hand_in_the_air_feels_nothing(steps: list[tuple[float, float]], height: float) -> None:
    footing = Footing()
    for tip, sent in steps:
        footing.leans(tip, sent)
    assert not footing.leans(height, height - PRESSED + 1e-6)
    # And nothing of what it stood on before.
    assert not footing.leans(height + 0.01, height - PRESSED)


@given(st.lists(HEIGHTS, min_size=1, max_size=40))
def test_only_a_rise_above_the_lowest_is_a_lean(heights: list[float]) -> None:
    footing = Footing()
    felt = [footing.leans(z, z - 2 * PRESSED) for z in heights]
    lowest = np.minimum.accumulate(heights)
    assert felt == [bool(z > low + RISE) for z, low in zip(heights, lowest, strict=True)]
