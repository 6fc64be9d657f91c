"""One simulated robot among objects: a `Simulator` for training, and the physics behind the simulated driver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from sapien import Pose
from sapien.render import RenderCameraComponent

from resync_robot.core import spatial
from resync_robot.core.errors import MotionError, UnknownNameError
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK, LID, ROBOT
from resync_robot.core.world import ArmObservation, CameraFrame, Cutout, Glimpse, Window
from resync_robot.sim_training.physics.scene import (
    TORQUE,
    BuiltScene,
    add_camera,
    build_scene,
    camera_pose_in_world,
    colour_of,
    features_of,
    look_through,
    place_camera,
)

SETTLING = 0.2
"""s after which a placed object must be at rest where it was put (section 3.1)."""
MOVED = 0.002
"""m that it may move meanwhile."""


@dataclass(frozen=True)
class Snapshot:
    """What `SimWorld.restore` needs."""

    time: float
    qpos: np.ndarray
    qvel: np.ndarray
    target: JointTarget
    bodies: dict[Object, tuple[np.ndarray, np.ndarray, np.ndarray]]
    drawers: dict[Object, tuple[float, float]]


class SimWorld:
    """SAPIEN behind `core.world.Simulator`, and behind the driver's physics protocol.

    Args:
        task: what stands where, and the physics drawn for it.
        rig: the arm, gripper and cameras.
        rendered: build visuals and cameras, so that `render` works.
    """

    def __init__(self, task: Task, rig: Rig, rendered: bool = False) -> None:
        self.task, self.rig = task, rig
        self.built: BuiltScene = build_scene(task, rig, rendered)
        self.period = self.built.solver.period
        self.time = 0.0
        self.robot_object = next(o for o in task.objects if o.type == ROBOT)
        self._loose = [o for o in task.objects if o.type in (BLOCK, LID)]
        self._target = JointTarget(rig.arm.home.copy(), rig.gripper.max_opening)
        self._small: dict[tuple[str, int], RenderCameraComponent] = {}
        self._hooks: list[Callable[[SimWorld], None]] = []
        self.built.set_configuration(self._target.arm, self._target.opening)

    def on_step(self, hook: Callable[[SimWorld], None]) -> None:
        """Call `hook` after every physics step (contact monitors, video)."""
        self._hooks.append(hook)

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        """(6,) N m for the arm, or None for the arm's own limits."""
        self.built.set_torque_limits(TORQUE if limit is None else limit)

    def drive(self, q: np.ndarray, opening: float) -> None:
        """Set the joint drives' targets; nothing moves until `step`."""
        self._target = JointTarget(np.asarray(q, dtype=np.float64), float(opening))
        self.built.drive(q, opening)

    def step(self) -> None:
        """Advance one physics period."""
        self.built.scene.step()
        self.time += self.period
        for hook in self._hooks:
            hook(self)

    def act(self, target: JointTarget, duration: float) -> None:
        """Move the drives' targets to `target` in equal increments over `duration` seconds."""
        steps = self.built.solver.steps(duration)
        begin = self._target
        for i in range(1, steps + 1):
            s = i / steps
            self.drive(begin.arm + s * (target.arm - begin.arm), begin.opening + s * (target.opening - begin.opening))
            self.step()

    def measure(self) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
        """(6,) rad, (6,) rad/s, opening in m, (3,) N force of the world on the hand, world frame."""
        qpos, qvel = self.built.robot.qpos.astype(np.float64), self.built.robot.qvel.astype(np.float64)
        q, qd = qpos[self.built.arm_index], qvel[self.built.arm_index]
        return q, qd, float(qpos[self.built.finger_index].sum()), self._tip_force(q)

    def observe(self, live: bool = False) -> ArmObservation:
        q, qd, opening, force = self.measure()
        return ArmObservation(
            time=self.time,
            state=self.state(q, opening),
            arm=q,
            arm_velocity=qd,
            opening=opening,
            commanded_opening=self._target.opening,
            tip_force=force,
        )

    def perceive(self) -> State:
        """The true state: an oracle, for training and for measuring what perception costs."""
        qpos = self.built.robot.qpos.astype(np.float64)
        return self.state(qpos[self.built.arm_index], float(qpos[self.built.finger_index].sum()))

    def state(self, q: np.ndarray, opening: float) -> State:
        features = {o: self.task.initial[o] for o in self.task.objects}
        features[self.robot_object] = self.rig.robot_features(q, opening)
        for obj in self._loose:
            pose = self.built.rigid[obj].entity_pose
            features[obj] = np.concatenate([features_of(pose), self.task.initial[obj][7:]])
        for obj, drawer in self.built.drawers.items():
            features[obj] = drawer.features(self.task.initial[obj])
        return State(features)

    @property
    def movable(self) -> tuple[Object, ...]:
        """Blocks, lids and drawers: what `place` can put somewhere."""
        return (*self._loose, *self.built.drawers)

    def place(self, obj: Object, features: np.ndarray) -> None:
        """Put it at rest at (7,) x y z qw qx qy qz; of a drawer these say how far it is open."""
        if obj in self.built.drawers:
            return self.built.drawers[obj].place(features)
        body = self.built.rigid[obj]
        body.entity.set_pose(Pose(np.asarray(features[:3]), np.asarray(features[3:7])))
        body.linear_velocity, body.angular_velocity = np.zeros(3), np.zeros(3)
        body.wake_up()

    def reset(self, state: State) -> bool:
        """Put everything at rest where `state` has it. Returns whether the arm reaches there and all else stays."""
        rig, features = self.rig, state[self.robot_object]
        tip = spatial.pose_from_features(features[:7])
        base_T_flange = spatial.inverse(rig.arm.world_T_base) @ tip @ spatial.inverse(rig.gripper.flange_T_tip)
        try:
            q = rig.arm.kinematics.inverse(base_T_flange, rig.arm.home)
        except MotionError:
            return False
        self.time, self._target = 0.0, JointTarget(q, float(features[7]))
        self.built.set_configuration(q, self._target.opening)
        for obj in self.movable:
            self.place(obj, state[obj])
        return self.settles()

    def settles(self) -> bool:
        """Let the scene come to rest; does everything stay where it is?"""
        before = self.perceive()
        for _ in range(self.built.solver.steps(SETTLING)):
            self.step()
        after = self.perceive()
        return all(np.linalg.norm(after[b][:3] - before[b][:3]) < MOVED for b in self.movable)

    def contacts(self) -> dict[Object, float]:
        """The objects that the hand touches now, and with which force in N; not what a block in it touches."""
        return {obj: force for obj, force in self.hand_contacts() if obj is not None}

    def save(self) -> Snapshot:
        bodies = {}
        for obj in self._loose:
            body = self.built.rigid[obj]
            bodies[obj] = (features_of(body.entity_pose), body.linear_velocity.copy(), body.angular_velocity.copy())
        robot = self.built.robot
        drawers = {obj: drawer.motion for obj, drawer in self.built.drawers.items()}
        return Snapshot(self.time, robot.qpos.copy(), robot.qvel.copy(), self._target, bodies, drawers)

    def restore(self, snapshot: Snapshot) -> None:
        self.time = snapshot.time
        self.built.robot.set_qpos(snapshot.qpos)
        self.built.robot.set_qvel(snapshot.qvel)
        self.drive(snapshot.target.arm, snapshot.target.opening)
        for obj, (pose, linear, angular) in snapshot.bodies.items():
            self.place(obj, pose)
            self.built.rigid[obj].linear_velocity, self.built.rigid[obj].angular_velocity = linear, angular
        for obj, motion in snapshot.drawers.items():
            self.built.drawers[obj].motion = motion

    def hand_contacts(self) -> list[tuple[Object | None, float]]:
        """What the hand touches now and with which force in N; None stands for the table."""
        named = {entity: obj for obj, entity in self.built.bodies.items()}
        for obj, drawer in self.built.drawers.items():
            named |= {drawer.entity: obj, drawer.cabinet: obj}
        hand = {link.entity for link in self.built.hand}
        found: dict[Object | None, float] = {}
        for contact in self.built.scene.get_contacts():
            first, second = (b.entity for b in contact.bodies)
            if (first in hand) == (second in hand):
                continue
            impulse = np.sum([p.impulse for p in contact.points], axis=0) if contact.points else np.zeros(3)
            other = named.get(second if first in hand else first)
            found[other] = found.get(other, 0.0) + float(np.linalg.norm(impulse)) / self.period
        return sorted(((o, f) for o, f in found.items() if f > 0), key=lambda item: -item[1])

    def render(self, name: str) -> CameraFrame:
        """A noiseless picture; depth is along the optical axis. Raises UnknownNameError."""
        camera = self._taken(name)
        colour = colour_of(camera)
        depth = -camera.get_picture("Position")[..., 2]
        depth = np.clip(np.where(np.isfinite(depth), depth, 0) / CameraFrame.DEPTH_UNIT_M, 0, 65535).astype(np.uint16)
        return CameraFrame(
            name, colour, depth, self.rig.camera(name).intrinsics, camera_pose_in_world(camera), self.time
        )

    def render_colour(self, name: str) -> Glimpse:
        """The colours of a noiseless picture, for less than the whole. Raises UnknownNameError."""
        return Glimpse(name, colour_of(self._taken(name)), self.time)

    def _taken(self, name: str) -> RenderCameraComponent:
        """The camera with a picture of now."""
        if name not in self.built.cameras:
            raise UnknownNameError("camera", name, list(self.built.cameras), self.rig.where)
        camera = self.built.cameras[name]
        self.built.scene.update_render()
        camera.take_picture()
        return camera

    def picture(self) -> np.ndarray:
        """(h, w, 3) the scene as a camera beside it sees it, for people."""
        camera = next((c for c in self.rig.cameras if c.mount == "world"), self.rig.cameras[0])
        if self.built.cameras:
            return self.render_colour(camera.name).colour
        # Scenes that are trained in have no looks.
        seen = SimWorld(self.task, self.rig, rendered=True)
        seen.restore(self.save())
        return seen.render_colour(camera.name).colour

    def render_window(self, name: str, window: Window, size: int, error: np.ndarray) -> Cutout:
        """A noiseless part of a picture, by rays of its own: much cheaper than the whole. Raises UnknownNameError.

        Args:
            error: (4, 4) where the camera stands beside its place, in its own axes.
        """
        if (name, size) not in self._small:
            self._small[name, size] = add_camera(
                self.built.scene, self.built.robot, self.rig.camera(name), self.rig.camera(name).pose, (size, size)
            )
        camera = self._small[name, size]
        place_camera(camera, self.rig.camera(name), self.rig.camera(name).pose @ error)
        look_through(camera, self.rig.camera(name), window)
        self.built.scene.update_render()
        camera.take_picture()
        return Cutout(name, colour_of(camera), self.time)

    def _tip_force(self, q: np.ndarray) -> np.ndarray:
        """From the torques that the arm's joints passed on in the last step, as a real arm estimates it from what its
        joints feel: forces across a joint's axis are not used."""
        effort = self.built.joint_torques()
        jacobian = self.rig.tip_jacobian(q)
        # Damped, so that a singular pose gives a modest estimate instead of a huge one.
        wrench = np.linalg.solve(jacobian @ jacobian.T + 1e-4 * np.eye(6), jacobian @ -effort)
        return wrench[:3]
