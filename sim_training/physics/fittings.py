"""Lids and drawers in a SAPIEN scene, and how a drawer slides."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sapien
from sapien import physx, render

from resync_robot.core import spatial
from resync_robot.core.fittings import DRAWER
from resync_robot.core.solids import cabinet_shapes, drawer_shapes, lid_shapes
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.sim_training.physics.bodies import (
    Shapes,
    add_dynamic,
    attach_shapes,
    cuboid_inertia,
    entity_at,
    visual,
)
from resync_robot.sim_training.physics.parts import TABLE_TOP
from resync_robot.sim_training.physics.solver import solver_of

RUB = 2000.0
"""N s/m; below its stiction a drawer creeps so slowly that nobody sees it: 1 mm/s at 2 N."""


def add_lid(scene: sapien.Scene, obj: Object, task: Task, rendered: bool) -> sapien.Entity:
    """Raises KeyError where the task's physics says nothing of lids."""
    physics, size = task.physics["lid"], task.initial.get(obj, "size_x", "size_y", "size_z")
    body, look = physx.PhysxRigidDynamicComponent(), render.RenderBodyComponent() if rendered else None
    solver, paint = solver_of(task.physics), visual(physics["colour"]) if rendered else None
    attach_shapes(body, look, lid_shapes(size), physics["friction"], solver, paint)
    return add_dynamic(scene, obj.name, task.initial[obj], body, look, physics["mass"], size, solver)


class SlidingDrawer:
    """One drawer of a scene. Its cabinet stands where it was built.

    Args:
        obj, task: the drawer, and where it is; what was drawn for its physics.

    Raises:
        KeyError: the task's physics says nothing of drawers.
    """

    def __init__(self, scene: sapien.Scene, obj: Object, task: Task, rendered: bool) -> None:
        physics, features, size = task.physics["drawer"], task.initial[obj], task.initial[obj][8:11]
        solver = solver_of(task.physics)
        self._closed = spatial.pose_from_features(features[:7])
        self._closed[:3, 3] -= features[7] * self._closed[:3, 0]
        world_T_face = self._closed @ spatial.transform(None, np.array([-size[0] / 2, 0.0, 0.0]))
        world_T_face[2, 3] = TABLE_TOP
        cabinet = physx.PhysxArticulationLinkComponent()
        tray = physx.PhysxArticulationLinkComponent(cabinet)
        front, handle = drawer_shapes(size)
        self.cabinet = _linked(
            f"{obj.name}_cabinet", world_T_face, cabinet, [(cabinet_shapes(), "cabinet_colour")], task, rendered
        )
        self.entity = _linked(
            obj.name, self._closed, tray, [(front, "colour"), (handle, "handle_colour")], task, rendered
        )
        heavy = float(physics["mass"]) * solver.inertia
        tray.mass, tray.inertia = heavy, cuboid_inertia(heavy, np.array([*DRAWER.tray[:2], size[2]]))
        cabinet.joint.type, tray.joint.type = "fixed", "prismatic"
        tray.joint.pose_in_parent = sapien.Pose(spatial.inverse(world_T_face) @ self._closed)
        tray.joint.limit = np.array([0.0, DRAWER.travel], dtype=np.float32)
        # A brake that holds up to so many N, and slides against as many.
        tray.joint.set_drive_properties(0.0, RUB, float(physics["stiction"]))
        self._body = cabinet.articulation
        self._body.set_solver_position_iterations(solver.iterations)
        for entity in (self.cabinet, self.entity):
            scene.add_entity(entity)
        self.place(features)

    @property
    def motion(self) -> tuple[float, float]:
        """Opening, m, and how fast it grows, m/s."""
        return float(self._body.qpos[0]), float(self._body.qvel[0])

    @motion.setter
    def motion(self, values: tuple[float, float]) -> None:
        opening, speed = values
        self._body.set_qpos(np.array([opening], dtype=np.float32))
        self._body.set_qvel(np.array([speed], dtype=np.float32))

    def place(self, features: np.ndarray) -> None:
        """Let it be at rest, as far open as its pose (7,) says."""
        away = np.asarray(features[:3]) - self._closed[:3, 3]
        self.motion = float(np.clip(self._closed[:3, 0] @ away, 0.0, DRAWER.travel)), 0.0

    def features(self, given: np.ndarray) -> np.ndarray:
        """(11,) its features now; what does not move is as `given`."""
        opening, _ = self.motion
        row = np.array(given, dtype=np.float64)
        row[:3], row[7] = self._closed[:3, 3] + opening * self._closed[:3, 0], opening
        return row


def _linked(
    name: str,
    pose: np.ndarray,
    link: physx.PhysxArticulationLinkComponent,
    painted: Sequence[tuple[Shapes, str]],
    task: Task,
    rendered: bool,
) -> sapien.Entity:
    """An entity with a link of an articulation at (4, 4) `pose`, of shapes that have a colour each."""
    entity, look = entity_at(name, sapien.Pose(pose)), render.RenderBodyComponent() if rendered else None
    physics, solver = task.physics["drawer"], solver_of(task.physics)
    for shapes, colour in painted:
        attach_shapes(link, look, shapes, physics["friction"], solver, visual(physics[colour]) if rendered else None)
    entity.add_component(link)
    if look is not None:
        entity.add_component(look)
    return entity
