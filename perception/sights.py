"""What pictures must show of a thing, by its type, for an estimate of it; and what stands in their way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from resync_robot.core import spatial
from resync_robot.core.fittings import Drawer
from resync_robot.perception.scan import CLOSE_TIP_HEIGHT

TOP, AROUND = 0.05, 0.04
"""m above the table, and around its middle, that are to be seen of a block."""
BESIDE_AN_EDGE = 0.010
"""m on either side of the edge of a face that are to be seen, or nothing says that it ends there."""
ABOVE = 0.003
"""m above a face, so that what it belongs to does not hide it."""
FROM_HIGHER_UP = (0.34, 0.40)
"""m of the tips above the table, for what is wider than a block."""
PIECES = 4
"""Of an edge, each of which may be in another picture."""
WITHIN_WALLS = 0.05
"""m from the walls of a box to the middle of a block of which a look into it makes sure."""


@dataclass(frozen=True)
class Sight:
    """What is to be seen of one thing: patches of (n, 3) points, m in the world, each of which is all in one picture.

    Attributes:
        aims: (3,) points to turn the camera to, m in the world.
        once: patches of which one picture is enough.
        from_two_sides: patches to be seen from two sides.
        tip_heights: of the finger tips above the table at these looks, m.
    """

    aims: tuple[Float[np.ndarray, "3"], ...]
    once: tuple[Float[np.ndarray, "n 3"], ...] = ()
    from_two_sides: tuple[Float[np.ndarray, "n 3"], ...] = ()
    tip_heights: tuple[float, ...] = FROM_HIGHER_UP

    @property
    def patches(self) -> tuple[Float[np.ndarray, "n 3"], ...]:
        """All of them, those of which one picture is enough first."""
        return (*self.once, *self.from_two_sides)


@dataclass(frozen=True)
class Solid:
    """A cuboid that hides what is behind it.

    Attributes:
        world_T_middle: (4, 4) pose of its middle; half: (3,) m, half its extents along its own axes.
    """

    world_T_middle: Float[np.ndarray, "4 4"]
    half: Float[np.ndarray, "3"]

    def contains(self, points: Float[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        local = spatial.apply(spatial.inverse(self.world_T_middle), points.reshape(-1, 3))
        return np.asarray((np.abs(local) < self.half).all(axis=1)).reshape(points.shape[:-1])


def of_block(place: Sequence[float] | Float[np.ndarray, "2"]) -> Sight:
    """A block that stands somewhere on the table, m."""
    around = _around(np.asarray(place))
    return Sight((np.array([*place, 0.0]),), from_two_sides=(around,), tip_heights=(CLOSE_TIP_HEIGHT,))


def of_lid(features: Float[np.ndarray, "10"]) -> Sight:
    """All edges of the plate of a lid with these features."""
    top = spatial.pose_from_features(features[:7]) @ _at(0.0, 0.0, features[9] / 2 + ABOVE)
    return Sight((top[:3, 3],), _edges(top, features[7:9] / 2))


def of_drawer(features: Float[np.ndarray, "11"], built: Drawer) -> Sight:
    """All edges of the top of the cabinet, and the way that the upper edge of the front can be on."""
    face = built.face(features)
    top = face @ _at(-built.cabinet[0] / 2, 0.0, built.cabinet[2] + ABOVE)
    # Over a front that is closed, from where the cabinet does not hide most of it.
    ahead = np.linspace(built.front[0] / 3, built.travel + built.front[0] + BESIDE_AN_EDGE, PIECES)
    half = built.front[1] / 2 + BESIDE_AN_EDGE
    over_front = face @ _at(0.0, 0.0, built.lift + built.front[2] + ABOVE)
    front = [
        spatial.apply(over_front, np.array([[x, y, 0.0] for x in rows for y in columns]))
        for rows in pairwise(ahead)
        for columns in pairwise(np.linspace(-half, half, PIECES + 1))
    ]
    middle = face @ _at(0.0, 0.0, built.cabinet[2] / 2)
    return Sight((top[:3, 3], middle[:3, 3]), (*_edges(top, np.array(built.cabinet[:2]) / 2), *front))


def of_box(features: Float[np.ndarray, "11"]) -> Sight:
    """The rim of a box with these features, and all of its inside, wherever a block may stand in it."""
    pose, half = spatial.pose_from_features(features[:7]), features[7:9] / 2 - WITHIN_WALLS
    steps = np.linspace(-1.0, 1.0, 3)
    places = [(pose @ [*(half * (i, j)), 0.0, 1.0])[:2] for i in steps for j in steps]
    rim = pose @ _at(0.0, 0.0, features[9] + ABOVE)
    once = (*_edges(rim, features[7:9] / 2), *_edges(rim, features[7:9] / 2 + features[10]))
    return Sight((np.array([*pose[:2, 3], 0.0]),), once, tuple(_around(place) for place in places))


def cabinet_and_front(features: Float[np.ndarray, "11"], built: Drawer) -> tuple[Solid, Solid]:
    """What a drawer with these features hides things behind."""
    deep, wide, high = built.cabinet
    cabinet = built.face(features) @ _at(-deep / 2, 0.0, high / 2)
    return (
        Solid(cabinet, np.array([deep, wide, high]) / 2),
        Solid(spatial.pose_from_features(features[:7]), np.array(built.front) / 2),
    )


def _around(place: Float[np.ndarray, "2"]) -> Float[np.ndarray, "8 3"]:
    around = np.arange(8) * np.pi / 4
    return np.column_stack([place + AROUND * np.column_stack([np.cos(around), np.sin(around)]), np.full(8, TOP)])


def _edges(pose: Float[np.ndarray, "4 4"], half: Float[np.ndarray, "2"]) -> tuple[Float[np.ndarray, "4 3"], ...]:
    """A strip along each piece of each edge of a rectangle with these half extents, m, around a pose."""
    found = []
    for axis in (0, 1):
        for sign in (-1.0, 1.0):
            for ends in pairwise(np.linspace(-half[1 - axis], half[1 - axis], PIECES + 1)):
                points = np.zeros((4, 3))
                points[:, 1 - axis] = np.repeat(ends, 2)
                points[:, axis] = sign * (half[axis] + np.tile([-BESIDE_AN_EDGE, BESIDE_AN_EDGE], 2))
                found.append(spatial.apply(pose, points))
    return tuple(found)


def _at(x: float, y: float, z: float) -> Float[np.ndarray, "4 4"]:
    return spatial.transform(None, np.array([x, y, z]))
