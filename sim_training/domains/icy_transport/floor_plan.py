"""The four rooms: where their walls and doorways are, what overlaps what, and the way from one room to another.

Metres; x to the right, y up. The bottom left room (0, 0) has doorways to the right and up, the bottom right one (1, 0)
one more up; the two upper rooms are not joined.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

Point = tuple[float, float]
Room = tuple[int, int]
"""Column and row."""
Box = tuple[float, float, float, float, float]
"""x, y, theta, and half its extents along its own axes."""

SIZE, THICKNESS = 5.0, 0.1
"""Of the whole floor, and of the walls."""
_MIDDLE, _HALF = SIZE / 2, THICKNESS / 2
_GAPS_RIGHT, _GAPS_UP = ((0.85, 1.65),), ((0.85, 1.65), (3.35, 4.15))
"""Doorways in the wall between left and right rooms, along y, and in that between lower and upper ones, along x."""

_CHAIN: tuple[Room, ...] = ((0, 1), (0, 0), (1, 0), (1, 1))
"""The rooms in the order in which their doorways join them."""
_BEYOND, _KEEP_RIGHT = 0.12, 0.05
"""Where a car drives through a doorway: behind the wall, and to the right of the middle."""


def room_of(x: float, y: float) -> Room:
    return int(x > _MIDDLE), int(y > _MIDDLE)


def centre(room: Room) -> Point:
    return SIZE / 4 + room[0] * _MIDDLE, SIZE / 4 + room[1] * _MIDDLE


def way(start: Room, goal: Room) -> list[Point]:
    """Where to drive from the middle of one room to that of another: through each doorway, and to each middle."""
    begin, end = _CHAIN.index(start), _CHAIN.index(goal)
    rooms = _CHAIN[begin : end + 1] if begin <= end else _CHAIN[end : begin + 1][::-1]
    points: list[Point] = []
    for here, there in pairwise(rooms):
        (x0, y0), (x1, y1) = centre(here), centre(there)
        # A unit step in the direction of travel, and its right-hand side.
        dx, dy = (x1 - x0) / _MIDDLE, (y1 - y0) / _MIDDLE
        x = (x0 + x1) / 2 + _BEYOND * dx + _KEEP_RIGHT * dy
        y = (y0 + y1) / 2 + _BEYOND * dy - _KEEP_RIGHT * dx
        points += [(x, y), (x1, y1)]
    return points


def hits_wall(box: Box) -> bool:
    """Whether any of it is in a wall, or outside."""
    x, y, theta, along, across = box
    cos, sin = abs(math.cos(theta)), abs(math.sin(theta))
    reach_x, reach_y = along * cos + across * sin, along * sin + across * cos
    if x < reach_x or y < reach_y or x > SIZE - reach_x or y > SIZE - reach_y:
        return True
    if abs(x - _MIDDLE) >= reach_x + _HALF and abs(y - _MIDDLE) >= reach_y + _HALF:
        return False
    return any(overlap(box, wall) for wall in _WALLS)


def overlap(a: Box, b: Box) -> bool:
    """Whether two boxes have a point in common: no axis of either separates them."""
    dx, dy, turn = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    if dx * dx + dy * dy > (math.hypot(a[3], a[4]) + math.hypot(b[3], b[4])) ** 2:
        return False
    cos, sin = abs(math.cos(turn)), abs(math.sin(turn))
    for one, other in ((a, b), (b, a)):
        c, s = math.cos(one[2]), math.sin(one[2])
        if abs(dx * c + dy * s) > one[3] + other[3] * cos + other[4] * sin:
            return False
        if abs(dy * c - dx * s) > one[4] + other[3] * sin + other[4] * cos:
            return False
    return True


def gap(box: Box, x: float, y: float) -> float:
    """From a box to a point, m; 0 inside."""
    dx, dy, c, s = x - box[0], y - box[1], math.cos(box[2]), math.sin(box[2])
    along, across = abs(dx * c + dy * s) - box[3], abs(dy * c - dx * s) - box[4]
    return math.hypot(max(along, 0.0), max(across, 0.0))


def walls() -> tuple[Box, ...]:
    """Those between the rooms."""
    return _WALLS


def _pieces(gaps: tuple[Point, ...]) -> Iterator[Point]:
    """What doorways leave of a wall: middle and half the length of each piece."""
    begin = 0.0
    for low, high in (*gaps, (SIZE, SIZE)):
        yield (begin + low) / 2, (low - begin) / 2
        begin = high


_WALLS: tuple[Box, ...] = (
    *((_MIDDLE, middle, 0.0, _HALF, half) for middle, half in _pieces(_GAPS_RIGHT)),
    *((middle, _MIDDLE, 0.0, half, _HALF) for middle, half in _pieces(_GAPS_UP)),
)
