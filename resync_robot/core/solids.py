"""Of what boxes an object is made, and its outline in the plane, for drawings."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.ros_messages import Marker
from resync_robot.core.state import State
from resync_robot.core.symbols import ROUND, SE3, Object
from resync_robot.core.vocabulary import BOX

FLOOR = 0.002
"""m; half of how thick the floor of a box is drawn, for nobody measures it."""
CIRCLE = 48
"""Corners of an outline that is round."""
LETTERS = 0.03
"""m; height of an object's name."""


def boxes(obj: Object, features: Float[np.ndarray, "f"]) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Middles and half sizes, m, in the object's frame: floor and walls of a box, one body of what else has a size.

    Raises:
        ValueError: it has none.
    """
    if obj.type != BOX:
        if not obj.type.extents:
            raise ValueError(f"{obj.name} has no size")
        return np.zeros((1, 3)), features[None, [obj.type.features.index(name) for name in obj.type.extents]] / 2
    inner_x, inner_y, wall_z, thick = features[7:11]
    outer_x, outer_y = inner_x + 2 * thick, inner_y + 2 * thick
    slabs = [((0, 0, -FLOOR), (outer_x / 2, outer_y / 2, FLOOR))]
    for sign in (1, -1):
        slabs.append(((sign * (inner_x + thick) / 2, 0, wall_z / 2), (thick / 2, outer_y / 2, wall_z / 2)))
        slabs.append(((0, sign * (inner_y + thick) / 2, wall_z / 2), (inner_x / 2, thick / 2, wall_z / 2)))
    return np.array([s[0] for s in slabs]), np.array([s[1] for s in slabs])


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
