"""Of what boxes an object is made, for simulations and drawings, and its outline in the plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.fittings import DRAWER as DRAWER_SHAPE
from resync_robot.core.fittings import LID as LID_SHAPE
from resync_robot.core.fittings import Drawer, Lid
from resync_robot.core.ros_messages import Marker
from resync_robot.core.state import State
from resync_robot.core.symbols import ROUND, SE3, Object
from resync_robot.core.vocabulary import BOX, DRAWER, LID

BOX_FLOOR = 0.005
"""m; how thick the floor of a box is."""
CIRCLE = 48
"""Corners of an outline that is round."""
LETTERS = 0.03
"""m; height of an object's name."""

Size = Sequence[float] | np.ndarray


@dataclass(frozen=True)
class Cuboid:
    """A box by its (3,) centre and (3,) half extents."""

    centre: np.ndarray
    half: np.ndarray


def boxes(obj: Object, features: Float[np.ndarray, "f"]) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Middles and half sizes, m, in the object's frame: floor and walls of a box, plate and knob of a lid, a drawer
    with its cabinet, one body of what else has a size.

    Raises:
        ValueError: it has none.
    """
    if obj.type == BOX:
        parts = box_shapes(*features[7:11])
    elif not obj.type.extents:
        raise ValueError(f"{obj.name} has no size")
    else:
        size = features[[obj.type.features.index(name) for name in obj.type.extents]]
        if obj.type == LID:
            parts = lid_shapes(size)
        elif obj.type == DRAWER:
            parts = _drawer_and_cabinet(features)
        else:
            parts = [Cuboid(np.zeros(3), size / 2)]
    return np.array([part.centre for part in parts]), np.array([part.half for part in parts])


def box_shapes(inner_x: float, inner_y: float, wall_z: float, wall_thickness: float) -> list[Cuboid]:
    """Floor and four walls of an open box; the origin is the middle of the floor's upper face."""
    t, half_x, half_y = wall_thickness, inner_x / 2, inner_y / 2
    middle, half_height = (wall_z - BOX_FLOOR) / 2, (wall_z + BOX_FLOOR) / 2
    walls = [
        Cuboid(np.array([s * (half_x + t / 2), 0, middle]), np.array([t / 2, half_y + t, half_height])) for s in (-1, 1)
    ] + [Cuboid(np.array([0, s * (half_y + t / 2), middle]), np.array([half_x, t / 2, half_height])) for s in (-1, 1)]
    return [Cuboid(np.array([0, 0, -BOX_FLOOR / 2]), np.array([half_x, half_y, BOX_FLOOR / 2])), *walls]


def _drawer_and_cabinet(features: Float[np.ndarray, "11"]) -> list[Cuboid]:
    """All that a drawer is made of, in its own frame: what slides, and the cabinet, further behind the wider it is
    open."""
    front, handle = drawer_shapes(features[8:11])
    face = (spatial.inverse(spatial.pose_from_features(features[:7])) @ DRAWER_SHAPE.face(features))[:3, 3]
    return [*front, *handle, *(Cuboid(part.centre + face, part.half) for part in cabinet_shapes())]


def lid_shapes(size: Size, lid: Lid = LID_SHAPE) -> list[Cuboid]:
    """The plate, with its full extents `size`, and the knob; the origin is the middle of the plate."""
    plate, knob = np.asarray(size) / 2, np.array(lid.knob) / 2
    return [Cuboid(np.zeros(3), plate), Cuboid(np.array([0.0, 0.0, plate[2] + knob[2]]), knob)]


def drawer_shapes(size: Size, drawer: Drawer = DRAWER_SHAPE) -> tuple[list[Cuboid], list[Cuboid]]:
    """A front of full extents `size` with the tray behind it, and the handle. The origin is the middle of the front, x
    the way it is pulled."""
    thick, _, high = size
    deep, wide, tall = drawer.tray
    wall, table = drawer.wall, -drawer.lift - high / 2
    back, floor = -thick / 2, table + drawer.floor
    rear, half = back - deep, wide / 2
    tray = [
        Cuboid(np.zeros(3), np.asarray(size) / 2),
        _slab((rear, back), (-half - wall, half + wall), (-high / 2, floor)),
        _slab((rear - wall, rear), (-half - wall, half + wall), (-high / 2, floor + tall)),
        *(_slab((rear, back), y, (floor, floor + tall)) for y in ((-half - wall, -half), (half, half + wall))),
    ]
    (x, y, z), out = drawer.bar, thick / 2 + drawer.reach - drawer.bar[0]
    heights = (table + drawer.bar_z - z / 2, table + drawer.bar_z + z / 2)
    posts = [_slab((thick / 2, out), ends, heights) for ends in ((-y / 2, x - y / 2), (y / 2 - x, y / 2))]
    return tray, [_slab((out, out + x), (-y / 2, y / 2), heights), *posts]


def _slab(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Cuboid:
    """Between these ends, m."""
    ends = np.array([x, y, z], dtype=np.float64)
    return Cuboid(ends.mean(1), (ends[:, 1] - ends[:, 0]) / 2)


def cabinet_shapes(drawer: Drawer = DRAWER_SHAPE) -> list[Cuboid]:
    """Two sides, a back and a top; the origin is the middle of its face on the table, x out of it."""
    deep, wide, high = drawer.cabinet
    t = drawer.wall
    sides = [
        Cuboid(np.array([-deep / 2, s * (wide - t) / 2, high / 2]), np.array([deep, t, high]) / 2) for s in (-1, 1)
    ]
    back = Cuboid(np.array([-deep + t / 2, 0.0, high / 2]), np.array([t, wide, high]) / 2)
    top = Cuboid(np.array([-deep / 2, 0.0, high - t / 2]), np.array([deep, wide, t]) / 2)
    return [*sides, back, top]


def outline(obj: Object, features: Float[np.ndarray, "f"]) -> Float[np.ndarray, "n 2"]:
    """Corners in the plane, m, of an object with a pose there: round, or a rectangle; without extents its place."""
    x, y, theta = features[:3]
    if not obj.type.extents:
        return np.array([[x, y]])
    if obj.type.symmetry == ROUND:
        angles = np.arange(CIRCLE) * 2 * np.pi / CIRCLE
        corners = np.stack([np.cos(angles), np.sin(angles)], -1)
    else:
        corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    local = corners * features[[obj.type.features.index(name) for name in obj.type.extents]] / 2
    cos, sin = np.cos(theta), np.sin(theta)
    return local @ np.array([[cos, sin], [-sin, cos]]) + (x, y)


def scene_markers(state: State, colour: tuple[float, float, float, float], outlined: bool) -> list[Marker]:
    """All that has a pose and a size, in the world; solid things have their names above them."""
    shown: list[Marker] = []
    for obj in state.objects:
        if obj.type.pose != SE3 or not (obj.type == BOX or obj.type.extents):
            continue
        pose = spatial.pose_from_features(state[obj][:7])
        middles, halves = boxes(obj, state[obj])
        for i, (middle, half) in enumerate(zip(middles, halves, strict=True)):
            shown.append(Marker(obj.name, i, pose @ spatial.transform(None, middle), 2 * half, colour, outlined))
        if not outlined:
            above = pose.copy()
            above[2, 3] += float((middles + halves)[:, 2].max()) + LETTERS
            white = (1.0, 1.0, 1.0, 1.0)
            shown.append(Marker(obj.name, len(middles), above, np.full(3, LETTERS), white, text=obj.name))
    return shown
