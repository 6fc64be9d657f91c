"""The simulated drivers behave like drivers."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.hardware.base import Camera, Gripper, Robot, RobotError
from resync_robot.hardware.sim import SimCamera, SimGripper, SimRobot


def test_physics_steps_on_every_fifth_setpoint_with_the_latest(lagging_physics, rig):
    physics = lagging_physics(rig.arm.home)
    with SimRobot(physics) as robot:
        for k in range(1, 13):
            robot.servo(rig.arm.home + k * 1e-4, 0.1)
    assert len(physics.driven) == 2
    np.testing.assert_allclose([q[0] - rig.arm.home[0] for q, _ in physics.driven], [5e-4, 10e-4])
    assert physics.time == pytest.approx(0.02)


def test_state_is_a_copy_of_the_measurement(lagging_physics, rig):
    physics = lagging_physics(rig.arm.home)
    with SimRobot(physics) as robot:
        before = robot.state()
        for _ in range(5):
            robot.servo(rig.arm.home + 0.01, 0.05)
        after = robot.state()
    np.testing.assert_array_equal(before.q, rig.arm.home)
    assert (after.q > before.q).all() and (after.qd > 0).all()
    assert (before.time, after.time) == (0.0, 0.01)
    assert 0.05 < after.opening < 0.1
    physics.q[:] = 0
    assert (after.q != 0).all()


def test_not_connected_is_an_error(lagging_physics, rig):
    robot = SimRobot(lagging_physics(rig.arm.home))
    with pytest.raises(RobotError, match="not connected"):
        robot.servo(rig.arm.home, 0.1)
    with robot:
        robot.servo(rig.arm.home, 0.1)
    robot.close()
    with pytest.raises(RobotError, match="not connected"):
        robot.servo(rig.arm.home, 0.1)


@pytest.mark.parametrize("period", [0.003, 0.001, 0.0])
def test_a_physics_period_that_does_not_fit(lagging_physics, rig, period):
    physics = lagging_physics(rig.arm.home)
    physics.period = period
    with pytest.raises(RobotError, match="multiples"):
        SimRobot(physics)


def test_gripper_detects_an_object_where_the_pads_stop_short(lagging_physics, rig):
    physics = lagging_physics(rig.arm.home, opening=0.06)
    with SimGripper(physics) as gripper:
        assert not gripper.state().object_detected
        gripper.move(0.0)
        assert gripper.state().object_detected
        assert gripper.state().opening == 0.06
        gripper.move(0.06)
        assert not gripper.state().object_detected


def test_camera_gives_a_frame_of_its_own_name(lagging_physics, rig):
    physics = lagging_physics(rig.arm.home)
    physics.time = 0.25
    with SimCamera(physics, "wrist") as camera:
        frame = camera.capture()
    assert (frame.name, frame.time, camera.name) == ("wrist", 0.25, "wrist")


def test_the_drivers_fit_the_protocols(lagging_physics, rig):
    physics = lagging_physics(rig.arm.home)
    drivers: list[tuple[object, type]] = [
        (SimRobot(physics), Robot),
        (SimGripper(physics), Gripper),
        (SimCamera(physics, "front"), Camera),
    ]
    for driver, protocol in drivers:
        wanted = {n for base in protocol.__mro__ for n in vars(base) if not n.startswith("_")} - {"is_protocol"}
        assert wanted <= set(dir(driver))
