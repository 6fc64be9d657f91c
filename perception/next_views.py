"""From where to look at a few things again: few pictures, each thing shown as its type needs, with little travel."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, permutations

import numpy as np
from jaxtyping import Bool, Float

from resync_robot.core import spatial
from resync_robot.core.rig import CameraRig, Rig
from resync_robot.perception.scan import Scan
from resync_robot.perception.sights import Sight, Solid, of_block

FINGERS, HELD = (0.014, 0.085, 0.0), (0.036, 0.085, 0.05)
"""Half extents along x and y of the flange, and how far below the tips, m: of open fingers, and with a
block in them."""
SET_BACK = 0.05
"""m from the middle of the picture to a place, away from a hand that holds something."""
FROM_TWO_SIDES = 0.8
"""Cosine of the angle between two views of a place, seen from above, up to which they count as two sides."""
SIDES = 12
"""Around each place, from which to choose."""
SECOND_EYE = 0.05
"""m to the right of the first, of a stereo camera: what only one of them sees has no depth."""
MOST_ORDERED = 6
"""Views of which every order is tried."""


def next_views(
    scan: Scan,
    rig: Rig,
    places: Sequence[Float[np.ndarray, "2"]],
    box: Float[np.ndarray, "11"],
    begin: Float[np.ndarray, "6"],
    holding: bool,
    sights: Sequence[Sight] = (),
    solids: Sequence[Solid] = (),
) -> list[Float[np.ndarray, "6"]]:
    """Configurations that show each place of a block from two sides, in an order that is quick to travel from (6,)
    `begin`, rad.

    Fewer sides, or none, of what the arm cannot look at.

    Args:
        box: features of the box, whose walls hide what stands at them from some sides.
        holding: a block is in the hand, and hides more than the fingers do.
        sights: what else is to be seen, looked at first.
        solids: what hides things, apart from the box.
    """
    wanted = [*sights, *(of_block(place) for place in places)]
    candidates = np.array(_candidates(scan, wanted, holding) + scan.configurations)
    patches = [points for sight in wanted for points in sight.patches]
    sides = _sides(scan.camera, rig, candidates, patches, (box, solids), holding)
    ends = np.cumsum([0, *(len(sight.patches) for sight in wanted)])
    shown = [_Shown(sides[a:b], len(sight.once)) for (a, b), sight in zip(pairwise(ends), wanted, strict=True)]
    chosen: list[int] = []
    open_sights = shown
    while open_sights:
        # One pair for all of them, or else one for the first and whatever it shows of the others.
        quickest = _quickest_pair(candidates, open_sights, begin) or _quickest_pair(candidates, open_sights[:1], begin)
        found = quickest or _in_quick_order(candidates, open_sights[0].one_by_one(), begin)
        chosen += [i for i in dict.fromkeys(found) if i not in chosen]
        begin = candidates[chosen[-1]] if chosen else begin
        open_sights = [s for s in open_sights[1:] if not s.complete(chosen)]
    return [candidates[i] for i in chosen]


def _candidates(scan: Scan, sights: Sequence[Sight], holding: bool) -> list[Float[np.ndarray, "6"]]:
    """Configurations around what each sight aims at, as far as the arm reaches."""
    yaws = np.arange(SIDES) * 2 * np.pi / SIDES
    aside = (SET_BACK if holding else 0.0) * np.column_stack([np.cos(yaws), np.sin(yaws)])
    near = [
        scan.close_by(aim[:2] - a, yaw, tip_height, aim[2])
        for sight in sights
        for aim in sight.aims
        for tip_height in sight.tip_heights
        for a, yaw in zip(aside, yaws, strict=True)
    ]
    return [q for q in near if q is not None]


class _Shown:
    """What each of n views shows of one thing.

    Args:
        sides: direction, seen from above, from which each view shows each patch; nan where it does not.
        once: of how many patches, the first ones, one view is enough; the others are to be seen from two sides.
    """

    def __init__(self, sides: Float[np.ndarray, "patches n 2"], once: int) -> None:
        self._sees = np.isfinite(sides[..., 0])
        self._differ = np.einsum("pic,pjc->pij", sides[once:], sides[once:]) < FROM_TWO_SIDES
        self._once = once

    def pairs(self) -> Bool[np.ndarray, "n n"]:
        """Which two views, or one and the same, show all of it."""
        once = self._sees[: self._once]
        return np.asarray((once[:, :, None] | once[:, None, :]).all(axis=0) & self._differ.all(axis=0))

    def complete(self, views: Sequence[int]) -> bool:
        """Do these views show all of it?"""
        return self._count(views) == len(self._sees) + len(self._differ)

    def one_by_one(self) -> list[int]:
        """Views that show as much of it as any, each chosen for how much it adds."""
        chosen: list[int] = []
        while True:
            counts = [self._count([*chosen, i]) for i in range(self._sees.shape[1])]
            best = int(np.argmax(counts))
            if counts[best] == self._count(chosen):
                return chosen
            chosen.append(best)

    def _count(self, views: Sequence[int]) -> int:
        """How many patches are shown, and how many of them from two sides where that is asked for."""
        views = list(views)
        seen, twice = self._sees[:, views].any(axis=1), self._differ[:, views][:, :, views].any(axis=(1, 2))
        return int(seen.sum() + twice.sum())


def _quickest_pair(
    candidates: Float[np.ndarray, "n 6"], sights: Sequence[_Shown], begin: Float[np.ndarray, "6"]
) -> tuple[int, int] | None:
    """The two views, or one of them twice, that show all of it, by the way of the joint that has most of it."""
    show_all = np.all([s.pairs() for s in sights], axis=0)
    if not show_all.any():
        return None
    there = np.abs(candidates - begin).max(axis=1)
    between = np.abs(candidates[:, None] - candidates).max(axis=2)
    first, second = np.unravel_index(np.argmin(np.where(show_all, there[:, None] + between, np.inf)), between.shape)
    return int(first), int(second)


def _in_quick_order(
    candidates: Float[np.ndarray, "n 6"], views: Sequence[int], begin: Float[np.ndarray, "6"]
) -> Sequence[int]:
    if len(views) > MOST_ORDERED:
        return views

    def way(order: Sequence[int]) -> float:
        stops = np.array([begin, *candidates[list(order)]])
        return float(np.abs(np.diff(stops, axis=0)).max(axis=1).sum())

    return min(permutations(views), key=way) if views else views


def _sides(
    camera: CameraRig,
    rig: Rig,
    candidates: Float[np.ndarray, "n 6"],
    patches: Sequence[Float[np.ndarray, "m 3"]],
    obstacles: tuple[Float[np.ndarray, "11"], Sequence[Solid]],
    holding: bool,
) -> Float[np.ndarray, "patches n 2"]:
    """The direction, seen from above, from which each view shows the whole of each patch; nan where it does not."""
    points, owner = np.vstack(patches), np.repeat(np.arange(len(patches)), [len(p) for p in patches])
    clear = ~_hidden(points, *obstacles)
    points, owner = points[clear], owner[clear]
    of_patch = owner == np.arange(len(patches))[:, None]
    middles = np.array([patch[:, :2].mean(axis=0) for patch in patches])
    found = np.full((len(patches), len(candidates), 2), np.nan)
    for i, q in enumerate(candidates):
        flange = rig.arm.world_T_base @ rig.arm.kinematics.forward(q)
        eye, second = (flange @ camera.pose @ np.array([[0, 0, 0, 1], [SECOND_EYE, 0, 0, 1]]).T)[:3].T
        seen = _in_picture(camera, flange, points)
        ways = _ways(eye, points[seen])
        seen[seen] = ~(_hidden(ways, *obstacles) | _in_hand(rig, flange, ways, holding)).any(axis=0)
        for solid in obstacles[1]:
            seen[seen] = ~solid.contains(_ways(second, points[seen])).any(axis=0)
        whole = of_patch.any(axis=1) & ~(of_patch & ~seen).any(axis=1)
        away = eye[:2] - middles[whole]
        found[whole, i] = away / (np.linalg.norm(away, axis=1, keepdims=True) + 1e-9)
    return found


def _ways(eye: Float[np.ndarray, "3"], points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "50 n 3"]:
    """Points along the lines of sight to some points."""
    return np.asarray(eye + np.linspace(0.0, 1.0, 50)[:, None, None] * (points - eye))


def _in_hand(
    rig: Rig, flange: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "*n 3"], holding: bool
) -> Bool[np.ndarray, "*n"]:
    """Which points of the world are inside the hand and what it holds."""
    reach = HELD if holding else FINGERS
    from_flange = np.abs(spatial.apply(spatial.inverse(flange), points.reshape(-1, 3)))
    inside = np.all(from_flange < (*reach[:2], rig.gripper.tip_offset + reach[2]), axis=1)
    return np.asarray(inside).reshape(points.shape[:-1])


def _in_picture(
    camera: CameraRig, flange: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, "n"]:
    x, y, z = spatial.apply(spatial.inverse(flange @ camera.pose), points).T
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    return np.asarray((z > 0) & (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height))


def _in_wall(points: Float[np.ndarray, "*n 3"], box: Float[np.ndarray, "11"]) -> Bool[np.ndarray, "*n"]:
    """Which points of the world are inside the walls of the box."""
    local = np.abs(spatial.apply(spatial.inverse(spatial.pose_from_features(box[:7])), points.reshape(-1, 3)))
    beyond = (local[:, :2] - box[7:9] / 2).max(axis=1)
    return np.asarray((beyond > 0) & (beyond < box[10]) & (local[:, 2] < box[9])).reshape(points.shape[:-1])


def _hidden(
    points: Float[np.ndarray, "*n 3"], box: Float[np.ndarray, "11"], solids: Sequence[Solid]
) -> Bool[np.ndarray, "*n"]:
    """Which points of the world are inside something solid."""
    return np.logical_or.reduce([_in_wall(points, box), *(solid.contains(points) for solid in solids)])
