"""What lids and drawers take up: solids that a hand must keep from, and the way that a drawer needs to open."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from resync_robot.core import fittings, spatial
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import DRAWER, LID


@dataclass(frozen=True)
class Footprint:
    """A rectangle on the table.

    Attributes:
        pose: (4, 4) of its middle in the world; only its place and heading count.
        half: (2,) half extents, m.
        top: m, height in the world up to which it is solid.
    """

    pose: Float[np.ndarray, "4 4"]
    half: Float[np.ndarray, "2"]
    top: float

    def away(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """m from each point to the nearest edge; negative inside."""
        local = np.abs((points - self.pose[:2, 3]) @ self.pose[:2, :2])
        return np.asarray((local - self.half).max(-1))


def footprints(state: State, ignore: Collection[Object] = ()) -> Iterator[Footprint]:
    """Of every lid and drawer: plates, knobs, fronts, handles, cabinets, and what is out of the walls of a tray."""
    for lid in state.of_type(LID):
        if lid not in ignore:
            yield from _of_lid(state, lid)
    for drawer in state.of_type(DRAWER):
        yield from _of_drawer(state, drawer)


def knob_top(state: State, lid: Object) -> float:
    """Height of a lid's knob in the world, m."""
    z, thickness = state.get(lid, "z", "size_z")
    return float(z + thickness / 2 + fittings.LID.knob[2])


def _of_lid(state: State, lid: Object) -> Iterator[Footprint]:
    pose, size = spatial.pose_from_features(state[lid][:7]), state.get(lid, "size_x", "size_y", "size_z")
    yield Footprint(pose, size[:2] / 2, float(pose[2, 3] + size[2] / 2))
    yield Footprint(pose, np.array(fittings.LID.knob[:2]) / 2, knob_top(state, lid))


def _of_drawer(state: State, drawer: Object) -> Iterator[Footprint]:
    built, size = fittings.DRAWER, state.get(drawer, "size_x", "size_y", "size_z")
    half, opening = size[0] / 2, float(state.get(drawer, "opening")[0])
    yield _part(state, drawer, (-half, half), size[1], float(state.get(drawer, "z")[0] + size[2] / 2))
    yield _part(state, drawer, (half, half + built.reach), built.bar[1], built.bar_z + built.bar[2] / 2)
    face = -half - opening
    yield _part(state, drawer, (face - built.cabinet[0], face), built.cabinet[1], built.cabinet[2])
    for side in (-1, 1):
        beside = side * (built.tray[1] + built.wall) / 2
        yield _part(state, drawer, (face, -half), built.wall, built.floor + built.tray[2], beside)


def ways_open(state: State) -> Iterator[Footprint]:
    """Of every drawer: what front, tray and handle sweep over from closed to open."""
    for drawer in state.of_type(DRAWER):
        size, opening = state.get(drawer, "size_x", "size_y"), float(state.get(drawer, "opening")[0])
        face = -size[0] / 2 - opening
        ahead = face + fittings.DRAWER.travel + size[0] + fittings.DRAWER.reach
        yield _part(state, drawer, (face, ahead), size[1], np.inf)


def in_a_way(state: State, points: Float[np.ndarray, "*n 2"], room: float) -> Bool[np.ndarray, "*n"]:
    """Whether what reaches `room` m around each point would be in the way of a drawer."""
    found = np.zeros(points.shape[:-1], dtype=bool)
    for way in ways_open(state):
        found |= way.away(points) < room
    return found


def _part(
    state: State, drawer: Object, ahead: tuple[float, float], width: float, top: float, beside: float = 0.0
) -> Footprint:
    """A rectangle from one distance to another ahead of the middle of a drawer's front."""
    pose = spatial.pose_from_features(state[drawer][:7])
    middle = pose @ spatial.transform(None, np.array([sum(ahead) / 2, beside, 0.0]))
    return Footprint(middle, np.array([(ahead[1] - ahead[0]) / 2, width / 2]), top)
