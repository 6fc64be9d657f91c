"""Setpoints obey the limits exactly, follow targets closely, and never jump."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from resync_robot.core.errors import MotionError
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import load_rig
from resync_robot.hardware.base import SERVO_PERIOD, SafetyError
from resync_robot.hardware.sim import SimRobot
from resync_robot.hardware.stream import JUMP_SLACK, OVERSHOOT, Stream
from tests.emulators import RIG_FILE
from tests.hardware.adversary import KINDS, MOVES, TAKEN, assert_nothing_out_of_limits, attack, starts

STARTS = starts(load_rig(RIG_FILE))
FEW = settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def robot(perfect_robot, rig):
    return perfect_robot(rig.arm.home)


@pytest.fixture
def stream(robot, rig):
    return Stream(robot, rig)


def assert_within_limits(robot, rig):
    motion = np.array([rig.arm.home] * 3 + robot.sent)
    for limit in (rig.arm.velocity_limit, rig.arm.acceleration_limit, rig.arm.jerk_limit):
        motion = np.diff(motion, axis=0) / SERVO_PERIOD
        assert (np.abs(motion) <= limit * (1 + 1e-6)).all()


@given(
    st.lists(
        st.tuples(
            arrays(float, 6, elements=st.floats(-0.4, 0.4)),
            st.sampled_from([0.02, 0.1, 0.064]),
            st.booleans(),
            st.booleans(),
        ),
        min_size=1,
        max_size=25,
    )
)
@FEW
def test_limits_hold_over_any_targets_seams_and_stops_included(perfect_robot, rig, targets):
    robot = perfect_robot(rig.arm.home)
    stream = Stream(robot, rig)
    for change, duration, stop, travel in targets:
        try:
            stream.run(JointTarget(rig.arm.home + change, 0.05), duration, travel)
        except SafetyError as error:
            assert error.quantity == "floor" or (error.quantity == "jump" and not travel)
        if stop:
            stream.stop()
            assert np.array_equal(stream.target.arm, (robot.sent or [rig.arm.home])[-1])
    assert_within_limits(robot, rig)


def test_one_setpoint_every_servo_period(stream, robot, rig):
    stream.run(JointTarget(rig.arm.home, 0.1), 0.1)
    assert len(robot.sent) == 50


def follow(stream, rig, speed, duration, count):
    """Targets of a ramp in `speed` (6,), then the last one held for 0.5 s; the (6,) ramp's end."""
    for k in range(1, count + 1):
        end = rig.arm.home + speed * k * duration
        stream.run(JointTarget(end, 0.1), duration)
    for _ in range(round(0.5 / duration)):
        stream.run(JointTarget(end, 0.1), duration)
    return end


@pytest.mark.parametrize(
    ("speed", "duration", "most_lag"),
    [(0.05, 0.02, 0.025), (0.02, 0.02, 0.001), (0.5, 0.1, 0.070)],
    ids=["20 mm/s", "8 mm/s", "policy deltas of 0.05 rad"],
)
def test_lag_and_overshoot(stream, robot, rig, speed, duration, most_lag):
    direction = np.array([1.0, -0.3, 0.2, 0.3, -0.2, 0.1])
    count = round(1.0 / duration)
    end = follow(stream, rig, speed * direction, duration, count)
    moved = (np.array(robot.sent) - rig.arm.home)[:, 0]
    ramp = speed * SERVO_PERIOD * np.arange(1, round(1.0 / SERVO_PERIOD) + 1)
    lag = (ramp - moved[: len(ramp)])[len(ramp) // 2 :].mean() / speed
    assert -0.001 <= lag <= most_lag
    assert moved.max() - (end - rig.arm.home)[0] <= OVERSHOOT * 1.01
    np.testing.assert_allclose(robot.sent[-1], end, atol=1e-7)


def test_a_far_target_is_approached_without_overshoot(stream, robot, rig):
    goal = rig.arm.home + np.array([0.8, 0.2, -0.4, 0.3, 0.1, 1.0])
    for _ in range(30):
        stream.run(JointTarget(goal, 0.1), 0.1, travel=True)
    ahead = (np.array(robot.sent) - goal) * np.sign(goal - rig.arm.home)
    assert ahead.max() <= 1e-7
    np.testing.assert_allclose(robot.sent[-1], goal, atol=1e-7)


def test_the_distance_at_which_the_generator_fails_is_still_travelled(stream, robot, rig):
    """From rest over 2 a^3 / j^2 ruckig 0.19 finds no profile."""
    goal = rig.arm.home.copy()
    goal[1] += 2 * rig.arm.acceleration_limit[1] ** 3 / rig.arm.jerk_limit[1] ** 2
    stream.run(JointTarget(goal, 0.1), 1.0)
    stream.run(JointTarget(rig.arm.home, 0.1), 1.0)
    np.testing.assert_allclose(robot.sent[499], goal, atol=1e-7)
    np.testing.assert_allclose(robot.sent[-1], rig.arm.home, atol=1e-7)
    assert_within_limits(robot, rig)


def test_opening_changes_at_the_set_speed(robot, rig):
    stream = Stream(robot, rig, gripper_speed=0.05)
    stream.run(JointTarget(rig.arm.home, 0.08), 0.2)
    assert robot.openings[0] == pytest.approx(0.1 - 0.05 * SERVO_PERIOD)
    assert robot.openings[-1] == pytest.approx(0.09)
    stream.run(JointTarget(rig.arm.home, 0.08), 0.4)
    assert robot.openings[-1] == 0.08


def test_a_refused_target_brakes_the_arm_within_its_limits(stream, robot, rig):
    for k in range(1, 6):
        stream.run(JointTarget(rig.arm.home + 0.05 * k * np.array([1, 0, 0, 0, 0, 0]), 0.1), 0.1)
    moving = np.abs(robot.sent[-1] - robot.sent[-2]).max() / SERVO_PERIOD
    assert moving > 0.1
    with pytest.raises(SafetyError, match="elbow_joint"):
        stream.run(JointTarget(np.array([0, -1.5, np.nan, 0, 0, 0]), 0.1), 0.1)
    np.testing.assert_array_equal(robot.sent[-1], robot.sent[-2])
    assert_within_limits(robot, rig)
    stream.run(JointTarget(rig.arm.home, 0.1), 0.1)
    assert_within_limits(robot, rig)


@given(arrays(float, 6, elements=st.floats(-1.2, 1.2)), st.sampled_from([0.02, 0.1]))
@FEW
def test_a_jump_is_refused_unless_it_is_asked_for_as_a_travel(perfect_robot, rig, change, duration):
    robot = perfect_robot(rig.arm.home)
    stream = Stream(robot, rig)
    goal = JointTarget(rig.arm.home + change * np.array([1, 0, 0, 0, 0, 1]), 0.1)
    reach = rig.arm.velocity_limit[0] * duration + JUMP_SLACK
    far = np.abs(goal.arm - rig.arm.home).max() > reach
    if far:
        with pytest.raises(SafetyError) as caught:
            stream.run(goal, duration)
        assert caught.value.quantity == "jump"
        assert caught.value.value > caught.value.limit == pytest.approx(reach)
        assert robot.sent == []
        stream.run(goal, duration, travel=True)
    else:
        stream.run(goal, duration)
    assert len(robot.sent) == round(duration / SERVO_PERIOD)


def test_jumps_are_measured_from_the_last_target_not_from_the_arm(stream, rig):
    """Steps of a skill outrun the arm for a while; that is lag, not a jump."""
    for k in range(1, 8):
        stream.run(JointTarget(rig.arm.home + 0.1 * k * np.array([1, 0, 0, 0, 0, 0]), 0.1), 0.02)
    with pytest.raises(SafetyError, match="jump"):
        stream.run(JointTarget(rig.arm.home, 0.1), 0.02)


@pytest.mark.parametrize("duration", [0.0, -1.0, np.nan, np.inf, 61.0])
def test_a_senseless_duration(stream, robot, rig, duration):
    with pytest.raises(MotionError, match="60 s"):
        stream.run(JointTarget(rig.arm.home, 0.1), duration)
    assert robot.sent == []


@pytest.mark.parametrize("limit", [(40.0,) * 5, (40.0,) * 5 + (0.0,), (np.nan,) * 6, (np.inf,) * 6, (-1.0,) * 6])
def test_a_senseless_effort_limit(stream, robot, limit):
    """Against one that is not a number no joint would ever be pressed too hard."""
    with pytest.raises(MotionError, match="six positive"):
        stream.limit_effort(limit)
    assert robot.sent == []


def test_a_gripper_speed_is_within_what_the_gripper_of_the_rig_can(robot, rig):
    small = replace(rig, gripper=replace(rig.gripper, model="2f-85"))
    Stream(robot, rig, gripper_speed=0.2)
    with pytest.raises(MotionError, match=r"0\.2 m/s; allowed: 0\.02 to 0\.15 m/s"):
        Stream(robot, small, gripper_speed=0.2)
    Stream(robot, small, gripper_speed=0.025)


@pytest.mark.parametrize("speed", [0.0, 0.3, np.nan])
def test_a_gripper_speed_outside_the_specification(robot, rig, speed):
    with pytest.raises(MotionError, match="m/s"):
        Stream(robot, rig, gripper_speed=speed)


def test_recorders_see_requested_and_sent(robot, rig):
    seen = []
    stream = Stream(robot, rig, recorders=[lambda state, command: seen.append((state, command))], record_hz=50)
    goal = JointTarget(rig.arm.home + 0.3, 0.1)
    last = None
    for _ in range(5):
        last = stream.run(goal, 0.03, travel=True)
    assert len(seen) == 7
    commands = [c for _, c in seen]
    np.testing.assert_allclose(np.diff([c.time for c in commands]), 0.02)
    assert all(c.requested is goal for c in commands)
    for i, command in enumerate(commands):
        np.testing.assert_array_equal(command.sent.arm, robot.sent[10 * (i + 1) - 1])
    np.testing.assert_array_equal(last.sent.arm, robot.sent[-1])


def test_settle_waits_for_the_measured_arm(lagging_physics, rig):
    with SimRobot(lagging_physics(rig.arm.home, lag=0.1)) as robot:
        stream = Stream(robot, rig)
        goal = rig.arm.home + 0.1
        stream.run(JointTarget(goal, 0.05), 0.1)
        assert np.abs(robot.state().q - goal).max() > 0.01
        assert stream.settle(tolerance=1e-3, timeout=3.0)
        assert np.abs(robot.state().q - goal).max() <= 1e-3


def test_settle_gives_up_when_something_is_in_the_way(lagging_physics, rig):
    with SimRobot(lagging_physics(rig.arm.home, wall=rig.arm.home[0] + 0.05)) as robot:
        stream = Stream(robot, rig)
        stream.run(JointTarget(rig.arm.home + 0.1, 0.1), 0.1)
        assert not stream.settle(timeout=1.0)
        assert robot.state().tip_force[0] == -10.0


def test_restart_takes_the_measured_pose(lagging_physics, rig):
    physics = lagging_physics(rig.arm.home, lag=0.5)
    with SimRobot(physics) as robot:
        stream = Stream(robot, rig)
        stream.run(JointTarget(rig.arm.home + 0.2, 0.1), 0.1)
        physics.q = rig.arm.home - 0.1
        robot.connect()
        stream.restart()
        stream.run(stream.target, 0.01)
        np.testing.assert_allclose(physics.driven[-1][0], rig.arm.home - 0.1, atol=1e-9)


def test_after_a_stop_of_the_arm_the_fingers_go_on_pressing_on_what_they_hold(lagging_physics, rig):
    physics = lagging_physics(rig.arm.home)
    with SimRobot(physics) as robot:
        stream = Stream(robot, rig)
        stream.run(JointTarget(rig.arm.home, 0.03), 1.0)
        physics.opening = 0.05  # Where a block stops the pads.
        stream.restart()
        stream.run(stream.target, 0.01)
        assert physics.driven[-1][1] == 0.03


@given(st.lists(st.sampled_from(KINDS), min_size=1, max_size=60), st.integers(0, 2**32 - 1))
@FEW
def test_no_adversarial_target_is_sent(perfect_robot, kinds, seed):
    attacked(perfect_robot, kinds, seed)


@pytest.mark.slow
def test_no_target_of_a_hundred_thousand_adversarial_ones_is_sent(perfect_robot):
    given_to_it = 0

    @given(st.permutations(KINDS), st.integers(0, 2**32 - 1))
    @settings(max_examples=100, deadline=None, suppress_health_check=list(HealthCheck))
    def attack_it(kinds, seed):
        nonlocal given_to_it
        given_to_it += len(attacked(perfect_robot, kinds * (1 + 1000 // len(kinds)), seed))

    attack_it()
    assert given_to_it >= 100_000


def attacked(perfect_robot, kinds, seed):
    rig, rng = load_rig(RIG_FILE), np.random.default_rng(seed)
    start = list(STARTS.values())[seed % len(STARTS)]
    robot = perfect_robot(start)
    stream = Stream(robot, rig)
    answers = [(kind, attack(stream, rig, kind, rng)) for kind in kinds]
    assert not {"not a number", "wrong length", "opening", "duration"} & {kind for kind, was in answers if was == TAKEN}
    if robot.sent:
        assert_nothing_out_of_limits(robot.sent, rig, start)
        assert all(0.0 <= opening <= rig.gripper.max_opening for opening in robot.openings)
    return [was for _, was in answers]


@pytest.mark.parametrize("quantity", [q for q in STARTS if q != "home"])
def test_where_a_limit_begins_the_arm_moves_and_is_kept_from_it(perfect_robot, quantity):
    # Not for long at a time: most of what is taken leads away.
    seeds = range(list(STARTS).index(quantity), 20 * len(STARTS), len(STARTS))
    answers = [was for seed in seeds for was in attacked(perfect_robot, MOVES * 4, seed)]
    assert answers.count(quantity) >= 20
    assert answers.count(TAKEN) >= 100
