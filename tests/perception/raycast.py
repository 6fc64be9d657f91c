"""Pictures of a table with a box and blocks, without a renderer: rays are intersected with boxes in numpy."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import numpy as np

from resync_robot.core import spatial
from resync_robot.core.rig import Rig
from resync_robot.core.world import CameraFrame
from resync_robot.perception.catalogue import CABINET, Catalogue
from resync_robot.perception.scan import Scan

GREY, WOOD = (90, 95, 100), (225, 215, 200)
CENTRE = (0.48, 0.0)
INNER, RIM, FLOOR, THICKNESS = 0.30, 0.11, 0.005, 0.03


def cuboid_hits(origin: np.ndarray, rays: np.ndarray, centre: np.ndarray, half: np.ndarray, yaw: float) -> np.ndarray:
    """(n,) distance along each ray to an upright cuboid, inf where it misses."""
    turn = spatial.rotation_about("z", yaw)
    o, d = (origin - centre) @ turn, rays @ turn
    with np.errstate(divide="ignore", invalid="ignore"):
        near, far = np.sort(np.stack([(-half - o) / d, (half - o) / d]), axis=0)
    enter, leave = near.max(axis=-1), far.min(axis=-1)
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)


class Table:
    """Cuboids on a table, seen by the wrist camera."""

    def __init__(self, rig: Rig, catalogue: Catalogue, box: bool = True) -> None:
        self._rig, self._catalogue = rig, catalogue
        self._cuboids: list[tuple[np.ndarray, np.ndarray, float, tuple[int, int, int]]] = []
        if box:
            outer = INNER / 2 + THICKNESS
            self._add((*CENTRE, FLOOR / 2), (INNER / 2, INNER / 2, FLOOR / 2), 0.0, GREY)
            for s in (-1, 1):
                middle = s * (INNER / 2 + THICKNESS / 2)
                self._add((CENTRE[0] + middle, CENTRE[1], RIM / 2), (THICKNESS / 2, outer, RIM / 2), 0.0, GREY)
                self._add((CENTRE[0], CENTRE[1] + middle, RIM / 2), (outer, THICKNESS / 2, RIM / 2), 0.0, GREY)

    def _add(self, centre: tuple, half: tuple, yaw: float, colour: tuple[int, int, int]) -> None:
        self._cuboids.append((np.array(centre), np.array(half), yaw, colour))

    def block(self, name: str, x: float, y: float, bottom: float, yaw: float, width: float, height: float) -> None:
        """An upright block with its stud."""
        self.coloured(name, (x, y, bottom + height / 2), (width / 2, width / 2, height / 2), yaw)
        self.coloured(name, (x, y, bottom + height + 0.006), (0.012, 0.012, 0.006), yaw)

    def lid(self, name: str, x: float, y: float, bottom: float, yaw: float) -> None:
        """A lid of the catalogue's size, with a knob in a colour that nothing else has."""
        size = self._catalogue.lids[name].size
        top = bottom + size[2]
        self.coloured(name, (x, y, bottom + size[2] / 2), tuple(s / 2 for s in size), yaw)
        self._add((x, y, top + 0.01), (0.012, 0.012, 0.01), yaw, GREY)

    def drawer(self, name: str, x: float, y: float, yaw: float, opening: float) -> None:
        """A cabinet of the catalogue's size around (x, y), its drawer pulled out along yaw."""
        sizes, turn = self._catalogue.drawers[name], spatial.rotation_about("z", yaw)
        depth, width, height = sizes.cabinet

        def ahead(distance: float, z: float) -> tuple[float, ...]:
            return tuple(np.array([x, y, z]) + turn @ np.array([distance, 0.0, 0.0]))

        self.coloured(name + CABINET, ahead(0.0, height / 2), (depth / 2, width / 2, height / 2), yaw)
        face = depth / 2 + opening
        centre = ahead(face + sizes.front[0] / 2, 0.004 + sizes.front[2] / 2)
        self.coloured(name, centre, tuple(s / 2 for s in sizes.front), yaw)
        self._add(ahead(face + sizes.front[0] + 0.01, 0.03), (0.01, 0.02, 0.004), yaw, GREY)
        if opening > 0.001:
            self._add(ahead(face - opening / 2, 0.02), (opening / 2, width / 2 - 0.008, 0.016), yaw, GREY)

    def coloured(self, name: str, centre: tuple, half: tuple, yaw: float) -> None:
        """A cuboid in the colour of something."""
        red, green, blue = (int(255 * c) for c in colorsys.hsv_to_rgb(self._catalogue.hues[name], 0.85, 0.8))
        self._add(centre, half, yaw, (red, green, blue))

    def picture(self, q: np.ndarray) -> CameraFrame:
        camera = self._rig.camera("wrist")
        k = camera.intrinsics
        pose = self._rig.arm.world_T_base @ self._rig.arm.kinematics.forward(q) @ camera.pose
        u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
        rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], -1).reshape(-1, 3)
        world_rays, origin = rays @ pose[:3, :3].T, pose[:3, 3]
        depth = -origin[2] / world_rays[:, 2]
        colour = np.tile(np.array(WOOD, np.uint8), (len(rays), 1))
        for centre, half, yaw, paint in self._cuboids:
            hit = cuboid_hits(origin, world_rays, centre, half, yaw)
            nearer = hit < depth
            depth = np.where(nearer, hit, depth)
            colour[nearer] = paint
        shape = (camera.height, camera.width)
        tenths = np.clip(depth.reshape(shape) / CameraFrame.DEPTH_UNIT_M + 0.5, 0, 65535).astype(np.uint16)
        return CameraFrame("wrist", colour.reshape(*shape, 3), tenths, k, pose, 0.0)

    def scan(self, configurations: Sequence[np.ndarray] | None = None) -> list[CameraFrame]:
        """The whole round, or pictures from these joint positions."""
        at: list[np.ndarray] = []
        return Scan(self._rig)(at.append, lambda: self.picture(at[-1]), configurations)
