"""Travel ends where it is asked to, at rest, and no faster than it is asked to."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core.rig import Rig
from resync_robot.hardware.base import SERVO_PERIOD, SafetyError
from resync_robot.hardware.joint_moves import SETTLE_S, travel
from resync_robot.hardware.sim import SimRobot
from resync_robot.hardware.stream import Stream


@pytest.mark.parametrize("speed", [0.5, 1.0])
def test_it_arrives_at_rest_and_keeps_the_speed(rig: Rig, perfect_robot, speed: float) -> None:
    robot = perfect_robot(rig.arm.home)
    goal = rig.arm.home + [0.4, 0.0, -0.1, 0.0, 0.0, 1.0]
    travel(Stream(robot, rig), goal, speed)
    np.testing.assert_allclose(robot.q, goal, atol=2e-3)
    sent = np.array(robot.sent)
    # The jerk-limited stream catches up after its start, hence the tenth.
    assert np.abs(np.diff(sent, axis=0)).max() / SERVO_PERIOD < 1.1 * speed
    still = sent[-round(SETTLE_S / 2 / SERVO_PERIOD) :]
    assert np.ptp(still, axis=0).max() < 1e-4


def test_it_leaves_the_opening_alone_and_settles_a_lagging_arm(rig: Rig, lagging_physics) -> None:
    physics = lagging_physics(rig.arm.home, opening=0.05, lag=0.05)
    with SimRobot(physics) as robot:
        stream = Stream(robot, rig)
        goal = rig.arm.home + [0.2, 0, 0, 0, 0, 0]
        travel(stream, goal)
        np.testing.assert_allclose(physics.q, goal, atol=3e-3)
        assert np.abs(physics.qd).max() < 0.02
        assert stream.target.opening == pytest.approx(0.05)


def test_a_way_through_the_table_is_refused(rig: Rig, perfect_robot) -> None:
    robot = perfect_robot(rig.arm.home)
    with pytest.raises(SafetyError):
        travel(Stream(robot, rig), rig.arm.home + [0, 0.8, 0, 0, 0, 0])
    assert np.abs(np.array(robot.sent)[-1] - rig.arm.home).max() < 0.8
