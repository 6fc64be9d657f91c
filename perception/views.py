"""One picture turned into labelled points of the world: deprojection, the robot's own hand, the table as a ruler."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from resync_robot.core import spatial
from resync_robot.core.errors import PerceptionError
from resync_robot.core.rig import Rig
from resync_robot.core.world import CameraFrame
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.segment import Segmenter

BACKGROUND = -1
HAND_HALF = (0.075, 0.115)
"""Half extents of what the hand sweeps, along x and y of the flange, m."""
HAND_BELOW_TIP = 0.075
"""How far a held block (or two, joined) may hang below the tips, m."""


@dataclass(frozen=True)
class View:
    """One picture in the world.

    Attributes:
        world_T_cam: (4, 4) pose of the camera, after `level` corrected by the table.
        ray: (H, W, 3) direction of every pixel in the camera, with z = 1.
        depth: (H, W) m, 0 where there is none or where the hand is in the way.
        points: (H, W, 3) in the world; meaningless where depth is 0.
        labels: (H, W) index into the catalogue's `look_alikes`, BACKGROUND elsewhere.
        hidden: (H, W) True where the hand, or what it holds, hides the scene.
    """

    intrinsics: Float[np.ndarray, "3 3"]
    world_T_cam: Float[np.ndarray, "4 4"]
    ray: Float[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]
    points: Float[np.ndarray, "h w 3"]
    labels: Int[np.ndarray, "h w"]
    hidden: Bool[np.ndarray, "h w"]

    @property
    def valid(self) -> Bool[np.ndarray, "h w"]:
        return self.depth > 0

    def project(self, points: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
        """Pixel coordinates and depth (m) of points of the world."""
        local = spatial.apply(spatial.inverse(self.world_T_cam), points)
        z = np.maximum(local[:, 2], 1e-6)
        k = self.intrinsics
        return np.stack([k[0, 0] * local[:, 0] / z + k[0, 2], k[1, 1] * local[:, 1] / z + k[1, 2]], -1), local[:, 2]

    def moved(self, world_T_cam: Float[np.ndarray, "4 4"]) -> View:
        """The same picture from a corrected camera pose."""
        return replace(self, world_T_cam=world_T_cam, points=_world_points(self.ray, self.depth, world_T_cam))


def make_view(frame: CameraFrame, segmenter: Segmenter, catalogue: Catalogue, rig: Rig) -> View:
    """Deproject and label a frame.

    Raises:
        PerceptionError: no usable depth, a black picture, shapes that do not fit.
    """
    _check(frame)
    names = [alike[0] for alike in catalogue.look_alikes]
    labels = np.full(frame.depth.shape, BACKGROUND, dtype=np.int8)
    for segment in segmenter.segment(frame):
        if segment.label in names:
            labels[segment.mask] = names.index(segment.label)
    height, width = frame.depth.shape
    k = frame.intrinsics
    # Single precision is a ten thousandth of a millimetre here, and halves what a large picture costs.
    u, v = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    k32 = k.astype(np.float32)
    ray = np.stack([(u - k32[0, 2]) / k32[0, 0], (v - k32[1, 2]) / k32[1, 1], np.ones_like(u)], -1)
    depth = frame.depth * np.float32(CameraFrame.DEPTH_UNIT_M)
    points = _world_points(ray, depth, frame.world_T_cam)
    hidden = _hand(frame, points, depth, rig)
    return View(k, frame.world_T_cam, ray, np.where(hidden, np.float32(0.0), depth), points, labels, hidden)


def level(view: View, catalogue: Catalogue, box_outline: np.ndarray | None) -> View:
    """Turn and lift the camera so that the table, and the box's floor, lie where they are known to lie.

    That takes three of the six errors out of the camera's pose: height, and both tilts, which matter most.

    Args:
        box_outline: (4, 2) rough corners of the box's outer edge, or None when no box was seen.

    Raises:
        PerceptionError: too little of the table is seen.
    """
    every = max(2, round(2 * view.depth.shape[1] / 424))
    points, labels, valid = (a[::every, ::every] for a in (view.points, view.labels, view.valid))
    p = points[valid & (labels == BACKGROUND)].astype(np.float64)
    expected = np.full(len(p), catalogue.table_z)
    usable = np.abs(p[:, 2] - catalogue.table_z) < 0.03
    if box_outline is not None:
        away = _distance_inside(p[:, :2], box_outline)
        inside = away > catalogue.wall_thickness + 0.012
        expected[inside] += catalogue.floor_thickness
        usable &= inside | (away < -0.012)
    p, expected = p[usable], expected[usable]
    if len(p) < 200:
        raise PerceptionError(
            f"only {len(p)} points of the table or the box's floor are seen in a picture, 200 are needed",
            "check that the depth unit is 1e-4 m and that the camera's pose in rig.toml is right",
        )
    camera = view.world_T_cam[:3, 3]
    design = np.column_stack([p[:, :2] - camera[:2], np.ones(len(p))])
    error = p[:, 2] - expected
    keep = np.ones(len(p), dtype=bool)
    for _ in range(3):
        (a, b, c), *_ = np.linalg.lstsq(design[keep], error[keep], rcond=None)
        residual = error - design @ (a, b, c)
        keep = np.abs(residual) < 3 * max(float(np.std(residual[keep])), 5e-4)
    turn = spatial.rotation_from_vector(np.array([-b, a, 0.0]))
    pose = view.world_T_cam.copy()
    pose[:3, :3] = turn @ pose[:3, :3]
    pose[2, 3] -= c
    return view.moved(pose)


def gather(views: Sequence[View], mask: Sequence[np.ndarray]) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "n"]]:
    """Points of all views under their masks, and which view each came from."""
    points = [v.points[m] for v, m in zip(views, mask, strict=True)]
    return np.concatenate(points).astype(np.float64), np.repeat(np.arange(len(views)), [len(p) for p in points])


def _world_points(ray: np.ndarray, depth: np.ndarray, world_T_cam: np.ndarray) -> np.ndarray:
    # One product over all pixels: numpy would loop over the rows of an (H, W, 3) operand.
    local = (ray * depth[..., None]).reshape(-1, 3)
    pose = world_T_cam.astype(ray.dtype)
    return (local @ pose[:3, :3].T + pose[:3, 3]).reshape(ray.shape)


def _hand(frame: CameraFrame, points: np.ndarray, depth: np.ndarray, rig: Rig) -> np.ndarray:
    """(H, W) what lies inside the volume of the hand and of a held block, and the pixels around."""
    camera = rig.camera(frame.name)
    if camera.mount != "flange":
        return np.zeros(depth.shape, dtype=bool)
    flange_T_world = camera.pose @ spatial.inverse(frame.world_T_cam)
    local = spatial.apply(flange_T_world.astype(points.dtype), points.reshape(-1, 3)).reshape(points.shape)
    inside = (
        (np.abs(local[..., 0]) < HAND_HALF[0])
        & (np.abs(local[..., 1]) < HAND_HALF[1])
        & (local[..., 2] < rig.gripper.tip_offset + HAND_BELOW_TIP)
    )
    too_near = (depth > 0) & (depth < 0.12)
    near = ((inside & (depth > 0)) | too_near).astype(np.uint8)
    near = cv2.morphologyEx(near, cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
    return cv2.dilate(near, np.ones((7, 7), np.uint8)).astype(bool)


def _distance_inside(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """(n,) m from the outline of a convex polygon, positive inside."""
    centre = outline.mean(axis=0)
    nearest = np.full(len(points), np.inf)
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        normal = np.array([-(b - a)[1], (b - a)[0]]) / np.linalg.norm(b - a)
        normal = normal if normal @ (centre - a) > 0 else -normal
        nearest = np.minimum(nearest, (points - a) @ normal)
    return nearest


def _check(frame: CameraFrame) -> None:
    depth, where = frame.depth, f"camera '{frame.name}'"
    if depth.ndim != 2 or depth.size == 0 or frame.colour.shape[:2] != depth.shape:
        raise PerceptionError(
            f"{where}: colour is {frame.colour.shape}, depth {depth.shape}; they must be aligned, (H, W, 3) and (H, W)",
            "switch on the alignment of depth to colour",
        )
    if depth.dtype != np.uint16:
        raise PerceptionError(
            f"{where}: depth is {depth.dtype}, it must be uint16 in units of 1e-4 m", "convert metres with * 10000"
        )
    seen = depth[depth > 0]
    if len(seen) < 0.05 * depth.size:
        raise PerceptionError(
            f"{where}: only {100 * len(seen) / depth.size:.1f} % of the depth picture holds a measurement",
            "check the depth stream and the light, and that nothing is nearer than the camera's least depth",
        )
    middle = float(np.median(seen)) * CameraFrame.DEPTH_UNIT_M
    if not 0.12 <= middle <= 3.0:
        raise PerceptionError(
            f"{where}: the median depth is {middle:.3f} m, a table is 0.12-3 m away",
            "depth must come in units of 1e-4 m; a camera that gives mm needs * 10",
        )
    if float(frame.colour.mean()) < 8:
        raise PerceptionError(f"{where}: the colour picture is black", "uncover the lens, or raise the exposure")
