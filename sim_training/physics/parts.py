"""Shapes of studded blocks with real sockets, and how to draw a convex solid. `core.solids` has what is made of boxes.

All vertices in m, in the frame of the part: a block's origin is the centre of its body, z out of the stud.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from resync_robot.core.solids import Cuboid

STUD_WIDTH = 0.024
STUD_HEIGHT = 0.012
CLEARANCE = 0.0015
"""Gap a side between stud and socket, within the 1-2 mm of the task."""
CHAMFER = (0.003, 0.0052)
"""Width and height of the 60-degree lead-in on stud and socket; 45 degrees jams against friction."""
SOCKET_DEPTH = 0.013
TABLE_TOP = 0.0


@dataclass(frozen=True)
class Convex:
    """A convex solid by its (n, 3) vertices."""

    vertices: np.ndarray


def block_shapes(size: tuple[float, float, float]) -> list[Convex | Cuboid]:
    """Stud, slab over the socket, and the four chamfered walls around it. `size` is the body's extents."""
    half_x, half_y, half_z = (s / 2 for s in size)
    slab_bottom = -half_z + SOCKET_DEPTH
    slab = Cuboid(np.array([0, 0, (slab_bottom + half_z) / 2]), np.array([half_x, half_y, (half_z - slab_bottom) / 2]))
    return [slab, Convex(_stud(half_z)), *(Convex(w) for w in _socket_walls(half_x, half_y, -half_z, slab_bottom))]


def _stud(bottom: float) -> np.ndarray:
    width, top_width = STUD_WIDTH / 2, STUD_WIDTH / 2 - CHAMFER[0]
    levels = [(bottom, width), (bottom + STUD_HEIGHT - CHAMFER[1], width), (bottom + STUD_HEIGHT, top_width)]
    return np.array([(sx * w, sy * w, z) for z, w in levels for sx in (-1, 1) for sy in (-1, 1)])


def _socket_walls(half_x: float, half_y: float, bottom: float, top: float) -> list[np.ndarray]:
    hole = STUD_WIDTH / 2 + CLEARANCE
    mouth = hole + CHAMFER[0]
    levels = [(bottom, mouth), (bottom + CHAMFER[1], hole), (top, hole)]
    walls = []
    for sign in (-1, 1):
        # Walls across x run the full width; walls across y fill what is left between them.
        walls.append(np.array([(sign * x, y, z) for z, h in levels for x in (h, half_x) for y in (-half_y, half_y)]))
        walls.append(np.array([(x, sign * y, z) for z, h in levels for y in (h, half_y) for x in (-mouth, mouth)]))
    return walls


def hull_triangles(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Flat-shaded mesh of a convex solid: (m, 3) vertices, (k, 3) triangles, (m, 3) normals, for drawing."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(vertices)
    corners, outward = vertices[hull.simplices], hull.equations[:, :3]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inside_out = (across * outward).sum(1) <= 0
    corners[inside_out, 1:] = corners[inside_out, :0:-1]
    triangles = np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)
    return corners.reshape(-1, 3), triangles, np.repeat(outward, 3, axis=0)
