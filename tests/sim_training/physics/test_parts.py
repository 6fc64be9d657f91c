"""Blocks from convex solids: the sizes they claim, a socket that takes the stud."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from resync_robot.core.solids import Cuboid
from resync_robot.sim_training.physics.parts import (
    CHAMFER,
    CLEARANCE,
    SOCKET_DEPTH,
    STUD_HEIGHT,
    STUD_WIDTH,
    Convex,
    block_shapes,
    hull_triangles,
)

sizes = st.tuples(st.floats(0.045, 0.07), st.floats(0.045, 0.07), st.floats(0.035, 0.06))


def corners(shape: Convex | Cuboid) -> np.ndarray:
    if isinstance(shape, Convex):
        return shape.vertices
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return shape.centre + signs * shape.half


def inside(shapes: list[Convex | Cuboid], points: np.ndarray) -> np.ndarray:
    """(n,) is each point in some solid?"""
    found = np.zeros(len(points), bool)
    for shape in shapes:
        planes = ConvexHull(corners(shape)).equations
        found |= np.all(points @ planes[:, :3].T + planes[:, 3] <= 1e-9, axis=1)
    return found


@given(sizes)
def test_a_block_is_as_large_as_it_says_with_the_stud_on_top(size: tuple[float, float, float]) -> None:
    points = np.concatenate([corners(s) for s in block_shapes(size)])
    half = np.array(size) / 2
    np.testing.assert_allclose(points.min(0), -half, atol=1e-9)
    np.testing.assert_allclose(points.max(0), half + [0, 0, STUD_HEIGHT], atol=1e-9)


@given(sizes, st.integers(0, 1000))
def test_the_stud_fits_the_socket_with_its_clearance(size: tuple[float, float, float], seed: int) -> None:
    shapes = block_shapes(size)
    half_z = size[2] / 2
    rng = np.random.default_rng(seed)
    # Points of the socket: as wide as the stud and a little less than the clearance on each side.
    reach = STUD_WIDTH / 2 + CLEARANCE - 1e-6
    points = rng.uniform([-reach, -reach, -half_z], [reach, reach, -half_z + SOCKET_DEPTH - 1e-6], (200, 3))
    assert not inside(shapes, points).any()
    # Just beyond the hole, above its chamfer, there is a wall all round; above the socket a roof.
    ring = rng.uniform(-reach, reach, 50)
    height = rng.uniform(-half_z + CHAMFER[1] + 1e-6, -half_z + SOCKET_DEPTH, 50)
    for across in (np.full(50, reach + 1e-4), np.full(50, -reach - 1e-4)):
        assert inside(shapes, np.stack([across, ring, height], 1)).all()
        assert inside(shapes, np.stack([ring, across, height], 1)).all()
    assert inside(shapes, np.array([[0, 0, -half_z + SOCKET_DEPTH + 1e-6]])).all()
    assert SOCKET_DEPTH > STUD_HEIGHT


def test_the_mouth_is_wider_than_the_hole_by_the_chamfer() -> None:
    shapes = block_shapes((0.06, 0.06, 0.045))
    mouth = STUD_WIDTH / 2 + CLEARANCE + CHAMFER[0]
    z = -0.0225 + 1e-5
    assert not inside(shapes, np.array([[mouth - 1e-4, 0, z], [0, -mouth + 1e-4, z]])).any()
    assert inside(shapes, np.array([[mouth + 1e-4, 0, z], [0, -mouth - 1e-4, z]])).all()
    assert np.rad2deg(np.arctan2(CHAMFER[1], CHAMFER[0])) == pytest.approx(60, abs=1)


@pytest.mark.parametrize("shape", block_shapes((0.06, 0.06, 0.045)), ids=range(6))
def test_a_drawn_solid_is_closed_and_faces_outward(shape: Convex | Cuboid) -> None:
    solid = corners(shape)
    vertices, triangles, normals = hull_triangles(solid)
    assert triangles.max() == len(vertices) - 1 and len(normals) == len(vertices)
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    turned = np.cross(b - a, c - a)
    area = np.linalg.norm(turned, axis=1) / 2
    assert area.sum() == pytest.approx(ConvexHull(solid).area)
    np.testing.assert_allclose(turned / (2 * area[:, None]), normals[triangles[:, 0]], atol=1e-6)
    # The divergence theorem: only a closed surface that faces outward has the solid's volume.
    assert np.einsum("ij,ij->", a, turned) / 6 == pytest.approx(ConvexHull(solid).volume)
