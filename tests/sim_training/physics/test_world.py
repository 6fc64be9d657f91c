"""The simulated world: the same again bit by bit, put back where it was, and forces that can be believed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.vocabulary import BLOCK
from resync_robot.policies.cartesian import Hand
from resync_robot.sim_training.physics.scene import TORQUE
from resync_robot.sim_training.physics.world import SimWorld
from tests import scenes
from tests.scenes import B0, B1, THE_BOX, R

RIG = load_rig()
BLOCKS = {"b0": (0.0, 0.0), "b1": (0.119, 0.119)}


def joints_at(tip: np.ndarray) -> np.ndarray:
    """(6,) arm with the hand pointing down at a tip position in the world."""
    pose = spatial.transform(Hand.rotation(0.0), tip)
    flange = spatial.inverse(RIG.arm.world_T_base) @ pose @ spatial.inverse(RIG.gripper.flange_T_tip)
    return RIG.arm.kinematics.inverse(flange, RIG.arm.home)


def send(world: SimWorld, tip: np.ndarray, seconds: float, opening: float = 0.0) -> None:
    world.act(JointTarget(joints_at(tip), opening), seconds)


def history(world: SimWorld) -> list[bytes]:
    """What the world goes through while the hand pushes a block into another."""
    rows = []
    for tip in ([0.40, 0.0, 0.05], [0.56, 0.02, 0.04], [0.56, 0.10, 0.04]):
        for _ in range(2):
            send(world, np.array(tip), 0.3)
            rows.append(b"".join(world.perceive()[o].tobytes() for o in world.perceive()))
    return rows


def test_the_same_actions_give_the_same_history_bit_by_bit() -> None:
    first, again = (history(SimWorld(scenes.scene(BLOCKS), RIG)) for _ in range(2))
    assert first == again
    assert len(set(first)) == len(first), "something moved"


def test_another_friction_gives_another_history() -> None:
    assert history(SimWorld(scenes.scene(BLOCKS, friction_block=0.1), RIG)) != history(
        SimWorld(scenes.scene(BLOCKS), RIG)
    )


def test_a_world_is_put_back_where_it_was_saved() -> None:
    world = SimWorld(scenes.scene(BLOCKS), RIG)
    send(world, np.array([0.45, 0.05, 0.25]), 0.5)
    saved, before, time = world.save(), world.perceive(), world.time
    history(world)
    moved = world.perceive()
    assert np.linalg.norm(moved[B0][:3] - before[B0][:3]) > 0.01
    world.restore(saved)
    back = world.perceive()
    for obj in before:
        np.testing.assert_allclose(back[obj], before[obj], atol=1e-6)
    assert world.time == time
    # It goes on from there at rest: nothing jumps.
    for _ in range(20):
        world.step()
    for obj in (B0, B1):
        np.testing.assert_allclose(world.perceive()[obj], before[obj], atol=2e-3)


def test_time_runs_by_periods_and_hooks_hear_each() -> None:
    world, heard = SimWorld(scenes.scene(BLOCKS), RIG), []
    world.on_step(lambda w: heard.append(w.time))
    world.act(JointTarget(RIG.arm.home, 0.14), 0.1)
    assert len(heard) == 10 and world.time == pytest.approx(0.1)
    np.testing.assert_allclose(np.diff(heard), world.period)


def test_the_arm_follows_its_targets() -> None:
    world = SimWorld(scenes.scene(BLOCKS), RIG)
    tip = np.array([0.42, 0.10, 0.25])
    send(world, tip, 1.0, opening=0.06)
    for _ in range(50):
        world.step()
    seen = world.observe()
    np.testing.assert_allclose(seen.state.get(R, "x", "y", "z"), tip, atol=1e-3)
    assert seen.opening == pytest.approx(0.06, abs=1e-3)
    assert np.linalg.norm(seen.tip_force) < 2.0
    assert np.abs(seen.arm_velocity).max() < 0.01
    np.testing.assert_array_equal(seen.state[R], RIG.robot_features(seen.arm, seen.opening))


@pytest.mark.parametrize("gain", [0.8, 1.2])
def test_the_estimated_force_is_that_of_the_contact(gain: float) -> None:
    """In free motion, pressing on the table, and dragging along it: within 3 N or a fifth."""
    world = SimWorld(scenes.scene(BLOCKS, gain=gain), RIG)
    felt: list[np.ndarray] = []
    world.on_step(lambda w: felt.append(w.observe().tip_force))
    place = np.array([0.40, 0.30, 0.0])
    send(world, place + [0, 0, 0.05], 1.5)
    send(world, place + [0, 0.15, 0.05], 1.0)
    assert np.linalg.norm(felt[-60:], axis=1).max() < 3.0, "nothing is touched, at 150 mm/s"
    send(world, place + [0, 0, 0.01], 1.0)
    for depth in (0.001, 0.003):
        send(world, place - [0, 0, depth], 0.5)
        for _ in range(50):
            world.step()
        (touched, contact), *others = world.hand_contacts()
        assert touched is None and others == [] and contact > 10
        assert felt[-1][2] == pytest.approx(contact, rel=0.2, abs=3.0)
    begin = len(felt)
    pressed: list[float] = []
    world.on_step(lambda w: pressed.append(sum(force for _, force in w.hand_contacts())))
    send(world, place + [0.06, 0, -0.003], 1.0)
    # It slides, so the friction is Coulomb's: the mean of the pads' and the table's, against the way.
    dragged, normal = np.mean(felt[begin + 50 :], axis=0), np.mean(pressed[50:])
    assert dragged[2] == pytest.approx(normal, rel=0.2)
    assert dragged[0] == pytest.approx(-(1.15 + 0.4) / 2 * normal, rel=0.2)


def test_forces_on_a_block_balance() -> None:
    """What the contacts report is believable: the floor carries the block and the press on it."""
    world = SimWorld(scenes.scene(BLOCKS), RIG)
    top = world.perceive()[B0][:3] + [0, 0, scenes.HEIGHT / 2 + 0.012]
    send(world, top + [0, 0, 0.05], 1.5)
    send(world, top - [0, 0, 0.004], 1.0)
    for _ in range(80):
        world.step()
    floor = sum(
        abs(sum(p.impulse[2] for p in contact.points)) / world.period
        for contact in world.built.scene.get_contacts()
        if {b.entity.name for b in contact.bodies} == {"b0", "box"}
    )
    (touched, press), *_ = world.hand_contacts()
    assert touched == B0 and press > 20
    assert floor == pytest.approx(press + 0.1 * 9.81, rel=0.02)


def test_a_lower_effort_presses_less() -> None:
    forces = []
    for limit in (None, tuple(0.3 * t for t in TORQUE)):
        world = SimWorld(scenes.scene(BLOCKS), RIG)
        send(world, np.array([0.40, 0.30, 0.03]), 1.5)
        world.limit_effort(limit)
        send(world, np.array([0.40, 0.30, -0.08]), 1.0)
        forces.append(world.hand_contacts()[0][1])
        world.limit_effort(None)
    assert forces[1] < 0.6 * forces[0]


def test_what_the_hand_touches_is_named() -> None:
    world = SimWorld(scenes.scene(BLOCKS), RIG)
    top = world.perceive()[B0][:3] + [0, 0, scenes.HEIGHT / 2 + 0.012]
    send(world, top + [0, 0, 0.05], 1.0)
    send(world, top - [0, 0, 0.005], 1.0)
    assert world.hand_contacts()[0][0] == B0
    rim = world.perceive()[THE_BOX][:3] + [0.0, scenes.INNER / 2 + scenes.WALL / 2, scenes.RIM]
    send(world, rim + [0, 0, 0.06], 1.5)
    send(world, rim - [0, 0, 0.005], 1.0)
    assert world.hand_contacts()[0][0] == THE_BOX


def test_a_placed_block_is_there_at_rest() -> None:
    world = SimWorld(scenes.scene(BLOCKS), RIG)
    features = scenes.block_features(-0.08, 0.03, 0.5)
    world.place(B0, features[:7])
    np.testing.assert_allclose(world.perceive()[B0], features, atol=1e-5)
    for _ in range(20):
        world.step()
    np.testing.assert_allclose(world.perceive()[B0][:3], features[:3], atol=1e-3)
    assert {o.type for o in world.built.rigid} == {BLOCK, THE_BOX.type}


@settings(max_examples=20)
@given(st.lists(st.floats(-2.5, 2.5), min_size=6, max_size=6))
def test_the_jacobian_is_the_derivative_of_the_tip(q: list[float]) -> None:
    joints, h = np.array(q), 1e-6
    jacobian = RIG.tip_jacobian(joints)
    here = RIG.tip_pose(joints)
    for i in range(6):
        moved = RIG.tip_pose(joints + h * np.eye(6)[i])
        np.testing.assert_allclose(jacobian[:3, i], (moved - here)[:3, 3] / h, atol=1e-5)
        turned = spatial.rotation_vector(moved[:3, :3] @ here[:3, :3].T) / h
        np.testing.assert_allclose(jacobian[3:, i], turned, atol=1e-4)


def test_a_world_is_set_to_a_state() -> None:
    world = SimWorld(scenes.scene(BLOCKS), RIG)
    send(world, np.array([0.48, 0.05, 0.25]), 0.5, opening=0.05)
    wanted = scenes.scene({"b0": (0.05, 0.0), "b1": (-0.05, 0.06)}).initial
    state = State({**{o: wanted[o] for o in wanted}, R: world.perceive()[R]})
    send(world, np.array([0.45, 0.0, 0.30]), 0.5)
    assert world.reset(state)
    for obj in state.objects:
        np.testing.assert_allclose(world.perceive()[obj], state[obj], atol=2e-3)


def test_what_does_not_stand_or_cannot_be_reached_is_refused() -> None:
    world = SimWorld(scenes.scene(BLOCKS), RIG)
    state = world.perceive()
    assert not world.reset(state.with_features(B0, z=0.2))
    assert not world.reset(state.with_features(R, x=3.0))
    assert world.reset(state)


def test_only_objects_are_run_into() -> None:
    world = SimWorld(scenes.scene(BLOCKS), RIG)
    assert world.contacts() == {}
    top = world.perceive()[B0][:3] + [0, 0, scenes.HEIGHT / 2 + 0.012]
    send(world, top + [0, 0, 0.05], 1.0)
    send(world, top - [0, 0, 0.005], 1.0)
    assert set(world.contacts()) == {B0} and world.contacts()[B0] > 1.0
