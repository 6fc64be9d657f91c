"""Which camera a picture is from: what each must see, and when the pictures say that they were exchanged."""

from __future__ import annotations

import colorsys
from collections.abc import Callable
from itertools import permutations

import cv2
import numpy as np
import pytest

from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.learning.camera_view import VIEWS
from resync_robot.policies.camera_order import SIZE, Foretold, exchanged, foretell, support
from tests import scenes

RIG = load_rig()
HUES = {"b0": 0.0, "b1": 0.6}
CORNERED = scenes.scene({"b0": (scenes.CORNER, scenes.CORNER)}).initial
ORDERS = list(permutations(range(len(VIEWS))))


def told(state: State, hues: dict[str, float] = HUES) -> list[list[Foretold]]:
    cameras = [RIG.camera(view) for view in VIEWS]
    return [foretell(c, RIG.camera_pose(c, RIG.arm.home), state, hues) for c in cameras]


def painted(foretold: list[list[Foretold]], value: float = 0.8, hue: float | None = None) -> np.ndarray:
    """Pictures in which every block is where it is foretold."""
    pictures = np.full((len(foretold), SIZE, SIZE, 3), 60, dtype=np.uint8)
    for picture, of_camera in zip(pictures, foretold, strict=True):
        for f in of_camera:
            colour = tuple(255 * c for c in colorsys.hsv_to_rgb(f.hue if hue is None else hue, 0.8, value))
            cv2.fillConvexPoly(picture, cv2.convexHull(f.pixels.astype(np.int32)), colour)
    return pictures


@pytest.mark.parametrize("value", [0.8, 0.12])
def test_every_exchange_is_found_and_the_right_order_left_alone_in_light_and_shade(value: float) -> None:
    foretold = told(CORNERED)
    pictures = painted(foretold, value)
    assert [exchanged(support(pictures[list(order)], foretold)) for order in ORDERS] == [None, *ORDERS[1:]]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda pictures: np.full_like(pictures, 90),
        lambda pictures: pictures.mean(-1, keepdims=True).repeat(3, -1).astype(np.uint8),
        lambda pictures: np.random.default_rng(0).integers(0, 255, pictures.shape).astype(np.uint8),
        lambda pictures: np.full_like(pictures, (200, 20, 20)),
    ],
    ids=["nothing", "grey", "noise", "all red"],
)
def test_pictures_without_evidence_are_no_exchange(spoil: Callable[[np.ndarray], np.ndarray]) -> None:
    foretold = told(CORNERED)
    assert exchanged(support(spoil(painted(foretold)), foretold)) is None


def test_a_block_that_is_not_where_the_scan_has_it_is_no_exchange() -> None:
    elsewhere = scenes.scene({"b0": (scenes.CORNER - 0.12, scenes.CORNER)}).initial
    assert exchanged(support(painted(told(elsewhere)), told(CORNERED))) is None


def test_blocks_of_other_colours_are_no_evidence() -> None:
    foretold = told(CORNERED)
    order = [1, 0, 2]
    assert exchanged(support(painted(foretold, hue=0.36)[order], foretold)) is None
    assert told(CORNERED, {"b1": 0.6}) == [[], [], []]


def test_light_turns_a_hue_only_so_far() -> None:
    foretold = told(CORNERED)
    pictures = painted(foretold, hue=0.05)
    assert exchanged(support(pictures[[1, 0, 2]], foretold)) == (1, 0, 2)


def test_what_a_wall_or_another_block_hides_is_not_foretold() -> None:
    front = RIG.camera("front")
    low = front.pose.copy()
    low[:3, 3] = 1.0, 0.0, 0.03
    low[:3, :3] = np.array([[0, 0, -1], [1, 0, 0], [0, -1, 0.0]])
    middle = scenes.scene({"b0": (0.0, 0.0)}).initial
    assert foretell(front, front.pose, middle, HUES) and not foretell(front, low, middle, HUES)
    without_walls = middle.with_features(scenes.THE_BOX, wall_z=0.001)
    assert foretell(front, low, without_walls, HUES)
    pair = scenes.scene({"b0": (0.0, 0.0), "b1": (0.08, 0.0)}).initial.with_features(scenes.THE_BOX, wall_z=0.001)
    assert [f.hue for f in foretell(front, low, pair, HUES)] == [0.6]


def test_two_orders_that_explain_alike_are_no_exchange() -> None:
    found = np.array([[0.9, 0.9, 0.0], [0.9, 0.9, 0.0], [0.0, 0.0, 0.9]])
    assert exchanged(found) is None
    # One picture that shows what another camera must see says nothing while the other one shows its own.
    assert exchanged(np.array([[0.0, 0.9, 0.0], [0.0, 0.9, 0.0], [0.0, 0.0, 0.9]])) is None
