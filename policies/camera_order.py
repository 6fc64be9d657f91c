"""Which camera each picture is from, by geometry: where blocks stand and what colour they have says what each shows.

The scan knows the blocks' poses, the catalogue their hues, and the calibration where each camera stands. So every
camera foretells where in its picture a hue must be; exchanged cameras foretell each other's pictures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from resync_robot.core import spatial
from resync_robot.core.rig import CameraRig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, BOX
from resync_robot.core.world import Window

SIZE = 128
"""Pixels of a side of the whole pictures, squeezed, that are looked at."""
HUE_WITHIN = 0.08
"""What coloured light and white balance turn a hue by, and some; perception, which has to tell more, allows less."""
LEAST_CHROMA, LEAST_SATURATION = 10, 0.25
"""Of a pixel that has a hue at all, the first of 255: even in a dark shadow blocks have that."""
GRID = np.array([(a, b) for a in np.linspace(-0.8, 0.8, 5) for b in np.linspace(-0.8, 0.8, 5)])
SURE, UNLIKE = 0.35, 0.2
"""Blocks that an order must find more than the given one, all pictures together, and fewer at most in any of them."""
LEAST_POINTS = 10
"""Points of a block that a camera must see by geometry, to foretell anything of it."""


@dataclass(frozen=True)
class Foretold:
    """Where one camera must see one hue.

    Attributes:
        hue: in [0, 1).
        pixels: (n, 2) int columns and rows.
    """

    hue: float
    pixels: np.ndarray


def whole(camera: CameraRig) -> Window:
    """All of the camera's picture."""
    return Window(0.0, 0.0, float(camera.width), float(camera.height))


def foretell(
    camera: CameraRig, world_T_cam: Float[np.ndarray, "4 4"], state: State, hues: Mapping[str, float]
) -> list[Foretold]:
    """What a camera must see of every block of a known hue, walls and other blocks taken into account."""
    blocks = state.of_type(BLOCK)
    walls = [w for box in state.of_type(BOX) for w in _walls(state, box)]
    bodies = {b: _Cuboid(spatial.pose_from_features(state[b][:7]), np.array(state[b][7:10]) / 2) for b in blocks}
    found = []
    for block in (b for b in blocks if b.name in hues):
        points = bodies[block].facing(world_T_cam[:3, 3])
        others = [*walls, *(body for b, body in bodies.items() if b != block)]
        hidden = np.zeros(len(points), dtype=bool)
        for other in others:
            hidden |= other.between(world_T_cam[:3, 3], points)
        pixels = _project(camera, world_T_cam, points[~hidden])
        if len(pixels) >= LEAST_POINTS:
            found.append(Foretold(hues[block.name], pixels))
    return found


def support(pictures: UInt8[np.ndarray, "v s s 3"], foretold: Sequence[Sequence[Foretold]]) -> Float[np.ndarray, "v v"]:
    """How much of what camera j foretells is in picture i: for each block the share of its pixels, added up."""
    found = np.zeros((len(pictures), len(foretold)))
    for i, picture in enumerate(pictures):
        shows = _Hues(picture)
        for j, of_camera in enumerate(foretold):
            found[i, j] = sum(shows.share(f) for f in of_camera)
    return found


def exchanged(found: Float[np.ndarray, "v v"]) -> tuple[int, ...] | None:
    """Which camera each picture is from, where another order than the given one explains the pictures better.

    Every picture that takes part must agree, and together they must show more: where nothing can be seen, by shade or
    behind a wall, no order is better than any other, and the given one stands.

    Args:
        found: as of `support`.
    """
    given = tuple(range(len(found)))
    right = np.diag(found)
    best, most = None, SURE
    for order in permutations(given):
        gain = found[given, order] - right
        if gain.min() >= -UNLIKE and gain.sum() > most:
            best, most = order, float(gain.sum())
    return best


class _Hues:
    def __init__(self, picture: UInt8[np.ndarray, "s s 3"]) -> None:
        smooth = cv2.GaussianBlur(picture, (3, 3), 0.8)
        hsv = cv2.cvtColor(smooth, cv2.COLOR_RGB2HSV_FULL)
        chroma = smooth.max(-1).astype(int) - smooth.min(-1)
        self._coloured = (chroma >= LEAST_CHROMA) & (hsv[..., 1] >= 255 * LEAST_SATURATION)
        self._hue = hsv[..., 0] / 256

    def share(self, f: Foretold) -> float:
        """Of the pixels, those that have the hue, less what the whole picture has of it anyway."""
        shows: Bool[np.ndarray, "s s"] = self._coloured & (np.abs((self._hue - f.hue + 0.5) % 1.0 - 0.5) <= HUE_WITHIN)
        everywhere = float(shows.mean())
        here = float(shows[f.pixels[:, 1], f.pixels[:, 0]].mean())
        return max(0.0, here - everywhere)


@dataclass(frozen=True)
class _Cuboid:
    pose: Float[np.ndarray, "4 4"]
    half: Float[np.ndarray, "3"]

    def facing(self, eye: Float[np.ndarray, "3"]) -> Float[np.ndarray, "n 3"]:
        """Points of the faces that are turned to the eye, in the world."""
        local = spatial.apply(spatial.inverse(self.pose), eye[None])[0]
        faces = []
        for axis in range(3):
            if abs(local[axis]) > self.half[axis]:
                across = [k for k in range(3) if k != axis]
                points = np.empty((len(GRID), 3))
                points[:, across] = GRID * self.half[across]
                points[:, axis] = np.sign(local[axis]) * self.half[axis]
                faces.append(points)
        return spatial.apply(self.pose, np.concatenate(faces) if faces else np.zeros((0, 3)))

    def between(self, eye: Float[np.ndarray, "3"], points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Does it stand between the eye and each point?"""
        back = spatial.inverse(self.pose)
        start, ends = spatial.apply(back, eye[None])[0], spatial.apply(back, points)
        way = ends - start
        way = np.where(np.abs(way) < 1e-9, 1e-9, way)
        one, two = (-self.half - start) / way, (self.half - start) / way
        enters, leaves = np.minimum(one, two).max(1), np.maximum(one, two).min(1)
        return (enters < leaves) & (enters > 0) & (enters < 1 - 1e-3)


def _walls(state: State, box: Object) -> list[_Cuboid]:
    """The four walls of an open box, whose origin is the middle of its floor."""
    pose = spatial.pose_from_features(state[box][:7])
    x, y, height, thick = state.get(box, "inner_x", "inner_y", "wall_z", "wall_thickness")
    half_x, half_y = np.array([thick / 2, y / 2 + thick, height / 2]), np.array([x / 2, thick / 2, height / 2])
    along_x, along_y = np.array([x + thick, 0, height]) / 2, np.array([0, y + thick, height]) / 2
    places = [(along_x, half_x), (along_x * [-1, 1, 1], half_x), (along_y, half_y), (along_y * [1, -1, 1], half_y)]
    return [_Cuboid(pose @ spatial.transform(None, middle), half) for middle, half in places]


def _project(camera: CameraRig, world_T_cam: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "n 3"]) -> np.ndarray:
    """(m, 2) int pixels of those points that lie in the squeezed picture."""
    x, y, z = spatial.apply(spatial.inverse(world_T_cam), points).T
    ahead = z > 0.05
    x, y, z = x[ahead], y[ahead], z[ahead]
    u = (camera.fx * x / z + camera.cx + 0.5) / camera.width * SIZE
    v = (camera.fy * y / z + camera.cy + 0.5) / camera.height * SIZE
    inside = (u >= 0) & (u < SIZE) & (v >= 0) & (v < SIZE)
    return np.stack([u[inside], v[inside]], -1).astype(int)
