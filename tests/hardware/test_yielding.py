"""An arm that yields, before a wall of springs and under forces of every kind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.rig import Rig, load_rig
from resync_robot.hardware.base import SERVO_PERIOD
from resync_robot.hardware.generator import Generator, Motion
from resync_robot.hardware.safety import FIRST_RUN_SPEED
from resync_robot.hardware.stream import PRESSING_SPEED
from resync_robot.hardware.workspace import Workspace
from resync_robot.hardware.yielding import FURTHEST, Yielding
from tests.emulators import RIG_FILE, sister
from tests.hardware.adversary import assert_nothing_out_of_limits

RIG = load_rig(RIG_FILE)
LIMIT = np.array([40.0, 40.0, 40.0, 12.0, 12.0, 12.0])
TOUCH, AHEAD = 0.02, 0.035
"""m below home where the springs begin, and how far below that the hand is sent."""


def lowered(depths: np.ndarray, rig: Rig = RIG) -> np.ndarray:
    """(n, 6) configurations with the tip so many m below home."""
    branch, q, path = rig.arm.kinematics.branch_of(rig.arm.home), rig.arm.home, []
    base_T_world, tip_T_flange = spatial.inverse(rig.arm.world_T_base), spatial.inverse(rig.gripper.flange_T_tip)
    for depth in depths:
        tip = rig.tip_pose(rig.arm.home)
        tip[2, 3] -= depth
        q = rig.arm.kinematics.inverse_along(base_T_world @ tip @ tip_T_flange, q, branch)
        path.append(q)
    return np.array(path)


def down_and_up(speed: float, hold: float = 2.5, rig: Rig = RIG) -> np.ndarray:
    """The path of a press into the springs at `speed` m/s at the most, `hold` s of it, and the way back."""
    way = TOUCH + AHEAD
    ticks = int(np.pi / 2 * way / speed / SERVO_PERIOD)
    down = way * (1 - np.cos(np.pi * np.arange(1, ticks + 1) / ticks)) / 2
    return lowered(np.concatenate([down, np.full(int(hold / SERVO_PERIOD), way), down[::-1], np.zeros(1500)]), rig)


def press(
    path: np.ndarray, stiffness: float, delay: float, limited: bool = True, rig: Rig = RIG
) -> tuple[np.ndarray, np.ndarray, Yielding]:
    """Setpoints sent, and the springs' force, N, at every tick. The arm lags by 10 ms; the force is noisy and late."""
    rng = np.random.default_rng(0)
    bias = np.array([3.0, -20.0, 15.0, 0.3, 0.2, 0.0])
    arm = Yielding(rig, Workspace(rig), LIMIT if limited else np.full(6, np.inf), rig.arm.home, bias)
    actual, sent, forces = rig.arm.home.copy(), [], []
    surface = rig.tip_pose(rig.arm.home)[2, 3] - TOUCH
    on_the_way = [np.zeros(6)] * round(delay / SERVO_PERIOD)
    for q in path:
        noise = rng.normal(0.0, [2.0, 2.0, 2.0, 0.1, 0.1, 0.1])
        sent.append(arm.follow(q, actual, bias + on_the_way[0] + noise))
        actual = actual + (1 - np.exp(-SERVO_PERIOD / 0.01)) * (sent[-1] - actual)
        force = stiffness * max(0.0, surface - rig.tip_pose(actual)[2, 3])
        on_the_way = [*on_the_way[1:], np.array([0.0, 0.0, force, 0.0, 0.0, 0.0])]
        forces.append(force)
    return np.array(sent), np.array(forces), arm


@pytest.mark.parametrize("stiffness", [1e4, 3e4, 1e5])
@pytest.mark.parametrize("delay", [0.002, 0.008])
def test_a_press_settles_at_the_limit_without_chatter(stiffness: float, delay: float) -> None:
    path = down_and_up(0.8 * PRESSING_SPEED)
    sent, force, _ = press(path, stiffness, delay)
    assert_nothing_out_of_limits(list(sent), RIG)
    allowed = (LIMIT[1:5] / np.abs(RIG.tip_jacobian(path[len(path) // 3])[2, 1:5])).min()
    assert 60 < allowed < 100
    down = int(np.argmax(force > 0))
    held = force[down + 750 : down + 1250]
    assert held.mean() == pytest.approx(allowed, rel=0.15)
    assert held.std() < 0.03 * allowed
    # Once away from the springs it is where it is sent again.
    np.testing.assert_allclose(sent[-1], path[-1], atol=2e-3)
    assert force[-1] == 0.0


@pytest.mark.parametrize("model", ["ur3e", "ur5e", "ur10e", "ur16e"])
def test_a_longer_or_shorter_arm_settles_as_well(model: str) -> None:
    rig = sister(model)
    path = down_and_up(0.8 * PRESSING_SPEED, rig=rig)
    sent, force, _ = press(path, 1e5, 0.008, rig=rig)
    assert_nothing_out_of_limits(list(sent), rig)
    held = force[int(np.argmax(force > 0)) + 750 :][:500]
    allowed = (LIMIT[1:5] / np.abs(rig.tip_jacobian(path[len(path) // 3])[2, 1:5])).min()
    assert held.mean() == pytest.approx(allowed, rel=0.15)
    assert held.std() < 0.03 * allowed
    np.testing.assert_allclose(sent[-1], path[-1], atol=2e-3)


def test_without_a_limit_the_same_press_is_many_times_as_hard() -> None:
    _, force, _ = press(down_and_up(0.8 * PRESSING_SPEED), 3e4, 0.008, limited=False)
    assert force.max() == pytest.approx(3e4 * AHEAD, rel=0.05)


def test_in_the_air_it_keeps_to_its_path() -> None:
    way = Generator(RIG.arm, 0.7).towards(
        Motion(RIG.arm.home, np.zeros(6), np.zeros(6)), RIG.arm.home + 0.3, np.zeros(6), 0.0
    )
    path = way.setpoints(round(way.duration / SERVO_PERIOD) + 100)
    sent, _, arm = press(path, 0.0, 0.002)
    assert np.abs(sent - path).max() < 3e-3
    np.testing.assert_allclose(sent[-1], path[-1], atol=1e-4)
    while not arm.at_rest:
        arm.brake()


def walk(seed: int, count: int) -> np.ndarray:
    """Targets at every 50 ms as a stream would follow them."""
    rng = np.random.default_rng(seed)
    generator, motion, path = Generator(RIG.arm, 1.0), Motion(RIG.arm.home, np.zeros(6), np.zeros(6)), []
    for _ in range(count // 25):
        way = generator.towards(motion, RIG.arm.home + rng.uniform(-0.1, 0.1, 6), np.zeros(6), 0.05)
        path.append(way.setpoints(25))
        motion = way.at(25)
    return np.concatenate(path)


FORCES: dict[str, Callable[[np.random.Generator], np.ndarray]] = {
    "noise": lambda rng: rng.normal(0, 300, 6),
    "push": lambda rng: np.array([0, 0, 1e6, 0, 0, 0.0]),
    "pull": lambda rng: np.array([0, -1e4, -1e4, 0, 0, 50.0]),
    "none": lambda rng: np.zeros(6),
    "nan": lambda rng: np.full(6, np.nan),
    "infinite": lambda rng: np.array([np.inf, 0, 0, 0, 0, 0.0]),
    "huge": lambda rng: rng.uniform(-1, 1, 6) * 1e308,
}


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 1000),
    kinds=st.lists(st.sampled_from(sorted(FORCES)), min_size=4, max_size=4),
    brakes=st.integers(0, 399),
)
def test_whatever_is_felt_the_limits_hold(seed: int, kinds: list[str], brakes: int) -> None:
    path, rng = walk(seed, 400), np.random.default_rng(seed)
    arm = Yielding(RIG, Workspace(RIG), LIMIT, RIG.arm.home, np.zeros(6))
    sent: list[np.ndarray] = []
    for i, q in enumerate(path):
        wrench = FORCES[kinds[i // 100]](rng)
        sent.append(arm.follow(q, sent[-1] if sent else q, wrench) if i < brakes else arm.brake())
    for _ in range(200):
        sent.append(arm.brake())
    assert arm.at_rest
    assert_nothing_out_of_limits(sent, RIG)


def test_a_sensor_that_says_nonsense_moves_a_resting_arm_no_further_than_that() -> None:
    arm = Yielding(RIG, Workspace(RIG), LIMIT, RIG.arm.home, np.zeros(6))
    sent = [arm.follow(RIG.arm.home, RIG.arm.home, np.array([0, 0, 1e6, 0, 0, 0.0])) for _ in range(2000)]
    moved = np.abs(np.array(sent) - RIG.arm.home).max()
    assert 0.5 * FURTHEST < moved < 1.1 * FURTHEST
    assert_nothing_out_of_limits(sent, RIG)


def test_it_yields_no_further_than_it_may_be() -> None:
    """A push at the hand drives it out of the workspace, whose end is 30 mm away."""
    controller = RIG.controller
    assert controller is not None
    top = RIG.tip_pose(RIG.arm.home)[:3, 3] + np.array([1.0, 1.0, 0.03])
    narrow = replace(RIG, controller=replace(controller, workspace_high=top))
    heights = []
    for rig in (RIG, narrow):
        arm = Yielding(rig, Workspace(rig), LIMIT, rig.arm.home, np.zeros(6))
        sent = [arm.follow(rig.arm.home, rig.arm.home, np.array([0, 0, 3e2, 0, 0, 0.0])) for _ in range(1000)]
        heights.append(rig.tip_pose(np.array(sent))[:, 2, 3].max())
    assert heights[0] > top[2] + 0.005
    assert heights[1] <= top[2]


def test_until_it_is_confirmed_it_yields_slowly_too() -> None:
    controller = RIG.controller
    assert controller is not None
    slow = replace(RIG, controller=replace(controller, full_speed=False))
    arm = Yielding(slow, Workspace(slow), LIMIT, slow.arm.home, np.zeros(6))
    sent = [arm.follow(slow.arm.home, slow.arm.home, np.array([2e3, 2e3, 2e3, 0, 0, 0.0])) for _ in range(1000)]
    tips = slow.tip_pose(np.array(sent))[:, :3, 3]
    speeds = np.linalg.norm(np.diff(tips, axis=0), axis=1) / SERVO_PERIOD
    assert 0.02 < speeds.max() <= FIRST_RUN_SPEED
