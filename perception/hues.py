"""Which colours a lab's own things have: what stands alone on the table, from left to right, and its hue.

A hue is read over all pictures of a scan, from every side and in its own shade, for light and shade are what a colour
has to be told apart in later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from jaxtyping import Float

from resync_robot.core.errors import PerceptionError
from resync_robot.core.rig import Rig
from resync_robot.core.world import CameraFrame
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.patches import connected
from resync_robot.perception.segment import Segment, as_rgb, vivid
from resync_robot.perception.views import level, make_view

STANDS = 0.012
"""m above the table from which on a point is of a thing, not of what the table shows."""
ALIKE = 0.02
"""Difference of two hues up to which they are one colour: blocks of it are told apart by where they stand."""
LEAST_SATURATED = 0.5
"""Share of a thing's points that have a colour at all."""
MOST = 0.95
"""Share of a thing's points by which its spread is judged; edges take on their neighbour's colour."""


@dataclass(frozen=True)
class Hue:
    """The colour of one thing.

    Attributes:
        hue: in [0, 1), red at 0.
        spread: most of the thing's points are no further from it.
        place: (2,) x and y of the thing in the world, m.
    """

    hue: float
    spread: float
    place: Float[np.ndarray, "2"]


def find_hues(frames: Sequence[CameraFrame], rig: Rig, catalogue: Catalogue) -> list[Hue]:
    """The hues of all that stands on an otherwise empty table, from the robot's left (+y) to its right.

    Raises:
        PerceptionError: nothing stands there, or a thing is grey, or of two colours.
    """
    points = np.concatenate([_coloured_points(frame, rig, catalogue) for frame in frames])
    things = connected(points)
    if not things:
        raise PerceptionError(
            "nothing stands on the table where the scan looks",
            "stand the things on the bare table in front of the robot, 5 cm apart, without the box",
        )
    found = [_hue(thing, catalogue) for thing in things]
    return sorted(found, key=lambda h: -float(h.place[1]))


def name_hues(names: Sequence[str], found: Sequence[Hue], catalogue: Catalogue) -> dict[str, float]:
    """Hues by name; of names whose hues are nearly the same, their mean.

    Args:
        names: of the things from the robot's left to its right.

    Raises:
        PerceptionError: another number of things is seen, or two colours can neither be told apart nor be one.
    """
    if len(found) != len(names):
        places = ", ".join(f"({h.place[0]:.2f}, {h.place[1]:.2f})" for h in found)
        raise PerceptionError(
            f"{len(found)} things are seen, at {places} m; {len(names)} are named: {', '.join(names)}",
            "stand just the named ones there, 5 cm apart, and name them from the robot's left to its right",
        )
    groups: list[list[int]] = []
    for i, hue in enumerate(found):
        near = next((g for g in groups if all(apart(found[j].hue, hue.hue) <= ALIKE for j in g)), None)
        groups.append([i]) if near is None else near.append(i)
    hues = {names[i]: _mean([found[j].hue for j in group]) for group in groups for i in group}
    for a, b in combinations(names, 2):
        between = apart(hues[a], hues[b])
        if 0 < between <= 2 * catalogue.hue_tolerance:
            raise PerceptionError(
                f"the hues of {a} ({hues[a]:.3f}) and {b} ({hues[b]:.3f}) are {between:.3f} apart: too near to be told "
                f"from each other, which takes {2 * catalogue.hue_tolerance:g}, too far to be one colour",
                "take things of other colours, or several of exactly one",
            )
    return hues


def apart(first: float, second: float) -> float:
    """How far two hues are apart on their circle, 0 to 0.5."""
    return float(abs((first - second + 0.5) % 1.0 - 0.5))


class _Nobody:
    def segment(self, frame: CameraFrame) -> list[Segment]:
        return []


def _coloured_points(frame: CameraFrame, rig: Rig, catalogue: Catalogue) -> np.ndarray:
    """(n, 5) of what stands on the table: x, y, z, hue, and whether it has a colour at all."""
    view = level(make_view(frame, _Nobody(), catalogue, rig), catalogue, None)
    hsv = cv2.cvtColor(as_rgb(frame), cv2.COLOR_RGB2HSV_FULL)
    z = view.points[..., 2] - catalogue.table_z
    stands = view.valid & (z > STANDS) & (z < 0.26)
    coloured = vivid(hsv, catalogue)
    return np.column_stack([view.points[stands], hsv[..., 0][stands] / 256, coloured[stands]]).astype(np.float64)


def _hue(thing: np.ndarray, catalogue: Catalogue) -> Hue:
    place = np.median(thing[:, :2], axis=0)
    where = f"what stands at ({place[0]:.2f}, {place[1]:.2f}) m"
    vivid = thing[:, 4] > 0
    if vivid.mean() < LEAST_SATURATED:
        raise PerceptionError(
            f"{where} has hardly a colour: {100 * vivid.mean():.0f} % of it is vivid; needed: "
            f"{100 * LEAST_SATURATED:.0f} %",
            "take away what is grey, or give it more, and whiter, light",
        )
    hues = thing[vivid, 3]
    hue = _mean(hues)
    # Of points that lie together the middle is a better guess than the mean: edges mix with what is beside them.
    hue = float((hue + np.median((hues - hue + 0.5) % 1.0 - 0.5)) % 1.0)
    away = np.abs((hues - hue + 0.5) % 1.0 - 0.5)
    spread = float(np.quantile(away, MOST))
    if spread > catalogue.hue_tolerance:
        raise PerceptionError(
            f"{where} has hues up to {spread:.2f} from {hue:.2f}; within {catalogue.hue_tolerance:g} they must lie",
            "stand things of two colours apart, and take one that is of one colour",
        )
    return Hue(hue, spread, place)


def _mean(hues: Sequence[float] | np.ndarray) -> float:
    angle = 2 * np.pi * np.asarray(hues)
    return float(np.arctan2(np.sin(angle).mean(), np.cos(angle).mean()) / (2 * np.pi) % 1.0)
