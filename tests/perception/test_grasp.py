"""What the hand holds, as the belief tells it from estimates and the opening of the pads."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.rig import Rig
from resync_robot.core.vocabulary import BLOCK
from resync_robot.perception.belief import Belief
from tests.perception.estimates import B0, B1, FLOOR, HEIGHT, THE_BOX, WIDTH, R, block, grasp, robot, scene


def test_a_block_between_closed_pads_rides_with_the_tips(belief: Belief) -> None:
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    grasp(belief, 0.45, 0.052, yaw=0.05)
    assert belief.held == B0
    state = belief.state(robot(0.50, -0.10, 0.25, WIDTH, yaw=0.5))
    # Centred between the pads (2 mm were missing) and flush with them, wherever the hand goes.
    assert state.get(B0, "x", "y", "z") == pytest.approx([0.50, -0.10, 0.25], abs=0.001)
    assert spatial.wrap(float(spatial.yaw_of(state[B0][3:7])) - 0.5, np.pi / 2) == pytest.approx(0.0, abs=1e-6)
    assert state.get(B1, "x", "y") == pytest.approx([0.45, 0.30])


def test_opening_leaves_the_block_where_it_is(belief: Belief) -> None:
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    grasp(belief, 0.45, 0.05)
    belief.state(robot(0.50, -0.10, 0.05, WIDTH))
    belief.state(robot(0.50, -0.10, 0.05, 0.10))
    assert belief.held is None
    assert belief.state(robot(0.40, 0.0, 0.30, 0.14)).get(B0, "x", "y") == pytest.approx([0.50, -0.10], abs=0.001)


def test_a_block_that_slips_out_is_not_held(belief: Belief) -> None:
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    grasp(belief, 0.45, 0.05)
    belief.state(robot(0.50, -0.10, 0.25, 0.01))
    assert belief.held is None


@pytest.mark.parametrize("at", [(0.45, 0.09), (0.40, 0.05)])
def test_pads_that_close_beside_a_block_hold_nothing(belief: Belief, at: tuple[float, float]) -> None:
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    grasp(belief, *at)
    assert belief.held is None


def test_closed_pads_that_press_on_a_block_do_not_hold_it(belief: Belief) -> None:
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot(opening=0.0))
    belief.state(robot(0.45, 0.05, FLOOR + HEIGHT, 0.0))
    assert belief.held is None


def test_a_held_block_that_is_seen_standing_was_lost(belief: Belief) -> None:
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    grasp(belief, 0.45, 0.05)
    state = belief.update(scene(block("b0", 0.52, 0.01), block("b1", 0.46, 0.30, 0.0)), robot(opening=WIDTH))
    assert belief.held is None
    assert state.get(B0, "x", "y") == pytest.approx([0.52, 0.01])


def tower(belief: Belief, upper: str, lower: str) -> None:
    stacked = block(upper, 0.45, 0.05, FLOOR + HEIGHT, stacked=True)
    belief.update(scene(block(lower, 0.45, 0.05), block(upper, 0.5, 0.1), block("b2", 0.5, -0.1)), robot())
    belief.update(scene(stacked, block("b2", 0.5, -0.1)), robot())


@pytest.mark.parametrize(("upper", "lower"), [("b0", "b1"), ("b1", "b0")])
def test_of_two_stacked_blocks_the_one_at_the_tips_is_held(rig: Rig, upper: str, lower: str) -> None:
    belief = Belief(R, THE_BOX, (B0, B1, BLOCK("b2")), rig)
    tower(belief, upper, lower)
    for opening in (0.10, WIDTH + 0.001):
        # A little lower than the upper block's middle: both lie within reach of the pads.
        belief.state(robot(0.45, 0.05, FLOOR + HEIGHT * 1.4, opening))
    assert belief.held == BLOCK(upper)
    assert not belief.grasp_is_certain


def test_a_block_gripped_alone_is_certain(rig: Rig) -> None:
    belief = Belief(R, THE_BOX, (B0, B1, BLOCK("b2")), rig)
    tower(belief, "b0", "b1")
    assert belief.grasp_is_certain
    for opening in (0.10, WIDTH + 0.001):
        belief.state(robot(0.5, -0.1, FLOOR + HEIGHT / 2, opening))
    assert belief.held == BLOCK("b2") and belief.grasp_is_certain


def test_when_the_gripped_block_stays_behind_the_hand_holds_the_one_that_stood_on_it(rig: Rig) -> None:
    belief = Belief(R, THE_BOX, (B0, B1, BLOCK("b2")), rig)
    tower(belief, "b0", "b1")
    for opening in (0.10, WIDTH + 0.001):
        belief.state(robot(0.45, 0.05, FLOOR + HEIGHT / 2, opening))
    assert belief.held == B1
    lifted = robot(0.45, 0.05, 0.30, WIDTH + 0.001)
    state = belief.update(scene(block("b1", 0.45, 0.05), block("b2", 0.5, -0.1)), lifted)
    assert belief.held == B0
    # It rides where it stood: one block's height above the one that the pads were closed on.
    assert state.get(B0, "x", "y", "z") == pytest.approx([0.45, 0.05, 0.30 + HEIGHT], abs=0.002)


def test_when_everything_stays_behind_the_hand_holds_nothing(rig: Rig) -> None:
    belief = Belief(R, THE_BOX, (B0, B1, BLOCK("b2")), rig)
    tower(belief, "b0", "b1")
    for opening in (0.10, WIDTH + 0.001):
        belief.state(robot(0.45, 0.05, FLOOR + HEIGHT / 2, opening))
    lost = robot(0.45, 0.05, 0.30, 0.0)
    seen = scene(block("b0", 0.45, 0.05, FLOOR + HEIGHT, stacked=True), block("b1", 0.45, 0.05), block("b2", 0.5, -0.1))
    belief.update(seen, lost)
    assert belief.held is None


def test_what_stands_where_it_stood_was_not_lifted_nor_what_is_beneath_it(rig: Rig) -> None:
    belief = Belief(R, THE_BOX, (B0, B1, BLOCK("b2")), rig)
    tower(belief, "b0", "b1")
    upper = block("b2", 0.45, 0.05, FLOOR + 2 * HEIGHT, stacked=True)
    belief.update(scene(upper), robot())
    for opening in (0.10, WIDTH + 0.001):
        belief.state(robot(0.45, 0.05, FLOOR + HEIGHT / 2, opening))
    assert belief.in_hand == (B1, B0, BLOCK("b2"))
    # Only the uppermost came along; the middle one is seen, and hides the lowest.
    lifted = robot(0.30, 0.20, 0.30, WIDTH + 0.001)
    state = belief.update(scene(block("b0", 0.45, 0.05, FLOOR + HEIGHT, stacked=True)), lifted)
    assert belief.in_hand == (BLOCK("b2"),)
    assert state.get(B1, "x", "y", "z") == pytest.approx([0.45, 0.05, FLOOR + HEIGHT / 2], abs=0.002)
    assert state.get(BLOCK("b2"), "x", "y", "z") == pytest.approx([0.30, 0.20, 0.30 + 2 * HEIGHT], abs=0.003)
    assert belief.report.hidden == ("b1",)
