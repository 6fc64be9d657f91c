"""What every arm must do, whatever stands behind it."""

from __future__ import annotations

import time

import numpy as np
import pytest

from resync_robot.core.joints import JointTarget
from resync_robot.hardware.base import SERVO_PERIOD, Robot, RobotError, SafetyError
from resync_robot.hardware.safety import Guard
from resync_robot.hardware.stream import Stream
from tests.contracts.conftest import OPEN, Backend


def hold(robot: Robot, q: np.ndarray, opening: float, seconds: float) -> None:
    for _ in range(round(seconds / SERVO_PERIOD)):
        robot.servo(q, opening)


def test_a_state_is_whole_finite_and_stays_as_it_was(backend: Backend) -> None:
    with backend.robot as robot:
        state = robot.state()
        assert (state.q.shape, state.qd.shape, state.tip_force.shape) == ((6,), (6,), (3,))
        assert np.isfinite([*state.q, *state.qd, *state.tip_force, state.opening, state.time]).all()
        np.testing.assert_allclose(state.q, backend.rig.arm.home, atol=1e-9)
        assert state.opening == pytest.approx(backend.share(OPEN), abs=1e-3)
        hold(robot, backend.rig.arm.home + 1e-3, backend.share(OPEN), 0.2)
        np.testing.assert_allclose(state.q, backend.rig.arm.home, atol=1e-9)
        assert (robot.state().q != state.q).any()


def test_the_arm_follows_setpoints_and_holds_the_last(backend: Backend) -> None:
    with backend.robot as robot:
        stream = Stream(robot, backend.rig)
        goal = backend.rig.arm.home + np.array([0.1, 0.02, -0.03, 0.0, 0.05, -0.1])
        for _ in range(6):
            stream.run(JointTarget(goal, backend.share(OPEN)), 0.1)
        assert stream.settle(tolerance=1e-3, timeout=3.0)
        np.testing.assert_allclose(robot.state().q, goal, atol=1e-3)
        assert np.abs(robot.state().qd).max() < 0.02


def test_the_robots_clock_advances_with_setpoints(backend: Backend) -> None:
    with backend.robot as robot:
        before = robot.state()
        hold(robot, before.q, backend.share(OPEN), 0.5)
        after = robot.state().time
        # A robot in real time takes setpoints ahead of their time, and its clock runs between calls as well.
        assert 0.3 <= after - before.time <= 5.0


def test_setpoints_belong_to_the_caller(backend: Backend) -> None:
    with backend.robot as robot:
        q = robot.state().q
        for _ in range(50):
            robot.servo(q, backend.share(OPEN))
            q[:] = backend.rig.arm.home
        np.testing.assert_allclose(robot.state().q, backend.rig.arm.home, atol=1e-6)


def test_the_opening_follows(backend: Backend) -> None:
    with backend.robot as robot:
        stream, half = Stream(robot, backend.rig), backend.share(0.5)
        for _ in range(10):
            stream.run(JointTarget(backend.rig.arm.home, half), 0.1)
        deadline = time.monotonic() + 5.0
        while abs(robot.state().opening - half) > 2e-3 and time.monotonic() < deadline:
            stream.run(JointTarget(backend.rig.arm.home, half), 0.1)
        assert robot.state().opening == pytest.approx(half, abs=2e-3)


def test_an_object_between_the_pads_is_detected_and_lost_again(backend: Backend) -> None:
    with backend.robot as robot:
        backend.arm.object_width = width = backend.share(0.4)
        stream = Stream(robot, backend.rig)

        def run_until(held: bool, opening: float) -> bool:
            deadline = time.monotonic() + 8.0
            while backend.gripper.state().object_detected is not held and time.monotonic() < deadline:
                stream.run(JointTarget(backend.rig.arm.home, opening), 0.1)
            return backend.gripper.state().object_detected is held

        assert not backend.gripper.state().object_detected
        assert run_until(True, 0.0)
        assert robot.state().opening == pytest.approx(width, abs=2e-3)
        assert run_until(False, backend.share(0.85))


@pytest.mark.parametrize("bad", [np.nan, np.inf, 7.0], ids=["nan", "inf", "outside"])
def test_what_the_guard_refuses_never_reaches_the_arm(backend: Backend, bad: float) -> None:
    with backend.robot as robot:
        stream = Stream(robot, backend.rig)
        target = backend.rig.arm.home.copy()
        target[2] = bad
        with pytest.raises(SafetyError, match="elbow_joint"):
            stream.run(JointTarget(target, backend.share(OPEN)), 0.1)
        with pytest.raises(SafetyError, match="shape"):
            stream.run(JointTarget(np.zeros(5), backend.share(OPEN)), 0.1)
        with pytest.raises(SafetyError, match="jump"):
            stream.run(JointTarget(backend.rig.arm.home + np.array([1.0, 0, 0, 0, 0, 0]), backend.share(OPEN)), 0.02)
        time.sleep(0.05)
        np.testing.assert_allclose(robot.state().q, backend.rig.arm.home, atol=1e-6)


def test_unconnected_and_closed_robots_say_so(backend: Backend) -> None:
    robot = backend.robot
    for _ in range(2):
        with pytest.raises(RobotError, match="not connected"):
            robot.state()
        with pytest.raises(RobotError, match="not connected"):
            robot.servo(backend.rig.arm.home, backend.share(OPEN))
        with robot:
            robot.state()
        robot.close()


def test_a_second_connection_begins_where_the_arm_stands(backend: Backend) -> None:
    with backend.robot as robot:
        stream = Stream(robot, backend.rig)
        for _ in range(4):
            stream.run(JointTarget(backend.rig.arm.home + 0.05, backend.share(OPEN)), 0.1)
        stream.stop()
        stream.settle()
    with backend.robot as robot:
        guard = Guard(robot, backend.rig)
        np.testing.assert_allclose(guard.last_sent, robot.state().q, atol=1e-6)
        np.testing.assert_allclose(guard.last_sent, backend.rig.arm.home + 0.05, atol=2e-3)


def test_effort_limits_are_taken(backend: Backend) -> None:
    with backend.robot as robot:
        robot.limit_effort((40.0, 40.0, 40.0, 12.0, 12.0, 12.0))
        robot.limit_effort(None)
        assert np.isfinite(robot.state().q).all()
