"""The bodies of one SAPIEN scene: table, box and blocks; of what they are made, and what they look like."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sapien
from sapien import physx, render

from resync_robot.core.solids import Cuboid, box_shapes
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.sim_training.physics import parts, textures
from resync_robot.sim_training.physics.solver import Solver, solver_of

Shapes = Sequence[parts.Convex | Cuboid]


def material(friction: float, solver: Solver, stiffness: float | None = None) -> physx.PhysxMaterial:
    """What bodies are made of.

    Args:
        stiffness: of what yields as rubber does, N/m of each point at which it meets something rigid; None for what
            is rigid.
    """
    # PhysX takes a negative restitution for a spring, and the mean of the two that meet.
    return physx.PhysxMaterial(friction, friction, solver.restitution if stiffness is None else -2 * stiffness)


def visual(
    colour: Any, roughness: float = 0.6, metallic: float = 0.0, surface: Mapping[str, Any] | None = None
) -> render.RenderMaterial:
    paint = render.RenderMaterial()
    if surface is not None:
        colour, roughness, metallic = surface["colour"], surface["roughness"], surface["metallic"]
        pixels = textures.surface(surface["kind"], surface["seed"], surface["contrast"], tuple(map(float, colour)))
        paint.base_color_texture = render.RenderTexture2D(pixels, "R8G8B8A8Unorm")
    paint.base_color = [*(float(c) for c in colour[:3]), 1.0]
    paint.roughness, paint.metallic, paint.specular = roughness, metallic, 0.3
    return paint


def entity_at(name: str, pose: sapien.Pose) -> sapien.Entity:
    entity = sapien.Entity()
    entity.name = name
    entity.set_pose(pose)
    return entity


def attach_shapes(
    body: physx.PhysxRigidBaseComponent,
    look: render.RenderBodyComponent | None,
    shapes: Shapes,
    friction: float,
    solver: Solver,
    paint: Any,
) -> None:
    rubbed = material(friction, solver)
    for shape in shapes:
        if isinstance(shape, Cuboid):
            solid = physx.PhysxCollisionShapeBox(shape.half.astype(np.float32), rubbed)
            solid.local_pose = sapien.Pose(shape.centre)
        else:
            scale = np.ones(3, dtype=np.float32)
            solid = physx.PhysxCollisionShapeConvexMesh(shape.vertices.astype(np.float32), scale, rubbed)
        solid.contact_offset = solver.contact_offset
        body.attach(solid)
    if look is not None:
        attach_looks(look, shapes, paint)


def attach_looks(look: render.RenderBodyComponent, shapes: Shapes, paint: render.RenderMaterial) -> None:
    """Let a body look like these shapes."""
    for shape in shapes:
        if isinstance(shape, Cuboid):
            drawn = render.RenderShapeBox(shape.half.astype(np.float32), paint)
            drawn.local_pose = sapien.Pose(shape.centre)
        else:
            vertices, triangles, normals = parts.hull_triangles(shape.vertices)
            uvs = np.zeros((len(vertices), 2), dtype=np.float32)
            drawn = render.RenderShapeTriangleMesh(
                vertices.astype(np.float32), triangles, normals.astype(np.float32), uvs, paint
            )
        look.attach(drawn)


def add_table(scene: sapien.Scene, physics: Mapping[str, Any], rendered: bool) -> None:
    slab = Cuboid(np.array([0.35, -0.05, -0.02]), np.array([0.75, 0.75, 0.02]))
    colour = physics.get("table_colour", (0.75, 0.68, 0.58))
    paint = visual(colour, surface=physics.get("surfaces", {}).get("table")) if rendered else None
    add_static(scene, "table", sapien.Pose(), [slab], 0.4, solver_of(physics), paint)


def add_static(
    scene: sapien.Scene,
    name: str,
    pose: sapien.Pose,
    shapes: Shapes,
    friction: float,
    solver: Solver,
    paint: render.RenderMaterial | None,
) -> sapien.Entity:
    entity = entity_at(name, pose)
    body = physx.PhysxRigidStaticComponent()
    look = render.RenderBodyComponent() if paint is not None else None
    attach_shapes(body, look, shapes, friction, solver, paint)
    entity.add_component(body)
    if look is not None:
        entity.add_component(look)
    scene.add_entity(entity)
    return entity


def add_box(scene: sapien.Scene, obj: Object, task: Task, rendered: bool) -> sapien.Entity:
    shapes = box_shapes(*task.initial.get(obj, "inner_x", "inner_y", "wall_z", "wall_thickness"))
    pose = pose_of(task.initial[obj])
    colour = task.physics.get("box_colour", (0.35, 0.37, 0.40))
    paint = visual(colour, surface=task.physics.get("surfaces", {}).get("box")) if rendered else None
    solver = solver_of(task.physics)
    return add_static(scene, obj.name, pose, shapes, task.physics["friction_box"], solver, paint)


def add_block(scene: sapien.Scene, obj: Object, task: Task, rendered: bool) -> sapien.Entity:
    size = task.initial.get(obj, "size_x", "size_y", "size_z")
    gloss = float(task.physics.get("gloss", 0.45))
    paint = visual(task.physics["colours"][obj.name], roughness=gloss) if rendered else None
    body = physx.PhysxRigidDynamicComponent()
    look = render.RenderBodyComponent() if paint is not None else None
    solver = solver_of(task.physics)
    attach_shapes(body, look, parts.block_shapes(tuple(size)), task.physics["friction_block"], solver, paint)
    # A hollow socket shifts mass and inertia little; a solid cuboid's inertia is what the blocks have.
    return add_dynamic(scene, obj.name, task.initial[obj], body, look, task.physics["masses"][obj.name], size, solver)


def add_dynamic(
    scene: sapien.Scene,
    name: str,
    features: np.ndarray,
    body: physx.PhysxRigidDynamicComponent,
    look: render.RenderBodyComponent | None,
    mass: float,
    size: np.ndarray,
    solver: Solver,
) -> sapien.Entity:
    """Let a body of `mass` kg stand at the pose with which its features begin, with the inertia of a solid cuboid of
    (3,) `size` m."""
    entity = entity_at(name, pose_of(features))
    heavy = float(mass) * solver.inertia
    body.mass, body.inertia = heavy, cuboid_inertia(heavy, size)
    body.solver_position_iterations = solver.iterations
    body.linear_damping, body.angular_damping = 0.05, 0.1
    entity.add_component(body)
    if look is not None:
        entity.add_component(look)
    scene.add_entity(entity)
    return entity


def cuboid_inertia(mass: float, size: np.ndarray) -> np.ndarray:
    """(3,) float32 moments of a solid cuboid about the axes through its middle."""
    x, y, z = np.asarray(size, dtype=np.float64) ** 2
    return np.array(mass / 12 * np.array([y + z, x + z, x + y])).astype(np.float32)


def pose_of(features: np.ndarray) -> sapien.Pose:
    """Of features that begin with a pose."""
    return sapien.Pose(np.asarray(features[:3]), np.asarray(features[3:7]))
