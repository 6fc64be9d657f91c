"""Straight lines arrive, keep to their speed, and stop where a guard says so."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import load_rig
from resync_robot.core.skill import SkillEnd, SkillOutcome
from resync_robot.policies.cartesian import GIVE_IN_STEP, Blocked, Dropped, Hand, run_motion
from tests import scenes
from tests.policies.followers import RIG, Follower

PERIOD = 0.02
SCENE = scenes.scene({"b0": (0.0, 0.0)}).initial


def follow(world: Follower, hand: Hand, motion: Generator[JointTarget, Any, Any]) -> list[JointTarget]:
    """Carry a motion out; returns every target."""
    targets = []
    try:
        target = next(motion)
        while True:
            targets.append(target)
            world.act(target, PERIOD)
            target = motion.send(world.observe())
    except StopIteration:
        return targets


def hand_of(world: Follower, stray: float = 0.02) -> Hand:
    return Hand(RIG, world.observe(), PERIOD, stray)


def test_it_says_which_places_the_arm_reaches_and_which_the_workspace_allows() -> None:
    hand = hand_of(Follower(SCENE))
    tips = np.array([[0.45, 0.0, 0.02], [0.45, 0.3, 0.3], [1.2, 0.0, 0.02], [0.45, 0.0, 1.5]])
    assert hand.reaches(tips).tolist() == [True, True, False, False]
    narrow = load_rig(Path("hardware/emulated.toml"))
    hand.rig = replace(narrow, controller=replace(narrow.controller, workspace_high=np.array([0.9, 0.2, 0.9])))
    assert hand.reaches(tips).tolist() == [True, False, False, False]


place = st.tuples(st.floats(0.35, 0.55), st.floats(-0.2, 0.2), st.floats(0.05, 0.35))


@settings(max_examples=15)
@given(goal=place, yaw=st.floats(-1.5, 1.5), speed=st.floats(0.05, 0.3))
def test_a_move_arrives_on_a_straight_line_within_its_speed(
    goal: tuple[float, float, float], yaw: float, speed: float
) -> None:
    world = Follower(SCENE)
    begin = RIG.tip_pose(world.arm)[:3, 3]
    targets = follow(world, hand_of(world), hand_of(world).move(*goal, yaw, speed))
    tip = RIG.tip_pose(world.arm)
    np.testing.assert_allclose(tip[:3, 3], goal, atol=1e-6)
    np.testing.assert_allclose(tip[:3, :3], Hand.rotation(yaw), atol=1e-6)
    path = np.array([begin, *world.tips])
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() <= speed * PERIOD * (1 + 1e-6)
    line = (np.array(goal) - begin) / np.linalg.norm(np.array(goal) - begin)
    off = (path - begin) - ((path - begin) @ line)[:, None] * line
    assert np.abs(off).max() < 1e-6
    assert all(t.opening == world.opening for t in targets)


def test_the_tool_points_down_whatever_its_yaw() -> None:
    for yaw in (-1.0, 0.0, 2.0):
        np.testing.assert_allclose(Hand.rotation(yaw) @ [0, 0, 1], [0, 0, -1], atol=1e-12)
        np.testing.assert_allclose(Hand.rotation(yaw) @ [1, 0, 0], [np.cos(yaw), np.sin(yaw), 0], atol=1e-12)


def test_a_turn_goes_the_short_way_round() -> None:
    world = Follower(SCENE)
    hand = hand_of(world)
    x, y, z = hand.position
    follow(world, hand, hand.move(x, y, z, 3.0, 0.2))
    follow(world, hand, hand.move(x, y, z, -3.0, 0.2))
    assert hand.yaw == pytest.approx(2 * np.pi - 3.0)


def test_a_tip_that_is_held_blocks_the_move() -> None:
    world = Follower(SCENE, stuck=True)
    hand = hand_of(world)
    with pytest.raises(Blocked, match="held"):
        follow(world, hand, hand.move(*(hand.position + [0, 0, 0.1]), hand.yaw, 0.1))


class Late(Follower):
    """An arm that stands where it was sent a fifth of a second ago."""

    def act(self, target: JointTarget, duration: float) -> None:
        self.sent = [*getattr(self, "sent", [JointTarget(self.arm.copy(), self.opening)] * 10), target]
        super().act(self.sent[-11], duration)


@settings(max_examples=10)
@given(goal=place, speed=st.floats(0.05, 0.35))
def test_an_arm_that_is_late_is_not_held(goal: tuple[float, float, float], speed: float) -> None:
    """Least of all where it brakes: it is still as far behind as at full speed."""
    world = Late(SCENE)
    hand = hand_of(world)
    follow(world, hand, hand.move(*goal, hand.yaw, speed))
    np.testing.assert_allclose(RIG.tip_pose(world.arm)[:3, 3], goal, atol=1e-3)


def test_a_late_arm_that_something_stops_on_its_way_is_held() -> None:
    class Stopped(Late):
        def act(self, target: JointTarget, duration: float) -> None:
            super().act(target, duration)
            self.stuck = self.time > 0.8

    world = Stopped(SCENE)
    hand = hand_of(world)
    with pytest.raises(Blocked, match="held"):
        follow(world, hand, hand.move(*(hand.position + [0, 0.3, 0]), hand.yaw, 0.25))
    assert np.linalg.norm(hand.position - hand.tip()) < 0.02 + 0.3 * 0.25 + 0.01


def test_a_push_blocks_a_move_that_minds_it_and_no_other() -> None:
    class Pushed(Follower):
        def act(self, target: JointTarget, duration: float) -> None:
            super().act(target, duration)
            self.force = np.array([0.0, 0.0, 30.0]) * (self.time > 0.2)

    for limit, blocked in ((25.0, True), (35.0, False), (np.inf, False)):
        world = Pushed(SCENE)
        hand = hand_of(world)
        motion = hand.move(*(hand.position - [0, 0, 0.1]), hand.yaw, 0.1, max_force=limit)
        if blocked:
            with pytest.raises(Blocked, match="30 N"):
                follow(world, hand, motion)
        else:
            follow(world, hand, motion)


def test_what_pushed_from_the_start_is_not_a_contact() -> None:
    world = Follower(SCENE, force=np.array([0.0, 0.0, -40.0]))
    hand = hand_of(world)
    follow(world, hand, hand.move(*(hand.position - [0, 0, 0.05]), hand.yaw, 0.1, max_force=5.0))


def test_the_fingers_open_at_their_speed_and_within_their_range() -> None:
    world = Follower(SCENE, opening=0.10)
    hand = hand_of(world)
    targets = follow(world, hand, hand.open(0.02))
    widths = np.array([0.10] + [t.opening for t in targets])
    assert np.abs(np.diff(widths)).max() <= 0.12 * PERIOD + 1e-9
    assert world.opening == pytest.approx(0.02)
    follow(world, hand, hand.open(9.0))
    assert world.opening == RIG.gripper.max_opening


def test_the_fingers_open_on_the_way_at_their_speed() -> None:
    world = Follower(SCENE, opening=0.0)
    hand = hand_of(world)
    targets = follow(world, hand, hand.move(*(hand.position + [0.02, 0, 0]), hand.yaw, 0.25, opening=0.08))
    widths = np.array([0.0] + [t.opening for t in targets])
    assert widths[-1] == 0.08 and np.abs(np.diff(widths)).max() <= 0.12 * PERIOD + 1e-9
    follow(world, hand, hand.move(*hand.position, hand.yaw, 0.25, opening=9.0))
    assert world.opening == RIG.gripper.max_opening


@settings(max_examples=100)
@given(begin=st.floats(0.0, 0.14), end=st.sampled_from([0.0, 0.14]))
def test_fingers_end_exactly_where_they_were_sent(begin: float, end: float) -> None:
    world = Follower(SCENE, opening=begin)
    hand = hand_of(world)
    targets = follow(world, hand, hand.open(end))
    assert targets[-1].opening == end and all(0.0 <= t.opening <= 0.14 for t in targets)


def test_a_hand_that_holds_something_goes_on_pressing_on_it() -> None:
    """What a block stops the pads at is not where they were sent: sent there, they would let go."""
    world = Follower(SCENE, opening=0.045, told=0.030, between=0.045)
    hand = hand_of(world)
    targets = follow(world, hand, hand.retreat(hand.position[2] + 0.05, 0.1))
    assert targets and all(t.opening == 0.030 for t in targets)


def test_a_retreat_goes_straight_up_and_never_down() -> None:
    world = Follower(SCENE)
    hand = hand_of(world)
    x, y, z = hand.position
    assert follow(world, hand, hand.retreat(z - 0.1, 0.1)) == []
    follow(world, hand, hand.retreat(z + 0.05, 0.1))
    np.testing.assert_allclose(RIG.tip_pose(world.arm)[:3, 3], [x, y, z + 0.05], atol=1e-6)


def test_backing_off_ignores_what_holds_the_tip() -> None:
    world = Follower(SCENE, stuck=True)
    hand = hand_of(world, stray=0.001)
    follow(world, hand, hand.back_off(hand.position[2] + 0.05, 0.1))
    assert hand.stray == 0.001


def test_a_hand_that_was_sent_far_into_something_comes_back_without_a_jump() -> None:
    world = Follower(SCENE, stuck=True)
    hand = hand_of(world)
    tip = hand.position.copy()
    hand.position = tip - [0.0, 0.0, 0.05]
    sent = [RIG.tip_pose(t.arm)[:3, 3] for t in follow(world, hand, hand.give_in())]
    assert np.abs(np.diff([tip - [0.0, 0.0, 0.05], *sent], axis=0)).max() <= GIVE_IN_STEP + 1e-6
    np.testing.assert_allclose(sent[-1], tip, atol=1e-6)
    assert follow(world, hand, hand.give_in()) == [], "it is there already"


def test_what_no_configuration_reaches_ends_as_unreachable() -> None:
    world = Follower(SCENE)
    hand = hand_of(world)

    def motion() -> Generator[JointTarget, Any, SkillOutcome]:
        yield from hand.move(2.0, 0.0, 0.3, 0.0, 1.0)
        return SkillOutcome(SkillEnd.DONE)

    policy = run_motion(motion(), world.observe())
    for _ in range(1000):
        answer = policy.step(world.observe())
        if isinstance(answer, SkillOutcome):
            break
        world.act(answer, PERIOD)
    assert answer.ending is SkillEnd.UNREACHABLE and "flange" in answer.reason


def test_a_motion_with_nothing_to_do_ends_at_once() -> None:
    def motion() -> Generator[JointTarget, Any, SkillOutcome]:
        return SkillOutcome(SkillEnd.REFUSED, "no")
        yield

    world = Follower(SCENE)
    assert run_motion(motion(), world.observe()).step(world.observe()) == SkillOutcome(SkillEnd.REFUSED, "no")


def test_a_hand_knows_its_yaw_from_the_arm() -> None:
    world = Follower(SCENE)
    hand = hand_of(world)
    follow(world, hand, hand.move(*hand.position, 0.7, 0.2))
    assert hand_of(world).yaw == pytest.approx(0.7)
    np.testing.assert_allclose(
        spatial.rotation_vector(Hand.rotation(0.7).T @ RIG.tip_pose(world.arm)[:3, :3]), 0, atol=1e-6
    )


def test_a_motion_ends_once_what_the_hand_held_has_left_it() -> None:
    world = Follower(SCENE, between=0.05)
    hand = hand_of(world)
    follow(world, hand, hand.close(0.03))
    hand.hold()
    follow(world, hand, hand.move(0.45, 0.1, 0.3, hand.yaw, 0.25))
    assert np.allclose(hand.tip(), [0.45, 0.1, 0.3]), "as long as it is there it goes on"
    with pytest.raises(Dropped, match="left the hand"):
        moving = hand.move(0.45, -0.1, 0.3, hand.yaw, 0.25)
        target = next(moving)
        for i in range(400):
            world.between = 0.0 if i > 10 else 0.05
            world.act(target, PERIOD)
            target = moving.send(world.observe())
    assert hand.tip()[1] > 0.0, "soon"
    follow(world, hand, hand.back_off(0.35, 0.1))
    assert hand.tip()[2] == pytest.approx(0.35, abs=1e-6), "what comes next is no matter of holding"


def test_fingers_that_are_moved_hold_nothing_any_more() -> None:
    world = Follower(SCENE, between=0.05)
    hand = hand_of(world)
    follow(world, hand, hand.close(0.03))
    hand.hold()
    world.between = 0.0
    follow(world, hand, hand.open(0.02))
    follow(world, hand, hand.move(0.45, 0.1, 0.3, hand.yaw, 0.25))
    assert np.allclose(hand.tip(), [0.45, 0.1, 0.3])
