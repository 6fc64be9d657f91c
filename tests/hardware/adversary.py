"""Targets that no robot should be given, mixed with some that it may, and what must hold of whatever was sent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hardware.base import SERVO_PERIOD
from hardware.clearance import Clearance
from hardware.stream import Stream
from resync_robot.core import kinematics
from resync_robot.core.errors import MotionError
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig

ROUNDING = 1e-6
BAD = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e9)
KINDS = (
    "step", "step", "not a number", "wrong length", "jump", "anywhere", "edge", "folded", "opening", "duration",
)  # fmt: skip


def attack(stream: Stream, rig: Rig, kind: str, rng: np.random.Generator) -> bool:
    """Give the stream one target of that kind; whether it was taken."""
    arm: np.ndarray = stream.target.arm + rng.normal(0, 0.004, 6)
    opening, duration, travel = 0.1, 0.02, bool(rng.random() < 0.3)
    joint = rng.integers(6)
    if kind == "not a number":
        arm[joint] = rng.choice(BAD)
    elif kind == "wrong length":
        arm = (arm[:joint], np.tile(arm, 2), arm[None], np.array(1.0), np.zeros((2, 3)), np.empty(0))[joint]
    elif kind == "jump":
        arm[joint] += rng.choice([-1, 1]) * rng.uniform(0.1, 8.0)
    elif kind == "anywhere":
        arm = rng.uniform(-7, 7, 6)
    elif kind == "edge":
        arm[joint] = rng.choice([-1, 1]) * np.nextafter(kinematics.JOINT_LIMIT[joint], rng.choice([-9.0, 9.0]))
    elif kind == "folded":
        arm[2], arm[4] = rng.choice([3.0, arm[2]]), rng.choice([-3.0, 3.0])
    elif kind == "opening":
        opening = float(rng.choice([*BAD, -1e-9, rig.gripper.max_opening * (1 + 1e-9), 9.0]))
    elif kind == "duration":
        duration = float(rng.choice([*BAD, 0.0, -0.02, 1e-9]))
    # Far targets that may be reached would take minutes of motion each.
    travel = travel and kind not in ("anywhere", "edge", "folded", "jump")
    try:
        stream.run(JointTarget(arm, opening), duration, travel)
    except MotionError:
        return False
    return True


def assert_nothing_out_of_limits(sent: Sequence[np.ndarray], rig: Rig) -> None:
    """Every setpoint, with the arm at rest at home before the first: limits, workspace, room."""
    wire = np.array(sent)
    assert wire.shape == (len(sent), 6) and np.isfinite(wire).all()
    assert (np.abs(wire) <= kinematics.JOINT_LIMIT).all()
    motion = np.concatenate([[rig.arm.home] * 3, wire])
    for limit in (rig.arm.velocity_limit, rig.arm.acceleration_limit, rig.arm.jerk_limit):
        motion = np.diff(motion, axis=0) / SERVO_PERIOD
        assert (np.abs(motion) <= limit * (1 + ROUNDING)).all()
    clearance = Clearance(rig)
    for part in np.array_split(wire, max(1, len(wire) // 2000)):
        frames = clearance.frames(part)
        assert clearance.smallest(frames).distance > 0
        if rig.controller is not None:
            tips = frames[:, -1, :3, 3] + rig.gripper.tip_offset * frames[:, -1, :3, 2]
            # Looked at every fifth setpoint; in between the tip goes a little further.
            assert (tips >= rig.controller.workspace_low - 0.01).all()
            assert (tips <= rig.controller.workspace_high + 0.01).all()
