"""The simulated arm is the arm of the kinematics, and pictures have the rig's shapes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.errors import ConfigError, RenderError, UnknownNameError
from resync_robot.core.machines import ARMS
from resync_robot.core.rig import load_rig
from resync_robot.sim_training.physics.scene import BuiltScene, build_scene
from resync_robot.sim_training.physics.world import SimWorld
from tests import scenes
from tests.scenes import B0, THE_BOX

RIG = load_rig()
TASK = scenes.scene({"b0": (0.05, 0.05, 0.3)})


@pytest.fixture(scope="module")
def built() -> BuiltScene:
    return build_scene(TASK, RIG, rendered=False)


@pytest.fixture(scope="module")
def rendered() -> SimWorld:
    try:
        return SimWorld(TASK, RIG, rendered=True)
    except RenderError as error:
        pytest.skip(f"no Vulkan device: {error.what}")


@pytest.mark.parametrize("model", ["ur3e", "ur10e", "ur12e", "ur16e"])
def test_an_arm_that_is_not_described_is_not_simulated(model: str) -> None:
    with pytest.raises(ConfigError, match=rf"{ARMS[model].title} with a 2F-140.*allowed: ur5e or ur7e with 2f-140"):
        SimWorld(TASK, replace(RIG, arm=replace(RIG.arm, model=model)))


def test_another_gripper_is_not_simulated_and_a_ur5e_is() -> None:
    with pytest.raises(ConfigError, match=r"UR7e with a 2F-85.*(\n.*)*--backend ur7e"):
        SimWorld(TASK, replace(RIG, gripper=replace(RIG.gripper, model="2f-85")))
    SimWorld(TASK, replace(RIG, arm=replace(RIG.arm, model="ur5e")))


def configurations(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.uniform(-3.0, 3.0, 6) for _ in range(count)]


@pytest.mark.parametrize("q", [np.zeros(6), RIG.arm.home, *configurations(20)])
def test_the_flange_is_where_the_kinematics_put_it(built: BuiltScene, q: np.ndarray) -> None:
    built.set_configuration(q, 0.1)
    world_T_flange = built.flange.entity_pose.to_transformation_matrix()
    np.testing.assert_allclose(world_T_flange, RIG.arm.world_T_base @ RIG.arm.kinematics.forward(q), atol=2e-5)


def test_each_joint_turns_about_the_axis_of_its_frame(built: BuiltScene) -> None:
    rng = np.random.default_rng(1)
    q = rng.uniform(-2.0, 2.0, 6)
    frames = RIG.arm.world_T_base @ RIG.arm.kinematics.link_frames(q)
    axes = np.concatenate([RIG.arm.world_T_base[None], frames[:-1]])[:, :3, 2]
    built.set_configuration(q, 0.1)
    before = built.flange.entity_pose.to_transformation_matrix()[:3, :3]
    for joint in range(6):
        turned = q.copy()
        turned[joint] += 0.2
        built.set_configuration(turned, 0.1)
        after = built.flange.entity_pose.to_transformation_matrix()[:3, :3]
        np.testing.assert_allclose(spatial.rotation_vector(after @ before.T), 0.2 * axes[joint], atol=1e-4)


@pytest.mark.parametrize("opening", [0.0, 0.05, 0.14])
def test_the_opening_is_the_free_distance_between_the_pads(built: BuiltScene, opening: float) -> None:
    built.set_configuration(RIG.arm.home, opening)
    tip = RIG.tip_pose(RIG.arm.home)
    inner = []
    for link in built.robot.links:
        if not link.name.endswith("finger"):
            continue
        for shape in link.collision_shapes:
            pose = spatial.inverse(tip) @ (link.entity_pose * shape.local_pose).to_transformation_matrix()
            signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
            corners = spatial.apply(pose, signs * np.asarray(shape.half_size))
            if abs(corners[:, 2]).min() < 0.02:  # at the height of the tip, where the pads are
                inner.append(np.abs(corners[:, 1]).min())
    assert len(inner) >= 2
    assert 2 * min(inner) == pytest.approx(opening, abs=1e-4)


def test_objects_stand_where_the_task_says(built: BuiltScene) -> None:
    for obj in (B0, THE_BOX):
        pose = built.bodies[obj].pose.to_transformation_matrix()
        np.testing.assert_allclose(pose, spatial.pose_from_features(TASK.initial[obj][:7]), atol=1e-5)
    weight = -built.rigid[B0].mass * built.scene.physx_system.config.gravity[2]
    assert weight == pytest.approx(0.1 * 9.81, rel=1e-5), "more inertia, the same weight"


def test_without_rendering_there_are_no_cameras(built: BuiltScene) -> None:
    assert built.cameras == {}


@pytest.mark.parametrize("camera", [c.name for c in RIG.cameras])
def test_pictures_have_the_rigs_shapes_and_poses(rendered: SimWorld, camera: str) -> None:
    frame, facts = rendered.render(camera), RIG.camera(camera)
    assert frame.colour.shape == (facts.height, facts.width, 3) and frame.colour.dtype == np.uint8
    assert frame.depth.shape == (facts.height, facts.width) and frame.depth.dtype == np.uint16
    np.testing.assert_array_equal(frame.intrinsics, facts.intrinsics)
    mount = RIG.arm.world_T_base @ RIG.arm.kinematics.forward(RIG.arm.home) if facts.mount == "flange" else np.eye(4)
    np.testing.assert_allclose(frame.world_T_cam, mount @ facts.pose, atol=2e-4)
    assert frame.colour.std() > 5, "a picture of nothing"


@pytest.mark.parametrize("camera", [c.name for c in RIG.cameras if c.mount == "world"])
def test_depth_is_that_of_the_table(rendered: SimWorld, camera: str) -> None:
    """A pixel's ray, its depth long, ends on something; most of what is seen is the table's plane or above."""
    frame = rendered.render(camera)
    v, u = np.nonzero(frame.depth)
    z = frame.depth[v, u] * frame.DEPTH_UNIT_M
    k = frame.intrinsics
    points = np.stack([(u - k[0, 2]) / k[0, 0] * z, (v - k[1, 2]) / k[1, 1] * z, z], -1)
    height = spatial.apply(frame.world_T_cam, points)[:, 2]
    on_slab = np.abs(height) < 0.002
    assert on_slab.mean() > 0.15
    # The slab is 40 mm thick, and the floor is not drawn: nothing lies lower.
    assert height.min() > -0.05


def test_an_unknown_camera_is_named(rendered: SimWorld) -> None:
    with pytest.raises(UnknownNameError, match="roof"):
        rendered.render("roof")
