"""From where to look at a few places again: few pictures, close by, each place from two sides, with little travel."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from jaxtyping import Bool, Float

from resync_robot.core import spatial
from resync_robot.core.rig import CameraRig, Rig
from resync_robot.perception.scan import Scan

FINGERS, HELD = (0.014, 0.085, 0.0), (0.036, 0.085, 0.05)
"""Half extents along x and y of the flange, and how far below the tips, m: of open fingers, and with a
block in them."""
SET_BACK = 0.05
"""m from the middle of the picture to a place, away from a hand that holds something."""
TOP, AROUND = 0.05, 0.04
"""m above the table, and around its middle, that are to be seen of a block."""
FROM_TWO_SIDES = 0.8
"""Cosine of the angle between two views of a place, seen from above, up to which they count as two sides."""
SIDES = 12
"""Around each place, from which to choose."""


def next_views(
    scan: Scan,
    rig: Rig,
    places: Sequence[Float[np.ndarray, "2"]],
    box: Float[np.ndarray, "11"],
    begin: Float[np.ndarray, "6"],
    holding: bool,
) -> list[Float[np.ndarray, "6"]]:
    """Configurations that show each place from two sides, in an order that is quick to travel from (6,) `begin`, rad.

    Fewer sides, or none, of a place that the arm cannot look at.

    Args:
        box: features of the box, whose walls hide what stands at them from some sides.
        holding: a block is in the hand, and hides more than the fingers do.
    """
    yaws = np.arange(SIDES) * 2 * np.pi / SIDES
    aside = (SET_BACK if holding else 0.0) * np.column_stack([np.cos(yaws), np.sin(yaws)])
    near = [scan.close_by(np.asarray(place) - a, yaw) for place in places for a, yaw in zip(aside, yaws, strict=True)]
    candidates = np.array([q for q in near if q is not None] + scan.configurations)
    sides = np.array(
        [[_side(scan.camera, rig, q, np.asarray(place), box, holding) for q in candidates] for place in places]
    )
    chosen: list[int] = []
    open_places = list(range(len(places)))
    while open_places:
        # One pair for all of them, or else one for the first and whatever it shows of the others.
        pair = _quickest_pair(candidates, sides[open_places], begin) or _quickest_pair(
            candidates, sides[open_places[:1]], begin
        )
        if pair is None:
            chosen += [i for i in np.flatnonzero(np.isfinite(sides[open_places[0], :, 0]))[:1] if i not in chosen]
            open_places = open_places[1:]
            continue
        chosen += [i for i in pair if i not in chosen]
        begin = candidates[chosen[-1]]
        open_places = [p for p in open_places[1:] if not _from_two_sides(sides[p], chosen)]
    return [candidates[i] for i in chosen]


def _quickest_pair(
    candidates: Float[np.ndarray, "n 6"], sides: Float[np.ndarray, "places n 2"], begin: Float[np.ndarray, "6"]
) -> tuple[int, int] | None:
    """The two views that show every place from two sides, by the way of the joint that has most of it."""
    pairs = [p for p in permutations(range(len(candidates)), 2) if all(_from_two_sides(s, p) for s in sides)]

    def way(pair: tuple[int, int]) -> float:
        first, second = candidates[list(pair)]
        return float(np.abs(first - begin).max() + np.abs(second - first).max())

    return min(pairs, key=way, default=None)


def _from_two_sides(sides: Float[np.ndarray, "n 2"], views: Sequence[int]) -> bool:
    directions = sides[list(views)]
    return bool(np.any(directions @ directions.T < FROM_TWO_SIDES))


def _side(
    camera: CameraRig,
    rig: Rig,
    q: Float[np.ndarray, "6"],
    place: Float[np.ndarray, "2"],
    box: Float[np.ndarray, "11"],
    holding: bool,
) -> Float[np.ndarray, "2"]:
    """The direction, seen from above, from which the whole of a block at a place is seen; nan where it is not."""
    flange = rig.arm.world_T_base @ rig.arm.kinematics.forward(q)
    eye = (flange @ camera.pose)[:3, 3]
    around = np.arange(8) * np.pi / 4
    points = np.column_stack([place + AROUND * np.column_stack([np.cos(around), np.sin(around)]), np.full(8, TOP)])
    points = points[~_in_wall(points, box)]
    ways = eye + np.linspace(0.0, 1.0, 50)[:, None, None] * (points - eye)
    if not len(points) or not _in_picture(camera, flange, points) or _in_wall(ways, box).any():
        return np.full(2, np.nan)
    reach = HELD if holding else FINGERS
    from_flange = np.abs(spatial.apply(spatial.inverse(flange), ways.reshape(-1, 3)))
    if np.any(np.all(from_flange < (*reach[:2], rig.gripper.tip_offset + reach[2]), axis=1)):
        return np.full(2, np.nan)
    away = eye[:2] - place
    return np.asarray(away / (np.linalg.norm(away) + 1e-9))


def _in_picture(camera: CameraRig, flange: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "n 3"]) -> bool:
    x, y, z = spatial.apply(spatial.inverse(flange @ camera.pose), points).T
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    return bool(np.all((z > 0) & (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)))


def _in_wall(points: Float[np.ndarray, "*n 3"], box: Float[np.ndarray, "11"]) -> Bool[np.ndarray, "*n"]:
    """Which points of the world are inside the walls of the box."""
    local = np.abs(spatial.apply(spatial.inverse(spatial.pose_from_features(box[:7])), points.reshape(-1, 3)))
    beyond = (local[:, :2] - box[7:9] / 2).max(axis=1)
    return np.asarray((beyond > 0) & (beyond < box[10]) & (local[:, 2] < box[9])).reshape(points.shape[:-1])
