"""How a recovery by pressing begins, sees and acts in training: as the finished skill does."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from resync_robot.core.rig import load_rig
from resync_robot.learning.recovery_policy import STEP, observe, project
from resync_robot.planning.skill_run import run_skill
from resync_robot.policies.press_interface import PressInterface, PressVariety
from resync_robot.sim_training.physics.world import SimWorld
from tests import scenes
from tests.scenes import B0, THE_BOX, R

RIG = load_rig()
OBJECTS = (R, B0, THE_BOX)
PUNCTUAL = PressVariety(lag=0.0)


@pytest.fixture
def world() -> SimWorld:
    return SimWorld(scenes.scene({"b0": (scenes.CORNER, scenes.CORNER)}), RIG)


def test_the_policy_takes_over_with_the_closed_hand_near_the_stud_at_many_places() -> None:
    interface, places = PressInterface(RIG), []
    assert interface.approach is not None
    for x in (0.0, 0.01, 0.02, 0.03):
        world = SimWorld(scenes.scene({"b0": (scenes.CORNER - x, scenes.CORNER)}), RIG)
        assert run_skill(world, interface.approach.ground(OBJECTS)).done
        seen = interface.see([interface.begin(OBJECTS, world.perceive(), np.random.default_rng(0))], [world.perceive()])
        assert world.observe().opening < 0.01
        places.append(seen[0, 2:5] / 10)
    aside, above = np.abs(np.array(places)[:, :2]), np.array(places)[:, 2]
    assert aside.max() < 0.015 and above.min() > 0 and above.max() < 0.075
    assert np.ptp(above) > 0.01, "not always the same"


def test_it_sees_and_sends_what_the_skill_does(world: SimWorld) -> None:
    interface = PressInterface(RIG, PUNCTUAL)
    assert interface.approach is not None
    run_skill(world, interface.approach.ground(OBJECTS))
    state = world.perceive()
    run = interface.begin(OBJECTS, state, np.random.default_rng(0))
    tip = state.get(R, "x", "y", "z")
    expected = observe(project(state, *OBJECTS, tip)).double().numpy()
    np.testing.assert_allclose(interface.see([run], [state]), expected, atol=1e-6)
    (target,) = interface.act([run], [state], np.array([[0.0, 0.0, 1.0]]))
    np.testing.assert_allclose(RIG.tip_pose(target.arm)[:3, 3], tip + [0, 0, STEP], atol=1e-4)
    np.testing.assert_allclose(run.commanded, tip + [0, 0, STEP], atol=1e-4)
    world.act(target, 1 / interface.rate_hz)
    # The drives themselves are a little late, too.
    assert tip[2] + 0.4 * STEP < world.perceive().get(R, "z")[0] < tip[2] + 1.1 * STEP


def test_a_late_arm_is_sent_behind_its_command(world: SimWorld) -> None:
    state, sent = world.perceive(), []
    for lag in (0.0, 0.5):
        interface = PressInterface(RIG)
        run = interface.begin(OBJECTS, state, np.random.default_rng(0))
        run.lag = lag
        (target,) = interface.act([run], [state], np.array([[0.0, 0.0, -1.0]]))
        sent.append(RIG.tip_pose(target.arm)[2, 3])
    assert sent[1] - sent[0] == pytest.approx(0.5 * STEP, abs=1e-4)
    lags = [PressInterface(RIG).begin(OBJECTS, state, np.random.default_rng(i)).lag for i in range(20)]
    assert min(lags) < 0.2 and 0.7 < max(lags) <= 0.9


def test_scenes_do_not_mix(world: SimWorld) -> None:
    interface = PressInterface(RIG, PUNCTUAL)
    other = SimWorld(scenes.scene({"b0": (0.0, 0.0)}), RIG)
    states = [world.perceive(), other.perceive()]
    runs = [interface.begin(OBJECTS, state, np.random.default_rng(0)) for state in states]
    together = interface.see(runs, states)
    np.testing.assert_allclose(together[1:], interface.see(runs[1:], states[1:]))
    assert not torch.allclose(torch.as_tensor(together[0]), torch.as_tensor(together[1]))


def test_it_ends_as_the_skill_does_straight_up_and_over_the_walls(world: SimWorld) -> None:
    interface = PressInterface(RIG, PUNCTUAL)
    assert interface.approach is not None and interface.leave is not None
    run_skill(world, interface.approach.ground(OBJECTS))
    run = interface.begin(OBJECTS, world.perceive(), np.random.default_rng(0))
    for _ in range(12):
        (target,) = interface.act([run], [world.perceive()], np.array([[-0.3, -0.3, -1.0]]))
        world.act(target, 1 / interface.rate_hz)
    pressed = world.perceive()
    assert run_skill(world, interface.leave.ground(OBJECTS)).done
    left = world.perceive()
    np.testing.assert_allclose(left.get(R, "x", "y"), pressed.get(R, "x", "y"), atol=0.02)
    assert left.get(R, "z")[0] > left.get(THE_BOX, "z", "wall_z").sum()
