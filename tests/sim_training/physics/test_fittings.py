"""Lids and drawers: built as they say, a drawer that holds, slides and ends, a lid that lies where it is put."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from resync_robot.core.fittings import DRAWER, LID
from resync_robot.core.rig import load_rig
from resync_robot.sim_training.physics.world import SimWorld
from tests import furnished_scenes as furnished
from tests import scenes
from tests.furnished_scenes import STICTION, THE_DRAWER, THE_LID
from tests.scenes import B0, THE_BOX
from tests.sim_training.physics.test_world import send

RIG = load_rig()
BLOCKS = {"b0": (0.0, 0.0)}


def test_a_hand_on_the_handle_passes_the_cabinet() -> None:
    palm = 0.060
    assert DRAWER.front[0] + DRAWER.reach - DRAWER.bar[0] / 2 > palm + 0.01


@pytest.fixture(scope="module")
def world() -> SimWorld:
    return SimWorld(furnished.furnished(BLOCKS, lid=furnished.lid_features()), RIG)


def opening(world: SimWorld) -> float:
    return float(world.perceive().get(THE_DRAWER, "opening")[0])


def pull(world: SimWorld, force: float, seconds: float) -> None:
    """Pull at the front with so many N, out of the cabinet."""
    link = world.built.drawers[THE_DRAWER].entity.components[0]
    for _ in range(world.built.solver.steps(seconds)):
        link.add_force_at_point(np.array([-force, 0.0, 0.0]), link.entity_pose.p)
        world.step()


def test_a_drawer_holds_against_its_stiction_and_slides_beyond(world: SimWorld) -> None:
    assert world.reset(world.task.initial)
    pull(world, 0.7 * STICTION, 1.0)
    assert opening(world) < 0.002
    pull(world, 1.5 * STICTION, 0.5)
    assert opening(world) > 0.01
    moved = opening(world)
    for _ in range(50):
        world.step()
    assert opening(world) - moved < 0.03, "it brakes by itself"


@pytest.mark.parametrize(("force", "end"), [(20.0, DRAWER.travel), (-20.0, 0.0)])
def test_a_drawer_ends(world: SimWorld, force: float, end: float) -> None:
    assert world.reset(world.task.initial)
    world.place(THE_DRAWER, furnished.drawer_features(0.08)[:7])
    pull(world, force, 2.0)
    assert opening(world) == pytest.approx(end, abs=0.002)


@pytest.mark.parametrize("yaw", [np.pi, np.pi - 0.15])
def test_what_is_perceived_of_a_drawer_is_what_was_set(yaw: float) -> None:
    for given in (0.0, 0.06, DRAWER.travel):
        task = furnished.furnished(BLOCKS, drawer=furnished.drawer_features(given, yaw))
        world = SimWorld(task, RIG)
        assert world.reset(task.initial)
        for obj in (THE_DRAWER, THE_LID):
            np.testing.assert_allclose(world.perceive()[obj], task.initial[obj], atol=1e-3)
        entity = world.built.drawers[THE_DRAWER].entity.pose.p
        np.testing.assert_allclose(entity, task.initial[THE_DRAWER][:3], atol=1e-3)


def test_lid_and_drawer_are_put_back_where_they_were_saved(world: SimWorld) -> None:
    assert world.reset(world.task.initial)
    pull(world, 2 * STICTION, 0.3)
    saved, before, motion = world.save(), world.perceive(), world.built.drawers[THE_DRAWER].motion
    pull(world, 2 * STICTION, 0.3)
    world.place(THE_LID, furnished.lid_features(on=False))
    world.restore(saved)
    for obj in before:
        np.testing.assert_allclose(world.perceive()[obj], before[obj], atol=1e-6)
    assert world.built.drawers[THE_DRAWER].motion == motion and motion[1] > 0


def test_a_lid_rests_on_the_rim_and_what_floats_does_not_stand(world: SimWorld) -> None:
    assert world.reset(world.task.initial)
    rim = float(world.perceive().get(THE_BOX, "z", "wall_z").sum())
    assert world.perceive().get(THE_LID, "z")[0] - LID.size[2] / 2 == pytest.approx(rim, abs=0.001)
    assert not world.reset(world.task.initial.with_features(THE_LID, z=0.3))


def test_the_cabinet_counts_as_the_drawer_where_the_hand_meets_it(world: SimWorld) -> None:
    assert world.reset(world.task.initial)
    top = np.array([furnished.FACE[0] + DRAWER.cabinet[0] / 2, furnished.FACE[1], DRAWER.cabinet[2]])
    send(world, top + [0, 0, 0.06], 2.0)
    send(world, top - [0, 0, 0.004], 1.0)
    assert set(world.contacts()) == {THE_DRAWER}


def test_pads_of_rubber_yield_and_rigid_ones_do_not() -> None:
    task, between = furnished.furnished(BLOCKS), {}
    for stiffness in (None, 1e4):
        physics = {k: v for k, v in {**task.physics, "pad_stiffness": stiffness}.items() if v is not None}
        world = SimWorld(replace(task, physics=physics), RIG)
        place = world.perceive()[B0][:3]
        for tip, opening in ((place + [0, 0, 0.1], 0.03), (place, 0.03), (place, -0.03)):
            send(world, tip, 1.5, opening=scenes.WIDTH + opening)
        between[stiffness] = world.observe().opening
    assert between[None] == pytest.approx(scenes.WIDTH, abs=1e-4)
    # Each finger presses with 40 N, on four points.
    assert between[None] - between[1e4] == pytest.approx(2 * RIG.gripper.max_force / (4 * 1e4), rel=0.05)
