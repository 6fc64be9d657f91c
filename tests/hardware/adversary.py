"""Targets that no robot should be given, mixed with some that it may, and what must hold of whatever was sent.

From home few of them move the arm to a place where anything is near; so it also starts where a limit begins.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from resync_robot.core.errors import MotionError
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig
from resync_robot.hardware.base import SERVO_PERIOD, SafetyError
from resync_robot.hardware.clearance import Clearance
from resync_robot.hardware.safety import Guard
from resync_robot.hardware.stream import JUMP_SLACK, Stream
from resync_robot.hardware.workspace import MARGIN
from tests.hardware.conftest import PerfectRobot
from tests.stalls import never_excused

ROUNDING = 1e-6
BAD = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e9)
MOVES = ("step", "push", "travel")
"""Near a place where the arm may still be; what they may lead out of depends on where it stands."""
KINDS = (
    *MOVES, "not a number", "wrong length", "jump", "anywhere", "edge", "folded", "opening", "duration",
)  # fmt: skip
TAKEN = "taken"


def starts(rig: Rig) -> dict[str, np.ndarray]:
    """Joint positions of an arm that may just be there, by the quantity that forbids to go on in some direction."""
    home = rig.arm.home
    beyond = {quantity: home.copy() for quantity in ("position", "clearance", "floor", "workspace")}
    beyond["position"][5] = -6.5
    beyond["clearance"][4] = -3.0
    beyond["floor"][1] += 0.9
    beyond["workspace"][0] += 2.2
    return {"home": home, **{quantity: _last_allowed(rig, q, quantity) for quantity, q in beyond.items()}}


def _last_allowed(rig: Rig, beyond: np.ndarray, quantity: str) -> np.ndarray:
    """On the way from home, as near to where the guard begins to refuse for that reason as 1 % of the way."""
    guard = Guard(PerfectRobot(rig.arm.home), rig)
    low, high, why = 0.0, 1.0, "nothing"
    while high - low > 0.005:
        middle = (low + high) / 2
        try:
            guard.check_target(rig.arm.home + middle * (beyond - rig.arm.home), 0.1)
            low = middle
        except SafetyError as error:
            high, why = middle, error.quantity
    if why != quantity:
        raise LookupError(f"{quantity}: the guard refuses {why} there")
    return rig.arm.home + (low - 0.005) * (beyond - rig.arm.home)


def attack(stream: Stream, rig: Rig, kind: str, rng: np.random.Generator) -> str:
    """Give the stream one target of that kind; TAKEN, or the quantity for which it was refused."""
    arm: np.ndarray = stream.target.arm + rng.normal(0, 0.004, 6)
    opening, duration, travel = 0.1, 0.02, bool(rng.random() < 0.3)
    joint = rng.integers(6)
    if kind == "push":
        arm[joint] += rng.choice([-1, 1]) * rng.uniform(0.0, JUMP_SLACK)
        duration, travel = 0.1, False
    elif kind == "travel":
        arm += rng.uniform(-0.3, 0.3, 6) * (rng.random(6) < 0.4)
        duration, travel = 0.2, True
    elif kind == "not a number":
        arm[joint] = rng.choice(BAD)
    elif kind == "wrong length":
        arm = (arm[:joint], np.tile(arm, 2), arm[None], np.array(1.0), np.zeros((2, 3)), np.empty(0))[joint]
    elif kind == "jump":
        arm[joint] += rng.choice([-1, 1]) * rng.uniform(0.1, 8.0)
    elif kind == "anywhere":
        arm = rng.uniform(-7, 7, 6)
    elif kind == "edge":
        arm[joint] = rng.choice([-1, 1]) * np.nextafter(rig.arm.kinematics.joint_limit[joint], rng.choice([-9.0, 9.0]))
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
    except SafetyError as error:
        return error.quantity
    except MotionError:
        return "motion"
    return TAKEN


@never_excused()
def assert_rates_hold(motion: np.ndarray, rig: Rig) -> None:
    """Velocity, acceleration and jerk of setpoints (n, 6), by their differences."""
    for limit in (rig.arm.velocity_limit, rig.arm.acceleration_limit, rig.arm.jerk_limit):
        motion = np.diff(motion, axis=0) / SERVO_PERIOD
        assert (np.abs(motion) <= limit * (1 + ROUNDING)).all()


@never_excused()
def assert_nothing_out_of_limits(sent: Sequence[np.ndarray], rig: Rig, start: np.ndarray | None = None) -> None:
    """Every setpoint, with the arm at rest at `start`, or home, before the first: limits, workspace, room."""
    wire = np.array(sent)
    assert wire.shape == (len(sent), 6) and np.isfinite(wire).all()
    assert (np.abs(wire) <= rig.arm.kinematics.joint_limit).all()
    assert_rates_hold(np.concatenate([[rig.arm.home if start is None else start] * 3, wire]), rig)
    clearance = Clearance(rig)
    for part in np.array_split(wire, max(1, len(wire) // 2000)):
        frames = clearance.frames(part)
        # Looked at every few setpoints; in between the arm comes a little nearer.
        assert clearance.smallest(frames).distance > MARGIN - 2e-3
        if rig.controller is not None:
            tips = frames[:, -1, :3, 3] + rig.gripper.tip_offset * frames[:, -1, :3, 2]
            assert (tips >= rig.controller.workspace_low - 0.01).all()
            assert (tips <= rig.controller.workspace_high + 0.01).all()
