"""What the emulator finds in the setpoints that it is sent."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core.rig import load_rig
from resync_robot.hardware.base import SERVO_PERIOD
from resync_robot.hardware.emulator.arm import KinematicArm
from resync_robot.hardware.emulator.controller import Controller
from resync_robot.hardware.emulator.judge import Judge
from resync_robot.hardware.emulator.program import Command
from resync_robot.hardware.generator import Generator, Motion

RIG = load_rig()
HOME = RIG.arm.home


@pytest.fixture
def judge() -> Judge:
    judge = Judge(RIG.arm)
    judge.begin(HOME)
    return judge


def way(pace: float) -> np.ndarray:
    """Setpoints to a place 0.4 rad away and through it, at that share of the limits."""
    begin = Motion(HOME, np.zeros(6), np.zeros(6))
    found = Generator(RIG.arm, pace).towards(begin, HOME + 0.4, np.zeros(6), 0.0)
    return found.setpoints(round(found.duration / SERVO_PERIOD) + 5)


def test_the_fastest_way_within_the_limits_breaks_none_and_comes_near_them(judge: Judge) -> None:
    setpoints = way(1.0)
    for q in setpoints:
        judge.take(q)
    assert (judge.count, judge.broken) == (len(setpoints), 0)
    assert all(0.9 < judge.worst[name] <= 1 + 1e-6 for name in ("acceleration", "jerk"))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (np.nan, "position"),
        (np.inf, "position"),
        (9.0, "position"),
        (0.5, "velocity"),
        (1.5 * RIG.arm.jerk_limit[2] * SERVO_PERIOD**3, "jerk"),
    ],
)
def test_one_setpoint_that_is_out_of_a_limit_is_found(judge: Judge, change: float, word: str) -> None:
    for k in range(20):
        q = HOME.copy()
        q[2] += change * (k == 10)
        judge.take(q)
    assert judge.broken >= 1
    assert f"setpoint 11: {word} of elbow_joint" in " ".join(judge.reasons)


def test_a_stop_without_braking_is_found(judge: Judge) -> None:
    setpoints = way(0.5)
    middle = len(setpoints) // 2
    for q in [*setpoints[:middle], *[setpoints[middle]] * 5]:
        judge.take(q)
    assert "acceleration" in judge.reasons[0] and judge.worst["velocity"] < 1


def test_a_program_begins_where_the_arm_is(judge: Judge) -> None:
    judge.begin(HOME + 0.3)
    judge.take(HOME + 0.3)
    assert judge.broken == 0
    judge.begin(HOME + 0.3)
    judge.take(HOME)
    assert judge.broken == 1


def test_a_controller_has_every_servo_setpoint_judged_and_nothing_else() -> None:
    controller = Controller(KinematicArm(HOME))
    controller.judge = Judge(RIG.arm)

    def write(command: Command, q: np.ndarray) -> None:
        registers = {f"input_double_register_{i}": float(x) for i, x in enumerate(q)}
        controller.on_input({"input_int_register_0": int(command), **registers})

    write(Command.SERVOJ, HOME + 1.0)
    controller.start_program("def rtde_control():\nend")
    write(Command.SERVOJ, HOME)
    write(Command.SET_PAYLOAD, np.ones(6))
    assert (controller.judge.count, controller.judge.broken) == (1, 0)
    write(Command.SERVOJ, HOME + 1.0)
    assert (controller.judge.count, controller.judge.broken) == (2, 1)
