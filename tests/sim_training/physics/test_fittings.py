"""Lids and drawers: built as they say, a drawer that holds, slides and ends, a lid that lies where it is put."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from resync_robot.core.fittings import DRAWER, LID
from resync_robot.core.rig import load_rig
from resync_robot.sim_training.physics.fittings import cabinet_shapes, drawer_shapes, lid_shapes
from resync_robot.sim_training.physics.parts import Cuboid
from resync_robot.sim_training.physics.world import SimWorld
from tests import furnished_scenes as furnished
from tests import scenes
from tests.furnished_scenes import STICTION, THE_DRAWER, THE_LID
from tests.scenes import B0, THE_BOX
from tests.sim_training.physics.test_world import send

RIG = load_rig()
BLOCKS = {"b0": (0.0, 0.0)}


def within(shapes: list[Cuboid], points: np.ndarray) -> np.ndarray:
    """(n,) is each point in some solid?"""
    return np.any([np.all(np.abs(points - s.centre) <= s.half + 1e-9, axis=1) for s in shapes], axis=0)


def ends(shapes: list[Cuboid]) -> np.ndarray:
    """(2, 3) of the box around them."""
    return np.array([np.min([s.centre - s.half for s in shapes], 0), np.max([s.centre + s.half for s in shapes], 0)])


def test_a_lid_is_as_large_as_it_says_and_its_knob_stands_on_it() -> None:
    low, high = ends(lid_shapes(LID.size))
    np.testing.assert_allclose(high - low, [*LID.size[:2], LID.size[2] + LID.knob[2]])
    assert low[2] == -LID.size[2] / 2


def test_a_tray_is_hollow_and_passes_through_the_face_of_its_cabinet() -> None:
    tray, handle = drawer_shapes(DRAWER.front)
    deep, wide, tall = DRAWER.tray
    floor = DRAWER.floor - DRAWER.lift - DRAWER.front[2] / 2
    rng = np.random.default_rng(0)
    inner = rng.uniform([-deep, -wide / 2, floor], [-DRAWER.front[0] / 2, wide / 2, floor + tall], (200, 3))
    inner[:, 0] = np.clip(inner[:, 0], -deep, -DRAWER.front[0] / 2 - 1e-4)
    assert not within([*tray, *handle], inner + [0, 0, 1e-6]).any()
    closed = ends([s for s in tray if s.half[0] != DRAWER.front[0] / 2])
    cabinet = cabinet_shapes()
    # In the frame of the face, on the table.
    moved = [Cuboid(s.centre + [DRAWER.front[0] / 2, 0, DRAWER.lift + DRAWER.front[2] / 2], s.half) for s in tray[1:]]
    assert closed[0, 0] + DRAWER.front[0] / 2 > -DRAWER.cabinet[0]
    for part in moved:
        corners = part.centre + part.half * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        assert not within(cabinet, corners).any()


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
