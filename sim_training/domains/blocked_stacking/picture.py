"""A scene from the side, for people."""

from __future__ import annotations

from collections.abc import Set

import cv2
import numpy as np

from resync_robot.core.state import State
from resync_robot.sim_training.domains.blocked_stacking.body import BASE_RADIUS, Configuration, Polygon, box
from resync_robot.sim_training.domains.blocked_stacking.vocabulary import BENCH, BLOCK, CRATE, SLAB, WALL, WORLD

SCALE = 160.0
"""Pixels a metre."""
SHIFT = 4
"""Bits of a pixel's fraction that are drawn with."""
BACKGROUND, BENCH_TOP, EDGE = (246, 246, 243), (205, 198, 188), (50, 50, 50)
BASE, ARM, FINGERS, HIT = (178, 200, 226), (120, 150, 190), (52, 96, 160), (214, 40, 40)
COLOURS = {BLOCK: (236, 170, 60), SLAB: (120, 90, 160), CRATE: (150, 118, 84), WALL: (110, 120, 110)}


def draw(state: State, robot: Configuration, hit: Set[str]) -> np.ndarray:
    """(320, 724, 3) the scene, x to the right and y up; with a red edge what is run into, by its name."""
    image = np.full((int(WORLD[1] * SCALE), int(WORLD[0] * SCALE), 3), BACKGROUND, dtype=np.uint8)
    _fill(image, [(0, -1), (WORLD[0], -1), (WORLD[0], BENCH), (0, BENCH)], BENCH_TOP)
    _, bar, palm, left, right = robot.parts()
    cv2.circle(image, _pixel(robot.x, robot.y), _length(BASE_RADIUS), BASE, -1, cv2.LINE_AA, SHIFT)
    cv2.circle(image, _pixel(robot.x, robot.y), _length(BASE_RADIUS), EDGE, 1, cv2.LINE_AA, SHIFT)
    _fill(image, bar, ARM)
    for obj in state:
        if obj.type in COLOURS:
            x, y, theta, width, height = map(float, state[obj][:5])
            _fill(image, box(x, y, theta, width, height), COLOURS[obj.type], HIT if obj.name in hit else EDGE)
            if obj.type == BLOCK:
                cv2.putText(image, obj.name, _text_at(x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.42, EDGE, 1, cv2.LINE_AA)
    for part in (palm, left, right):
        _fill(image, part, FINGERS)
    return image


def _fill(image: np.ndarray, polygon: Polygon, colour: tuple[int, int, int], edge: tuple[int, int, int] = EDGE) -> None:
    corners = np.array([[_pixel(x, y) for x, y in polygon]], dtype=np.int32)
    cv2.fillPoly(image, corners, colour, cv2.LINE_AA, SHIFT)
    cv2.polylines(image, corners, True, edge, 2 if edge == HIT else 1, cv2.LINE_AA, SHIFT)


def _length(metres: float) -> int:
    return round(metres * SCALE * 2**SHIFT)


def _pixel(x: float, y: float) -> tuple[int, int]:
    return _length(x), _length(WORLD[1] - y)


def _text_at(x: float, y: float) -> tuple[int, int]:
    return round(x * SCALE) - 8, round((WORLD[1] - y) * SCALE) + 5
