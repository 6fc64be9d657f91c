"""The robot's shape: a round base, an arm that telescopes, and a hand with two fingers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from resync_robot.sim_training.domains.blocked_stacking.vocabulary import WORLD

Point = tuple[float, float]
Polygon = Sequence[Point]
"""Corners of a convex one, anticlockwise."""
Bounds = tuple[float, float, float, float]
"""Least x and y, and greatest."""

BASE_RADIUS = 0.24
PALM = (0.06, 0.32)
"""Along the arm and across it, m."""
BAR = (0.48, 0.06)
BAR_BEHIND = 0.27
"""m from the middle of the palm back to that of the bar that carries it."""
FINGER = (0.20, 0.06)
FINGER_AHEAD = 0.10
HAND = PALM[0] / 2 + FINGER_AHEAD + FINGER[0] / 2
"""Length of the hand from the back of its palm to its tips, m."""
MIDDLE = HAND / 2 - PALM[0] / 2
"""m from the middle of the palm to that of the hand."""
ARM, GAP = (0.24, 0.48), (0.12, 0.32)
"""Least and greatest distance from the base to the palm, and between the middles of the fingers, m."""

LIMITS = {"dx": 0.05, "dy": 0.05, "dtheta": math.pi / 16, "darm": 0.1, "dgap": 0.02}
"""Most that an action changes, m and rad."""


@dataclass(slots=True)
class Configuration:
    """Where the base is, how the arm points (rad), how far out the palm is, and the gap between the fingers, m."""

    x: float
    y: float
    theta: float
    arm: float
    gap: float

    @staticmethod
    def of(features: np.ndarray) -> Configuration:
        """From the features of a robot in a state."""
        x, y, theta, _, spread, reach = features.tolist()
        gap, arm = spread - FINGER[1], reach - MIDDLE
        return Configuration(x - reach * math.cos(theta), y - reach * math.sin(theta), theta, arm, gap)

    def values(self) -> tuple[float, float, float, float, float]:
        """In the order of an action's components."""
        return self.x, self.y, self.theta, self.arm, self.gap

    def features(self) -> np.ndarray:
        """(6,) as a state has them."""
        x, y = self.at(self.arm + MIDDLE)
        return np.array([x, y, self.theta, HAND, self.gap + FINGER[1], self.arm + MIDDLE])

    def at(self, ahead: float, aside: float = 0.0) -> Point:
        """The point so far ahead of the base along the arm, and aside to its left."""
        cos, sin = math.cos(self.theta), math.sin(self.theta)
        return self.x + ahead * cos - aside * sin, self.y + ahead * sin + aside * cos

    def local(self, point: Point) -> Point:
        """The inverse of `at`."""
        cos, sin, dx, dy = math.cos(self.theta), math.sin(self.theta), point[0] - self.x, point[1] - self.y
        return dx * cos + dy * sin, dy * cos - dx * sin

    def moved(self, step: Sequence[float], share: float = 1.0) -> Configuration:
        """A step onwards (dx, dy, dtheta, darm, dgap), within what the robot can."""
        dx, dy, dtheta, darm, dgap = step
        return Configuration(
            min(max(self.x + share * dx, BASE_RADIUS), WORLD[0] - BASE_RADIUS),
            min(max(self.y + share * dy, BASE_RADIUS), WORLD[1] - BASE_RADIUS),
            (self.theta + share * dtheta + math.pi) % (2 * math.pi) - math.pi,
            min(max(self.arm + share * darm, ARM[0]), ARM[1]),
            min(max(self.gap + share * dgap, GAP[0]), GAP[1]),
        )

    def parts(self) -> tuple[Polygon, ...]:
        """Its outline: base (a polygon around it), bar, palm, left and right finger."""
        round_base = [(self.x + BASE_RADIUS * math.cos(a), self.y + BASE_RADIUS * math.sin(a)) for a in _AROUND]
        across = self.gap / 2
        return (
            round_base,
            box(*self.at(self.arm - BAR_BEHIND), self.theta, *BAR),
            box(*self.at(self.arm), self.theta, *PALM),
            box(*self.at(self.arm + FINGER_AHEAD, across), self.theta, *FINGER),
            box(*self.at(self.arm + FINGER_AHEAD, -across), self.theta, *FINGER),
        )

    def middles(self) -> tuple[Point, Point, Point, Point]:
        """Where base, palm, left and right finger are."""
        cos, sin = math.cos(self.theta), math.sin(self.theta)
        far, aside = self.arm + FINGER_AHEAD, self.gap / 2
        x, y = self.x + far * cos, self.y + far * sin
        return (
            (self.x, self.y),
            (self.x + self.arm * cos, self.y + self.arm * sin),
            (x - aside * sin, y + aside * cos),
            (x + aside * sin, y - aside * cos),
        )

    def bounds(self) -> tuple[Bounds, Bounds, Bounds, Bounds]:
        """Around base, palm with its bar, left and right finger."""
        cos, sin = math.cos(self.theta), math.sin(self.theta)
        base, palm, left, right = self.middles()
        bar = palm[0] - BAR_BEHIND * cos, palm[1] - BAR_BEHIND * sin
        carries = bounds(*palm, self.theta, *PALM), bounds(*bar, self.theta, *BAR)
        return (
            (base[0] - BASE_RADIUS, base[1] - BASE_RADIUS, base[0] + BASE_RADIUS, base[1] + BASE_RADIUS),
            together(*carries),
            bounds(*left, self.theta, *FINGER),
            bounds(*right, self.theta, *FINGER),
        )


_AROUND = [2 * math.pi * i / 16 for i in range(16)]


def box(x: float, y: float, theta: float, width: float, height: float) -> list[Point]:
    """The corners of a rectangle."""
    cos, sin, w, h = math.cos(theta), math.sin(theta), width / 2, height / 2
    corners = ((-w, -h), (w, -h), (w, h), (-w, h))
    return [(x + a * cos - b * sin, y + a * sin + b * cos) for a, b in corners]


def bounds(x: float, y: float, theta: float, width: float, height: float) -> Bounds:
    """Around a rectangle."""
    cos, sin = abs(math.cos(theta)), abs(math.sin(theta))
    w, h = (width * cos + height * sin) / 2, (width * sin + height * cos) / 2
    return x - w, y - h, x + w, y + h


def together(a: Bounds, b: Bounds) -> Bounds:
    """Around both."""
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])


def overlap(a: Polygon, b: Polygon) -> float:
    """By how much two convex polygons overlap along the direction in which they do least, m; 0 or less: not at all."""
    for axis in (0, 1):
        of_a, of_b = [p[axis] for p in a], [p[axis] for p in b]
        if max(of_a) <= min(of_b) or max(of_b) <= min(of_a):
            return 0.0
    least = math.inf
    for polygon in (a, b):
        x0, y0 = polygon[-1]
        for x1, y1 in polygon:
            nx, ny = y1 - y0, x0 - x1
            length = math.hypot(nx, ny)
            nx, ny, x0, y0 = nx / length, ny / length, x1, y1
            along_a, along_b = [nx * x + ny * y for x, y in a], [nx * x + ny * y for x, y in b]
            least = min(least, max(along_a) - min(along_b), max(along_b) - min(along_a))
            if least <= 0:
                return least
    return least
