"""The scene of a recording as people like to see it: from beside the robot, whole, with shadows and smooth edges.

Nothing in here moves by physics; everything is put where the recording has it. The arm is drawn from its maker's
measures, so that every model is shown.
"""

from __future__ import annotations

import colorsys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import sapien
from jaxtyping import Float, UInt8
from sapien import render

from resync_robot.core import fittings, spatial
from resync_robot.core.recorded_rig import RecordedRig
from resync_robot.core.solids import BOX_FLOOR, Cuboid, box_shapes, cabinet_shapes, drawer_shapes, lid_shapes
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, BOX, DRAWER, LID
from resync_robot.hardware.clearance import link_segments
from resync_robot.sim_training.physics import parts
from resync_robot.sim_training.physics.bodies import attach_looks
from resync_robot.sim_training.physics.randomise import BLOCK_HUES, FITTING_HUES
from resync_robot.sim_training.physics.scene import colour_of, require_renderer

STEEL, DARK, BLUE = (0.70, 0.72, 0.75), (0.055, 0.06, 0.07), (0.16, 0.34, 0.56)
BOX_COLOUR, TABLE, FLOOR = (0.42, 0.44, 0.47), (0.66, 0.60, 0.52), (0.30, 0.32, 0.35)
TABLE_HALF, TABLE_MIDDLE = np.array([0.62, 0.62, 0.02]), np.array([0.32, 0.0, -0.02 - BOX_FLOOR])
SAME_SIZE = 5e-4
"""m within which an object keeps its shape; a belief changes a little with every scan."""


@dataclass(frozen=True, kw_only=True)
class Viewpoint:
    """Where people look from: m in the world, and the angle of the picture's height in rad."""

    eye: tuple[float, float, float] = (1.32, -0.80, 1.22)
    aim: tuple[float, float, float] = (0.29, 0.0, 0.235)
    field: float = 0.65

    @property
    def world_T_cam(self) -> Float[np.ndarray, "4 4"]:
        """OpenCV axes."""
        forward = np.subtract(self.aim, self.eye) / np.linalg.norm(np.subtract(self.aim, self.eye))
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        return spatial.transform(np.column_stack([right, np.cross(forward, right), forward]), np.array(self.eye))


FARTHER = Viewpoint(eye=(1.50, -1.02, 1.36), aim=(0.31, -0.05, 0.19))
"""The same where things stand all over the table."""


def view_of(objects: Iterable[Object]) -> Viewpoint:
    """From where all of these are seen."""
    return FARTHER if {LID, DRAWER} & {o.type for o in objects} else Viewpoint()


class FilmScene:
    """
    Args:
        width, height: of its pictures in px.
        finer: a picture is rendered this many times as wide and high, and made smaller: smooth edges.

    Raises:
        RenderError: no device can render.
    """

    def __init__(
        self, rig: RecordedRig, width: int, height: int, finer: float = 2.0, view: Viewpoint | None = None
    ) -> None:
        require_renderer()
        self._rig, self._view = rig, view or Viewpoint()
        self._scene = sapien.Scene([render.RenderSystem()])
        self._links = list(link_segments(rig.arm).values())
        self._arm = [(frame, self._tube(begin, end, radius)) for frame, begin, end, radius in self._links]
        self._hand, self._fingers = self._add_hand(), [self._add_finger(side) for side in (1.0, -1.0)]
        self._things: dict[Object, tuple[np.ndarray, list[sapien.Entity]]] = {}
        self._add("table", [Cuboid(TABLE_MIDDLE, TABLE_HALF)], TABLE, 0.85)
        floor = Cuboid(np.array([0.0, 0.0, -0.8]), np.array([12.0, 12.0, 0.02]))
        self._add("floor", [floor], FLOOR, 0.95)
        self._light()
        self._size, self._finer = (width, height), finer
        self._focal = height / 2 / np.tan(self._view.field / 2)
        self._camera = self._add_camera()

    def picture(
        self, q: Float[np.ndarray, "6"], opening: float, things: Mapping[Object, np.ndarray]
    ) -> UInt8[np.ndarray, "h w 3"]:
        """RGB of the robot at `q` in rad with its pads `opening` m apart, and of all else by its features."""
        frames = self._rig.frames(q)
        for frame, entity in self._arm:
            entity.set_pose(sapien.Pose(frames[frame]))
        self._hand.set_pose(sapien.Pose(frames[-1]))
        for side, entity in zip((1.0, -1.0), self._fingers, strict=True):
            aside = np.array([0.0, side * max(opening, 0.0) / 2, 0.0])
            entity.set_pose(sapien.Pose(frames[-1] @ spatial.transform(None, aside)))
        self._put(things)
        self._scene.update_render()
        self._camera.take_picture()
        return cv2.resize(colour_of(self._camera), self._size, interpolation=cv2.INTER_AREA)

    def pixels(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Where points of the world are in the picture."""
        local = (points - self._view.world_T_cam[:3, 3]) @ self._view.world_T_cam[:3, :3]
        return local[:, :2] / local[:, 2:] * self._focal + np.array(self._size) / 2

    def _put(self, things: Mapping[Object, np.ndarray]) -> None:
        """Make, move and take away objects."""
        for obj in [o for o in self._things if o not in things]:
            self._remove(obj)
        for obj, features in things.items():
            if obj.type not in (BLOCK, BOX, LID, DRAWER):
                continue
            size = features[8:] if obj.type == DRAWER else features[7:]
            if obj in self._things and np.abs(self._things[obj][0] - size).max() > SAME_SIZE:
                self._remove(obj)
            if obj not in self._things:
                self._things[obj] = size, self._add_thing(obj, size)
            poses = [spatial.pose_from_features(features[:7])]
            if obj.type == DRAWER:
                poses.append(fittings.DRAWER.face(features))
            for entity, pose in zip(self._things[obj][1], poses, strict=True):
                entity.set_pose(sapien.Pose(pose))

    def _remove(self, obj: Object) -> None:
        for entity in self._things.pop(obj)[1]:
            self._scene.remove_entity(entity)

    def _add_thing(self, obj: Object, size: np.ndarray) -> list[sapien.Entity]:
        """All that moves as one; of a drawer first what slides, then its cabinet."""
        if obj.type == BOX:
            return [self._add(obj.name, list(box_shapes(*size)), BOX_COLOUR, 0.7)]
        if obj.type == BLOCK:
            return [self._add(obj.name, parts.block_shapes(tuple(size)), self._colour(obj.name), 0.35)]
        if obj.type == LID:
            return [self._add(obj.name, lid_shapes(size), self._colour(obj.name), 0.5)]
        tray, handle = drawer_shapes(size)
        slides = render.RenderBodyComponent()
        attach_looks(slides, tray, _paint(self._colour(obj.name), 0.5))
        attach_looks(slides, handle, _paint(STEEL, 0.4))
        cabinet = f"{obj.name}_cabinet"
        return [self._entity(obj.name, slides), self._add(cabinet, cabinet_shapes(), self._colour(cabinet), 0.5)]

    def _colour(self, name: str) -> tuple[float, float, float]:
        hue = self._rig.hues.get(name, {**BLOCK_HUES, **FITTING_HUES}.get(name, 0.8))
        return colorsys.hsv_to_rgb(hue, 0.88, 0.78) if name not in FITTING_HUES else colorsys.hsv_to_rgb(hue, 0.5, 0.7)

    def _add(self, name: str, shapes: list[Any], colour: tuple[float, ...], roughness: float) -> sapien.Entity:
        look = render.RenderBodyComponent()
        attach_looks(look, shapes, _paint(colour, roughness))
        return self._entity(name, look)

    def _entity(self, name: str, *components: Any) -> sapien.Entity:
        entity = sapien.Entity()
        entity.name = name
        for component in components:
            entity.add_component(component)
        self._scene.add_entity(entity)
        return entity

    def _tube(self, begin: tuple[float, ...], end: tuple[float, ...], radius: float) -> sapien.Entity:
        """A link of the arm, with a coloured ring around its far end."""
        a, b = np.array(begin), np.array(end)
        look = render.RenderBodyComponent()
        # The radii keep clear of the arm; the arm itself is a little thinner.
        thin = 0.88 * radius
        middle = spatial.transform(_along_x(b - a), (a + b) / 2)
        tube = render.RenderShapeCapsule(thin, float(np.linalg.norm(b - a)) / 2, _paint(STEEL, 0.35))
        tube.local_pose = sapien.Pose(middle)
        look.attach(tube)
        cap = render.RenderShapeCylinder(1.03 * thin, 0.35 * thin, _paint(BLUE, 0.4))
        cap.local_pose = sapien.Pose(spatial.transform(_along_x(b - a), b))
        look.attach(cap)
        return self._entity("link", look)

    def _add_hand(self) -> sapien.Entity:
        """The gripper's body, and the camera that it carries."""
        look = render.RenderBodyComponent()
        palm = [Cuboid(np.array([0, 0, 0.05]), np.array([0.0375, 0.06, 0.05]))]
        arm = [Cuboid(np.array([0.06, 0, 0.045]), np.array([0.05, 0.015, 0.006]))]
        attach_looks(look, [*palm, *arm], _paint(DARK, 0.5))
        attach_looks(look, [Cuboid(np.array([0.115, 0, 0.035]), np.array([0.0125, 0.045, 0.0125]))], _paint(STEEL, 0.4))
        return self._entity("hand", look)

    def _add_finger(self, side: float) -> sapien.Entity:
        """A pad at the tip and what it hangs on; the origin is the flange's with the pads together."""
        rig, look = self._rig, render.RenderBodyComponent()
        thick, half = rig.finger_thickness, (rig.tip_offset - 0.09) / 4
        for z, size, colour in ((rig.tip_offset - half, 1.0, DARK), (rig.tip_offset - 3 * half, 0.8, STEEL)):
            middle = np.array([0.0, side * thick * (1.5 - size / 2), z])
            shape = Cuboid(middle, np.array([size * rig.finger_width / 2, size * thick / 2, half]))
            attach_looks(look, [shape], _paint(colour, 0.5))
        return self._entity("finger", look)

    def _light(self) -> None:
        self._scene.set_ambient_light([0.42] * 3)
        self._scene.add_directional_light(
            (-0.35, 0.45, -1.0), [1.35, 1.32, 1.26], shadow=True, position=[0.3, 0.0, 0.3], shadow_scale=1.0,
            shadow_near=-8.0, shadow_far=8.0, shadow_map_size=4096,
        )  # fmt: skip
        self._scene.add_directional_light((-0.8, -0.5, -0.5), [0.30, 0.32, 0.38], shadow=False)

    def _add_camera(self) -> render.RenderCameraComponent:
        width, height = (round(self._finer * s) for s in self._size)
        component = render.RenderCameraComponent(width, height)
        focal = float(self._finer * self._focal)
        component.set_perspective_parameters(0.1, 30.0, focal, focal, width / 2, height / 2, 0.0)
        # SAPIEN cameras look along x with z up; OpenCV's along z with y down.
        axes = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
        component.local_pose = sapien.Pose(self._view.world_T_cam @ axes)
        self._entity("film", component)
        return component


def _paint(colour: tuple[float, ...], roughness: float) -> render.RenderMaterial:
    material = render.RenderMaterial()
    material.base_color = [*colour, 1.0]
    material.roughness, material.metallic, material.specular = roughness, 0.0, 0.4
    return material


def _along_x(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """A rotation whose x axis has this direction, which is that of SAPIEN's capsules and cylinders."""
    x = direction / np.linalg.norm(direction)
    y = np.cross(x, np.eye(3)[np.argmin(np.abs(x))])
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])
