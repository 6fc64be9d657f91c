"""Pictures of the rooms for people."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from resync_robot.core.state import State
from resync_robot.sim_training.domains.icy_transport.floor_plan import SIZE, THICKNESS, walls
from resync_robot.sim_training.domains.icy_transport.vocabulary import (
    CAR,
    DELIVERED_WITHIN,
    ICE,
    ITEM,
    REGIONS,
    is_fixed,
)

PIXELS = 500
_EDGE = 10
"""Pixels around the floor, for the outer walls."""
_SCALE = (PIXELS - 2 * _EDGE) / SIZE
_FINE = 4
"""Binary digits of a fraction of a pixel."""
_FLOOR, _WALL, _INK = (246, 244, 240), (84, 88, 96), (50, 50, 50)
_CAR, _NOSE, _CARGO, _TARGET = (52, 96, 168), (150, 190, 240), (214, 96, 64), (96, 160, 88)
_REGION = {ICE.name: (112, 196, 226), "muddy": (150, 104, 58)}
_CROSSED = (222, 218, 212)


def draw(state: State) -> UInt8[np.ndarray, "h w 3"]:
    """(500, 500, 3) from above, y up: ice blue, mud brown, both pale once they are crossed; the target a green ring."""
    image = np.full((PIXELS, PIXELS, 3), _FLOOR, dtype=np.uint8)
    for kind in REGIONS:
        for region in state.of_type(kind):
            x, y, theta, depth, width, active = state[region].tolist()
            _fill(image, _corners(x, y, theta, depth, width), _REGION[kind.name] if active > 0.5 else _CROSSED)
    for edge in range(_EDGE):
        cv2.rectangle(image, (edge, edge), (PIXELS - 1 - edge, PIXELS - 1 - edge), _WALL)
    for x, y, theta, along, across in walls():
        _fill(image, _corners(x, y, theta, 2 * along, max(2 * across, THICKNESS)), _WALL)
    items = state.of_type(ITEM)
    for item in (o for o in items if is_fixed(state, o)):
        x, y = state[item][:2].tolist()
        radius = round(DELIVERED_WITHIN * _SCALE * 2**_FINE)
        cv2.circle(image, _pixel(x, y), radius, _TARGET, 2, cv2.LINE_AA, _FINE)
    for car in state.of_type(CAR):
        x, y, theta, length, width = state[car][:5].tolist()
        _fill(image, _corners(x, y, theta, length, width), _CAR)
        ahead = 0.36 * length
        nose = x + ahead * math.cos(theta), y + ahead * math.sin(theta)
        _fill(image, _corners(*nose, theta, 0.2 * length, 0.8 * width), _NOSE)
    for item in (o for o in items if not is_fixed(state, o)):
        x, y, _, diameter = state[item][:4].tolist()
        cv2.circle(image, _pixel(x, y), round(diameter / 2 * _SCALE * 2**_FINE), _CARGO, -1, cv2.LINE_AA, _FINE)
        _name(image, item.name, x, y)
    return image


def _fill(image: np.ndarray, corners: list[tuple[float, float]], colour: Any) -> None:
    points = np.array([_pixel(x, y) for x, y in corners], dtype=np.int32)
    cv2.fillConvexPoly(image, points, colour, cv2.LINE_AA, _FINE)


def _name(image: np.ndarray, text: str, x: float, y: float) -> None:
    column, row = (value >> _FINE for value in _pixel(x, y))
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.4, 1)
    corner = column - width // 2, row + height // 2
    cv2.putText(image, text, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1, cv2.LINE_AA)


def _corners(x: float, y: float, theta: float, along: float, across: float) -> list[tuple[float, float]]:
    cos, sin = math.cos(theta), math.sin(theta)
    signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    ends = [(a * along / 2, b * across / 2) for a, b in signs]
    return [(x + a * cos - b * sin, y + a * sin + b * cos) for a, b in ends]


def _pixel(x: float, y: float) -> tuple[int, int]:
    """In fractions of a pixel."""
    column, row = _EDGE + x * _SCALE, PIXELS - _EDGE - y * _SCALE
    return round(column * 2**_FINE), round(row * 2**_FINE)
