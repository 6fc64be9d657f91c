"""A simulated robot before a printed board: the board on the table, or in the hand."""

from __future__ import annotations

import base64
import colorsys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
import sapien
from jaxtyping import Bool, Float, UInt8
from sapien import render

from resync_robot.core import spatial
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK, ROBOT
from resync_robot.sim_training.physics.randomise import draw_physics
from resync_robot.sim_training.physics.world import SimWorld

R = ROBOT("r")
CAMERA_SHIFT, CAMERA_TURN = 0.008, np.radians(1.5)
"""How far a simulated camera stands from where the rig file has it, per axis: a hand-made mount, a knocked stand."""


@dataclass(frozen=True)
class Poster:
    """A picture on a flat sheet.

    Attributes:
        image: (h, w) grey.
        size: (width, height), m; x right, y down, z into the sheet, origin at the upper left.
        pose: (4, 4) of the sheet in its mount.
    """

    image: UInt8[np.ndarray, "h w"]
    size: tuple[float, float]
    mount: Literal["world", "flange"]
    pose: Float[np.ndarray, "4 4"]


@dataclass(frozen=True)
class Bench:
    """What stands before a robot that is calibrated.

    Attributes:
        seed: of where the cameras really stand, and of the colours of things.
        names: of things in a row on the table, from the robot's left to its right.
        poster: a board, on the table or in the hand.
    """

    seed: int
    names: tuple[str, ...] = ()
    poster: Poster | None = None

    def task(self, rig: Rig) -> Task:
        return row_task(rig, self.names, self.seed) if self.names else empty_task(rig, self.seed)

    def to_json(self) -> dict[str, Any]:
        """As plain data, for the side door of an emulated lab."""
        if self.poster is None:
            return {"seed": self.seed, "names": list(self.names)}
        p = self.poster
        png = base64.b64encode(cv2.imencode(".png", p.image)[1].tobytes()).decode()
        poster = {"image": png, "size": list(p.size), "mount": p.mount, "pose": p.pose.tolist()}
        return {"seed": self.seed, "names": list(self.names), "poster": poster}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Bench:
        """The inverse of `to_json`. Raises ValueError, KeyError or TypeError on anything else."""
        poster = None
        if data.get("poster") is not None:
            given = data["poster"]
            image = cv2.imdecode(np.frombuffer(base64.b64decode(given["image"]), np.uint8), cv2.IMREAD_GRAYSCALE)
            pose = np.array(given["pose"], dtype=np.float64)
            if image is None or pose.shape != (4, 4) or given["mount"] not in ("world", "flange"):
                raise ValueError("no poster")
            width, height = given["size"]
            poster = Poster(image, (float(width), float(height)), given["mount"], pose)
        return Bench(int(data["seed"]), tuple(map(str, data["names"])), poster)


def displaced(rig: Rig, seed: int) -> Rig:
    """The rig with every camera a little off its place: the truth that a calibration has to find out."""
    rng = np.random.default_rng([seed, 20_261_122])
    cameras = []
    for camera in rig.cameras:
        turn, shift = rng.normal(0.0, CAMERA_TURN, 3), rng.normal(0.0, CAMERA_SHIFT, 3)
        off = spatial.transform(spatial.rotation_from_vector(turn), shift)
        cameras.append(replace(camera, pose=camera.pose @ off))
    return replace(rig, cameras=tuple(cameras))


def empty_task(rig: Rig, seed: int) -> Task:
    """Nothing on the table."""
    state = State({R: rig.robot_features(rig.arm.home, rig.gripper.max_opening)})
    return Task((R,), state, frozenset(), draw_physics(np.random.default_rng(seed), []), seed)


ROW_X, ROW_WIDTH, ROW_SPACING = 0.46, 0.055, 0.12
"""Where things stand in a row, m."""


def row_task(rig: Rig, names: Sequence[str], seed: int) -> Task:
    """Blocks on the bare table from the robot's left to its right, of hues that nobody knows beforehand."""
    rng = np.random.default_rng([seed, 20_261_122])
    physics = draw_physics(rng, names)
    first = rng.uniform()
    features = {R: rig.robot_features(rig.arm.home, rig.gripper.max_opening)}
    for i, name in enumerate(names):
        hue = (first + (i + rng.uniform(-0.1, 0.1)) / len(names)) % 1.0
        physics["colours"][name] = colorsys.hsv_to_rgb(hue, rng.uniform(0.8, 0.95), rng.uniform(0.65, 0.9))
        place = [ROW_X, (len(names) - 1) / 2 * ROW_SPACING - i * ROW_SPACING, 0.0225]
        quat = spatial.quat_from_yaw(rng.uniform(-0.7, 0.7))
        features[BLOCK(name)] = np.array([*place, *quat, ROW_WIDTH, ROW_WIDTH, 0.045])
    state = State(features)
    return Task(state.objects, state, frozenset(), physics, seed)


class CalibrationWorld(SimWorld):
    """`SimWorld` with a poster in it.

    Args:
        task: see `empty_task`.
        rig: where the cameras really are.
        poster: what stands or is held there; None for nothing.

    Raises:
        RenderError: no device can render.
    """

    def __init__(self, task: Task, rig: Rig, poster: Poster | None) -> None:
        super().__init__(task, rig, rendered=True)
        if poster is not None:
            self._add(poster)

    def _add(self, poster: Poster) -> None:
        paint = render.RenderMaterial()
        paint.base_color = [1.0, 1.0, 1.0, 1.0]
        paint.roughness, paint.metallic, paint.specular = 0.9, 0.0, 0.0
        rgba = np.dstack([poster.image] * 3 + [np.full_like(poster.image, 255)])
        # Without the smaller copies a far board would glitter.
        paint.base_color_texture = render.RenderTexture2D(
            np.ascontiguousarray(rgba), "R8G8B8A8Unorm", mipmap_levels=6, address_mode="edge"
        )
        width, height = poster.size
        corners = np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]], dtype=np.float32)
        towards_viewer = np.tile(np.array([0, 0, -1], dtype=np.float32), (4, 1))
        uvs = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)
        triangles = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.uint32)
        look = render.RenderBodyComponent()
        look.attach(render.RenderShapeTriangleMesh(corners, triangles, towards_viewer, uvs, paint))
        # The back of the sheet, plain grey: seen from behind, a board must not be read mirrored.
        back = render.RenderMaterial()
        back.base_color = [0.5, 0.5, 0.5, 1.0]
        behind = corners + np.array([0, 0, 1e-3], dtype=np.float32)
        look.attach(render.RenderShapeTriangleMesh(behind, triangles[:, ::-1].copy(), -towards_viewer, uvs, back))
        entity = sapien.Entity()
        entity.name = "poster"
        if poster.mount == "flange":
            # A body of its own that is carried along: see `render`.
            self._carried = (entity, poster.pose)
        entity.add_component(look)
        entity.set_pose(sapien.Pose(poster.pose))
        self.built.scene.add_entity(entity)

    _carried: tuple[sapien.Entity, np.ndarray] | None = None

    def render(self, name: str):  # type: ignore[no-untyped-def]
        """A noiseless picture, the held poster where the hand is now."""
        if self._carried is not None:
            entity, flange_T_poster = self._carried
            flange = self.built.flange.entity_pose.to_transformation_matrix()
            entity.set_pose(sapien.Pose(flange @ flange_T_poster))
        return super().render(name)

    def robot_mask(self, name: str) -> Bool[np.ndarray, "h w"]:
        """Which pixels of the last picture of that camera show the robot."""
        segmentation = self.built.cameras[name].get_picture("Segmentation")[..., 1]
        return np.isin(segmentation, [link.entity.per_scene_id for link in self.built.robot.links])
