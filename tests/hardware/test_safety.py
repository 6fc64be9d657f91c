"""No setpoint outside the limits reaches the robot, whatever is asked."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import resync_robot
from resync_robot.core import spatial
from resync_robot.core.joints import ARM_JOINTS, JointTarget
from resync_robot.core.rig import load_rig
from resync_robot.hardware.base import SERVO_PERIOD, SafetyError
from resync_robot.hardware.clearance import Obstacle
from resync_robot.hardware.safety import FIRST_RUN_SPEED, Guard
from resync_robot.hardware.stream import FIRST_RUN_PACE, PACE_MARGIN, Stream
from resync_robot.hardware.workspace import heights
from tests.emulators import RIG_FILE

FEW = settings(deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def robot(perfect_robot, rig):
    return perfect_robot(rig.arm.home)


@pytest.fixture
def guard(robot, rig):
    return Guard(robot, rig)


def hold(guard, n=1):
    return np.repeat(guard.last_sent[None], n, axis=0), np.full(n, guard.last_opening)


def test_holding_still_is_sent(guard, robot):
    guard.send(*hold(guard, 5))
    assert len(robot.sent) == 5


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_not_finite_names_the_joint_and_sends_nothing(guard, robot, bad):
    setpoints, openings = hold(guard, 4)
    setpoints[3, 2] = bad
    with pytest.raises(SafetyError) as caught:
        guard.send(setpoints, openings)
    assert (caught.value.quantity, caught.value.joint) == ("finite", "elbow_joint")
    assert robot.sent == []


@pytest.mark.parametrize("shape", [(5,), (7,), (1, 6), ()])
def test_wrong_length_of_target(guard, shape):
    with pytest.raises(SafetyError, match="shape"):
        guard.check_target(np.zeros(shape), 0.1)


@pytest.mark.parametrize("shape", [(3, 5), (3, 7), (6,)])
def test_wrong_length_of_block(guard, robot, shape):
    with pytest.raises(SafetyError, match="shape"):
        guard.send(np.zeros(shape), np.zeros(3))
    assert robot.sent == []


@pytest.mark.parametrize("joint", range(6))
def test_position_limit_of_each_joint(guard, rig, joint):
    target = np.array([0.0, -1.5, 0.5, 0.0, 0.0, 0.0])
    target[joint] = rig.arm.kinematics.joint_limit[joint] + 0.01
    with pytest.raises(SafetyError) as caught:
        guard.check_target(target, 0.1)
    error = caught.value
    assert (error.quantity, error.joint) == ("position", ARM_JOINTS[joint])
    assert error.value == pytest.approx(target[joint]) and error.limit == rig.arm.kinematics.joint_limit[joint]


def test_jump_against_the_last_sent_setpoint(guard, robot):
    setpoints, openings = hold(guard)
    setpoints[0, 4] += 0.5
    with pytest.raises(SafetyError) as caught:
        guard.send(setpoints, openings)
    assert (caught.value.quantity, caught.value.joint) == ("velocity", "wrist_2_joint")
    assert caught.value.value == pytest.approx(0.5 / SERVO_PERIOD)
    assert robot.sent == []


def test_acceleration_and_jerk(guard, rig):
    setpoints, openings = hold(guard)
    setpoints[0, 0] += 2 * rig.arm.acceleration_limit[0] * SERVO_PERIOD**2
    with pytest.raises(SafetyError) as caught:
        guard.send(setpoints, openings)
    assert caught.value.quantity == "acceleration"
    setpoints, openings = hold(guard)
    setpoints[0, 0] += 2 * rig.arm.jerk_limit[0] * SERVO_PERIOD**3
    with pytest.raises(SafetyError) as caught:
        guard.send(setpoints, openings)
    assert caught.value.quantity == "jerk"


def test_limits_hold_across_blocks(guard, robot, rig):
    """A speed that one block may reach slowly must not stop dead at the seam."""
    jerk = 0.9 * rig.arm.jerk_limit[0]
    # As long as the acceleration that this jerk builds up stays within its own limit.
    count = min(20, int(0.8 * rig.arm.acceleration_limit[0] / jerk / SERVO_PERIOD))
    ramp = jerk * (np.arange(1, count + 1) * SERVO_PERIOD) ** 3 / 6
    setpoints, openings = hold(guard, count)
    setpoints[:, 0] += ramp
    guard.send(setpoints, openings)
    with pytest.raises(SafetyError) as caught:
        guard.send(*hold(guard, 3))
    assert caught.value.quantity == "acceleration" or caught.value.quantity == "jerk"
    assert len(robot.sent) == count


def test_opening_range_and_speed(guard, rig):
    for opening in (-0.001, rig.gripper.max_opening + 0.001, np.nan):
        with pytest.raises(SafetyError) as caught:
            guard.check_target(rig.arm.home, opening)
        assert caught.value.quantity == "opening"
    setpoints, openings = hold(guard)
    with pytest.raises(SafetyError) as caught:
        guard.send(setpoints, openings - 2 * rig.gripper.facts.speed[1] * SERVO_PERIOD)
    assert caught.value.quantity == "opening speed"


def test_floor(guard, rig):
    below = spatial.transform(spatial.rotation_about("x", np.pi), np.array([-0.45, 0.0, rig.gripper.tip_offset - 0.05]))
    q = rig.arm.kinematics.inverse(below, rig.arm.home)
    with pytest.raises(SafetyError) as caught:
        guard.check_target(q, 0.1)
    assert (caught.value.quantity, caught.value.joint) == ("floor", "tip")
    assert caught.value.value == pytest.approx(-0.05, abs=1e-6)
    assert caught.value.limit == pytest.approx(-0.01)


@given(arrays(float, (3, 6), elements=st.floats(-6, 6)), arrays(float, 3, elements=st.floats(-3, 3)))
@FEW
def test_heights_agree_with_forward_kinematics(q, tilt):
    world_T_base = spatial.transform(spatial.rotation_from_vector(tilt), np.array([0.1, -0.2, 0.3]))
    arm = CONFIRMED.arm.kinematics
    flange = world_T_base @ arm.forward(q)
    tip = flange @ spatial.transform(None, np.array([0, 0, 0.235]))
    got = heights(arm, q, world_T_base[2], 0.235)
    np.testing.assert_allclose(got, (flange[:, 2, 3], tip[:, 2, 3]), atol=1e-9)


steps = st.one_of(
    st.floats(-1e-4, 1e-4), st.floats(allow_nan=True, allow_infinity=True), st.sampled_from([1e-7, 6.28e-3, 6.3e-3])
)


@given(st.lists(st.tuples(arrays(float, (2, 6), elements=steps), steps), min_size=1, max_size=8))
@FEW
def test_whatever_is_asked_what_is_sent_obeys_the_limits(perfect_robot, rig, blocks):
    robot = perfect_robot(rig.arm.home)
    guard = Guard(robot, rig)
    for change, opening_change in blocks:
        with np.errstate(all="ignore"):
            setpoints = guard.last_sent + change
            openings = np.full(2, guard.last_opening + opening_change)
        try:
            guard.send(setpoints, openings)
        except SafetyError:
            continue
    sent = np.array([rig.arm.home] * 3 + robot.sent)
    assert np.isfinite(sent).all()
    for limit in (rig.arm.velocity_limit, rig.arm.acceleration_limit, rig.arm.jerk_limit):
        sent = np.diff(sent, axis=0) / SERVO_PERIOD
        assert (np.abs(sent) <= limit * (1 + 1e-5)).all()
    assert (
        np.abs(np.diff(robot.openings, prepend=0.1)) <= rig.gripper.facts.speed[1] * SERVO_PERIOD * (1 + 1e-5)
    ).all()


def test_a_robot_measured_outside_its_limits_is_not_started(perfect_robot, rig):
    with pytest.raises(SafetyError, match="elbow_joint"):
        Guard(perfect_robot(np.array([0, -1.5, 3.2, 0, 0, 0])), rig)


CONFIRMED = load_rig(RIG_FILE)
"""A rig with a controller."""


def limited(**controller):
    return replace(CONFIRMED, controller=replace(CONFIRMED.controller, **controller))


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", ["low", "high"])
def test_the_tip_stays_in_the_workspace(perfect_robot, axis, side):
    rig = CONFIRMED
    tip = rig.tip_pose(rig.arm.home)[:3, 3]
    edge = {s: getattr(rig.controller, f"workspace_{s}").copy() for s in ("low", "high")}
    edge[side][axis] = tip[axis] + (0.002 if side == "low" else -0.002)
    narrow = limited(workspace_low=edge["low"], workspace_high=edge["high"])
    with pytest.raises(SafetyError, match=f"{'xyz'[axis]} = ") as caught:
        Guard(perfect_robot(rig.arm.home), narrow)
    assert caught.value.quantity == "workspace"
    assert caught.value.value == pytest.approx(tip[axis])


def test_parts_of_the_arm_do_not_meet(guard, robot, rig):
    folded = rig.arm.home.copy()
    folded[4] = -3.0
    with pytest.raises(SafetyError) as caught:
        guard.check_target(folded, 0.1)
    assert caught.value.quantity == "clearance" and caught.value.value < caught.value.limit
    # Nor on the way to a place that is free.
    stream = Stream(robot, rig, guard=guard)
    beyond = rig.arm.home.copy()
    beyond[4] = -4.6
    with pytest.raises(SafetyError, match="mm from"):
        stream.run(JointTarget(beyond, 0.1), 4.0, travel=True)
    assert robot.sent == []


def test_an_arm_that_stands_too_near_has_to_be_moved_by_hand(perfect_robot, rig):
    folded = rig.arm.home.copy()
    folded[4] = -3.0
    with pytest.raises(SafetyError, match="from where it stands") as caught:
        Guard(perfect_robot(folded), rig)
    assert caught.value.quantity == "clearance"
    assert "by hand on the teach pendant" in caught.value.fix


def test_only_the_hand_comes_near_an_obstacle(guard, rig):
    tip = rig.tip_pose(rig.arm.home)
    at_tip = Obstacle("box", spatial.transform(None, tip[:3, 3]), np.array([0.2, 0.2, 0.05]))
    guard.keep_out(at_tip)
    guard.check_target(rig.arm.home, 0.1)
    at_wrist = Obstacle("post", spatial.transform(None, tip[:3, 3] + np.array([0, 0, 0.3])), np.array([0.1, 0.1, 0.05]))
    guard.keep_out(at_tip, at_wrist)
    with pytest.raises(SafetyError, match="mm from post"):
        guard.check_target(rig.arm.home, 0.1)


def turn(stream, rig, speed, seconds, joint=0):
    for k in range(1, round(seconds / 0.1) + 1):
        q = rig.arm.home.copy()
        q[joint] += speed * 0.1 * k
        stream.run(JointTarget(q, 0.1), 0.1)


def tip_speeds(robot, rig):
    tips = np.array([rig.tip_pose(q)[:3, 3] for q in [rig.arm.home, *robot.sent]])
    return np.linalg.norm(np.diff(tips, axis=0), axis=1) / SERVO_PERIOD


@pytest.mark.parametrize("speed", [0.3, 2.0])
def test_until_it_is_confirmed_the_tip_is_slow_and_gets_there(perfect_robot, speed):
    rig = limited(full_speed=False)
    robot = perfect_robot(rig.arm.home)
    stream = Stream(robot, rig)
    turn(stream, rig, speed, 0.5)
    stream.settle(1e-4)
    speeds = tip_speeds(robot, rig)
    assert speeds.max() <= FIRST_RUN_SPEED
    # As long as a quarter of full speed takes, or the way at that speed, and settling.
    fastest = max(0.5 / FIRST_RUN_PACE, speeds.sum() * SERVO_PERIOD / (PACE_MARGIN * FIRST_RUN_SPEED))
    assert len(robot.sent) * SERVO_PERIOD < 2.0 * fastest + 1.0
    np.testing.assert_allclose(robot.sent[-1][0], rig.arm.home[0] + 0.5 * speed, atol=1e-3)
    confirmed = perfect_robot(rig.arm.home)
    turn(Stream(confirmed, CONFIRMED), CONFIRMED, speed, 0.5)
    assert len(robot.sent) > 2 * len(confirmed.sent)


@pytest.mark.parametrize("duration", [0.01, 0.02, 0.03])
def test_until_it_is_confirmed_more_time_is_given_as_long_as_it_helps(perfect_robot, duration):
    """Its tip is as fast as it may be and gains speed yet, when the next target comes: no more time changes that."""
    rig = limited(full_speed=False)
    robot = perfect_robot(rig.arm.home)
    stream = Stream(robot, rig)
    goal = rig.arm.home + 1.5 * np.eye(6)[0]
    for _ in range(200):
        if np.allclose(stream.target.arm, goal) and np.allclose(robot.sent[-1], goal):
            break
        stream.run(JointTarget(goal, 0.1), duration, travel=True)
    np.testing.assert_allclose(robot.sent[-1], goal, atol=1e-9)
    speeds = tip_speeds(robot, rig)
    assert PACE_MARGIN * FIRST_RUN_SPEED < speeds.max() <= FIRST_RUN_SPEED
    way = speeds.sum() * SERVO_PERIOD
    assert len(robot.sent) * SERVO_PERIOD < 2.0 * way / (PACE_MARGIN * FIRST_RUN_SPEED)


def test_until_it_is_confirmed_the_guard_itself_refuses_a_fast_tip(perfect_robot):
    slow, robot = limited(full_speed=False), perfect_robot(CONFIRMED.arm.home)
    stream = Stream(robot, CONFIRMED, guard=Guard(robot, slow))
    with pytest.raises(SafetyError, match="confirmed") as caught:
        turn(stream, CONFIRMED, 1.0, 1.0)
    assert caught.value.quantity == "tip speed"
    assert caught.value.value > FIRST_RUN_SPEED == caught.value.limit


def test_until_it_is_confirmed_it_still_brakes_as_hard_as_it_can(perfect_robot):
    rig = limited(full_speed=False)
    robot = perfect_robot(rig.arm.home)
    stream = Stream(robot, rig)
    turn(stream, rig, 0.3, 1.0)
    before = len(robot.sent)
    stream.stop()
    assert len(robot.sent) - before < 0.15 / SERVO_PERIOD


def test_the_guard_is_the_only_road_to_a_command():
    """No other source file hands a setpoint to a robot, and one alone to the controller's client."""
    root = Path(resync_robot.__file__).resolve().parents[1]
    rooms = ("hardware", "resync_robot", "sim_training", "perception", "policies", "calibration")
    callers, senders = set(), set()
    for file in (f for room in rooms for f in (root / room).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Attribute):
                if node.attr in ("servo", "play") and not (
                    isinstance(node.value, ast.Name) and node.value.id == "self"
                ):
                    callers.add(file.relative_to(root).as_posix())
                if node.attr in ("servoJ", "servoL", "moveJ", "moveL", "speedJ", "speedL"):
                    senders.add(file.relative_to(root).as_posix())
    assert callers == {"hardware/safety.py"}
    assert senders == {"hardware/ur_link.py"}
