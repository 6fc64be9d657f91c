"""Builds one SAPIEN scene from a rig and a task: arm, table, all that stands on it, lights, cameras."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.resources import as_file, files
from tempfile import NamedTemporaryFile
from typing import Any
from xml.etree import ElementTree

import numpy as np
import sapien
from sapien import physx, render

from resync_robot.core.errors import ConfigError, RenderError
from resync_robot.core.joints import ARM_JOINTS
from resync_robot.core.machines import ARMS
from resync_robot.core.rig import CameraRig, Rig
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK, BOX, DRAWER, LID
from resync_robot.core.world import Window
from resync_robot.sim_training.physics.bodies import add_block, add_box, add_table, entity_at, material
from resync_robot.sim_training.physics.fittings import SlidingDrawer, add_lid
from resync_robot.sim_training.physics.lights import add_lights
from resync_robot.sim_training.physics.solver import Solver, solver_of

FINGER_JOINTS = ("left_finger_joint", "right_finger_joint")
TARGET_PERIOD = 0.02
"""s between two drive targets of a learned skill: as smooth as the arm can tell, at half the calls."""

STIFFNESS, DAMPING = 6000.0, 300.0
TORQUE = (150.0, 150.0, 150.0, 28.0, 28.0, 28.0)
FINGER_STIFFNESS, FINGER_DAMPING = 3000.0, 150.0


BODIES = {BLOCK: add_block, BOX: add_box, LID: add_lid}
"""How a thing of a type is added, where it is one body."""


def build_scene(task: Task, rig: Rig, rendered: bool) -> BuiltScene:
    """A scene with every object at its initial pose and the arm at the rig's home.

    Args:
        task: objects, their initial features, and the physics drawn for this task.
        rendered: build visuals, lights and cameras too (needs a Vulkan device).

    Raises:
        RenderError: `rendered`, and no device can render.
    """
    solver = solver_of(task.physics)
    physx.set_scene_config(gravity=np.array(solver.gravity, dtype=np.float32), enable_tgs=False)
    systems = [physx.PhysxCpuSystem()]
    if rendered:
        _configure_renderer()
        systems.append(render.RenderSystem())
    scene = sapien.Scene(systems)
    scene.set_timestep(solver.period)
    physics = task.physics
    robot = add_robot(scene, rig, physics, rendered)
    add_table(scene, physics, rendered)
    bodies, drawers = {}, {}
    for obj in task.objects:
        if obj.type == DRAWER:
            drawers[obj] = SlidingDrawer(scene, obj, task, rendered)
        elif obj.type in BODIES:
            bodies[obj] = BODIES[obj.type](scene, obj, task, rendered)
    cameras = {}
    if rendered:
        for camera in rig.cameras:
            cameras[camera.name] = add_camera(scene, robot, camera, camera.pose, (camera.width, camera.height))
            look_through(cameras[camera.name], camera, whole_picture(camera))
    if rendered:
        add_lights(scene, physics.get("light", {}))
    return BuiltScene(scene, robot, bodies, cameras, float(physics.get("gain", 1.0)), solver, drawers)


class BuiltScene:
    """Handles into one scene. Finger openings are the free distance between the pads."""

    def __init__(
        self,
        scene: sapien.Scene,
        robot: physx.PhysxArticulation,
        bodies: Mapping[Object, sapien.Entity],
        cameras: Mapping[str, render.RenderCameraComponent],
        gain: float,
        solver: Solver,
        drawers: Mapping[Object, SlidingDrawer] | None = None,
    ) -> None:
        self.solver, self.drawers = solver, dict(drawers or {})
        self.stiffness, self.damping = STIFFNESS * gain, DAMPING * gain
        self.scene, self.robot, self.bodies, self.cameras = scene, robot, dict(bodies), dict(cameras)
        joints = {j.name: j for j in robot.active_joints}
        self.arm_joints = [joints[n] for n in ARM_JOINTS]
        self.finger_joints = [joints[n] for n in FINGER_JOINTS]
        order = [j.name for j in robot.active_joints]
        self.arm_index = np.array([order.index(n) for n in ARM_JOINTS])
        self.finger_index = np.array([order.index(n) for n in FINGER_JOINTS])
        links = {link.name: link for link in robot.links}
        self._moved_by_arm = [robot.links.index(joint.child_link) for joint in self.arm_joints]
        self.flange = links["flange"]
        self.hand = {links[n] for n in ("flange", "left_finger", "right_finger")}
        self.set_torque_limits(TORQUE)
        self.rigid = {
            obj: entity.find_component_by_type(physx.PhysxRigidDynamicComponent) for obj, entity in self.bodies.items()
        }

    def set_torque_limits(self, torque: tuple[float, ...]) -> None:
        """(6,) N m; a learned skill runs with lower ones than a scripted one."""
        for joint, limit in zip(self.arm_joints, torque, strict=True):
            joint.set_drive_properties(self.stiffness, self.damping, limit)

    def joint_torques(self) -> np.ndarray:
        """(6,) N m about their axes that the arm's joints passed on to what they move, in the last step."""
        return np.asarray(self.robot.get_link_incoming_joint_forces(), dtype=np.float64)[self._moved_by_arm, 3]

    def set_configuration(self, q: np.ndarray, opening: float) -> None:
        """Put the robot somewhere at rest, drive targets included."""
        full = np.zeros(self.robot.dof, dtype=np.float32)
        full[self.arm_index], full[self.finger_index] = q, opening / 2
        self.robot.set_qpos(full)
        self.robot.set_qvel(np.zeros_like(full))
        self.drive(q, opening)

    def approach(self, begin: np.ndarray, goal: np.ndarray, opening: float, duration: float) -> None:
        """Step for `duration` s while the drives' targets go evenly from (6,) `begin` to (6,) `goal`."""
        steps, every = self.solver.steps(duration), self.solver.steps(TARGET_PERIOD)
        for i in range(steps):
            if i % every == 0:
                self.drive(begin + (goal - begin) * min(1.0, (i + every) / steps), opening)
            self.scene.step()

    def drive(self, q: np.ndarray, opening: float) -> None:
        for joint, value in zip(self.arm_joints, q, strict=True):
            joint.set_drive_target(float(value))
        for joint in self.finger_joints:
            joint.set_drive_target(opening / 2)


@cache
def urdf_path() -> str:
    """Where the robot's description lies."""
    with as_file(files("resync_robot.sim_training").joinpath("assets/ur7e_2f140.urdf")) as path:
        return str(path)


@cache
def _bodies_only() -> str:
    """The robot's description without its looks: reading those asks for a render device, which physics needs not."""
    tree = ElementTree.parse(urdf_path())
    for link in tree.getroot().iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    return ElementTree.tostring(tree.getroot(), encoding="unicode")


def require_simulated(rig: Rig) -> None:
    """Raises ConfigError where the rig's arm or gripper is not the one that is described for the simulator."""
    if rig.arm.kinematics != ARMS["ur7e"].kinematics or rig.gripper.model != "2f-140":
        alike = [name for name, arm in ARMS.items() if arm.kinematics == ARMS["ur7e"].kinematics]
        raise ConfigError(
            f"the rig '{rig.name}' is a {rig.arm.facts.title} with a {rig.gripper.facts.title}, of which there is no "
            f"simulation; allowed: {' or '.join(alike)} with 2f-140",
            "drive it with --backend ur7e, or simulate with a rig of those",
        )


def add_robot(scene: sapien.Scene, rig: Rig, physics: Mapping[str, Any], rendered: bool) -> physx.PhysxArticulation:
    require_simulated(rig)
    loader = scene.create_urdf_loader()
    loader.fix_root_link = True
    if rendered:
        builder = loader.parse(urdf_path())[0][0]
    else:
        with NamedTemporaryFile("w", suffix=".urdf", encoding="utf-8") as file:
            file.write(_bodies_only())
            file.flush()
            builder = loader.parse(file.name)[0][0]
    builder.initial_pose = sapien.Pose(rig.arm.world_T_base)
    robot = builder.build(fix_root_link=True)
    solver = solver_of(physics)
    pad = material(physics["friction_pad"], solver, physics.get("pad_stiffness"))
    steel = material(0.3, solver)
    for link in robot.links:
        link.disable_gravity = True
        for i, shape in enumerate(link.collision_shapes):
            # The first shape of a finger is its pad; what the pad hangs on stands back from it, and is bare.
            shape.physical_material = pad if i == 0 and link.name.endswith("finger") else steel
            # A shared bit in the third word: the robot's own links do not collide with each other.
            shape.set_collision_groups([1, 1, 1, 0])
            shape.contact_offset = solver.contact_offset
    robot.set_solver_position_iterations(solver.arm_iterations)
    joints = {j.name: j for j in robot.active_joints}
    for name in ARM_JOINTS:
        joints[name].set_armature([0.02])
    for name in FINGER_JOINTS:
        joints[name].set_drive_properties(FINGER_STIFFNESS, FINGER_DAMPING, rig.gripper.max_force)
        joints[name].set_armature([0.02])
    return robot


def add_camera(
    scene: sapien.Scene,
    robot: physx.PhysxArticulation,
    camera: CameraRig,
    pose: np.ndarray,
    size: tuple[int, int],
) -> render.RenderCameraComponent:
    """A camera that renders (width, height) pixels, at (4, 4) `pose` in its mount, OpenCV axes.

    It sees nothing until `look_through` has given it a window.
    """
    component = render.RenderCameraComponent(*size)
    if camera.mount == "flange":
        next(link for link in robot.links if link.name == "flange").entity.add_component(component)
    else:
        entity = entity_at(f"camera_{camera.name}", sapien.Pose())
        entity.add_component(component)
        scene.add_entity(entity)
    place_camera(component, camera, pose)
    return component


def place_camera(component: render.RenderCameraComponent, camera: CameraRig, pose: np.ndarray) -> None:
    """Put it at (4, 4) `pose` in its mount, OpenCV axes."""
    # SAPIEN cameras look along x with z up; OpenCV's along z with y down.
    axes = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
    component.local_pose = sapien.Pose(pose @ axes)


def look_through(
    component: render.RenderCameraComponent, camera: CameraRig, window: Window, focal: float = 1.0
) -> None:
    """Make the component render what lies in a window of the camera's picture.

    Args:
        focal: factor on the camera's focal length.
    """
    across, down = component.width / window.width, component.height / window.height
    # The renderer counts pixels from their upper left edge, as windows do; cameras and OpenCV from their middle.
    cx, cy = (camera.cx + 0.5 - window.left) * across, (camera.cy + 0.5 - window.top) * down
    component.set_perspective_parameters(0.05, 5.0, camera.fx * focal * across, camera.fy * focal * down, cx, cy, 0.0)


def whole_picture(camera: CameraRig) -> Window:
    return Window(0.0, 0.0, float(camera.width), float(camera.height))


def colour_of(component: render.RenderCameraComponent) -> np.ndarray:
    """(H, W, 3) uint8 RGB of the picture that was taken last."""
    return (np.clip(component.get_picture("Color")[..., :3], 0, 1) * 255).astype(np.uint8)


@cache
def _configure_renderer() -> render.RenderSystem:
    """The cache keeps this system for as long as the process lives: when the last one goes, so do the compiled
    shaders, and the next scene compiles them anew, which takes a software driver seconds."""
    render.set_camera_shader_dir("default")
    try:
        return render.RenderSystem()
    except Exception as error:  # SAPIEN raises RuntimeError or a pybind error depending on what is missing
        raise RenderError(
            f"no Vulkan device can render: {error}", "run: bash scripts/install_vulkan.sh, then resync-robot doctor"
        ) from None


def require_renderer() -> None:
    """Raises RenderError where no device can render."""
    _configure_renderer()


def camera_pose_in_world(component: render.RenderCameraComponent) -> np.ndarray:
    """(4, 4) world_T_cam in OpenCV axes, as simulated."""
    axes = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
    return component.global_pose.to_transformation_matrix() @ axes.T


def features_of(pose: sapien.Pose) -> np.ndarray:
    """(7,) x y z qw qx qy qz with qw >= 0."""
    quat = pose.q if pose.q[0] >= 0 else -pose.q
    return np.concatenate([pose.p, quat]).astype(np.float64)
