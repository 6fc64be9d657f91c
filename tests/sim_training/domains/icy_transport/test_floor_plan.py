"""The rooms: what is in a wall, what overlaps what, and ways that keep clear of both."""

import math
from itertools import pairwise, product

import numpy as np
import pytest

from resync_robot.sim_training.domains.icy_transport.floor_plan import (
    centre,
    gap,
    hits_wall,
    overlap,
    room_of,
    walls,
    way,
)

ROOMS = tuple(product((0, 1), (0, 1)))


@pytest.mark.parametrize(
    ("x", "y", "theta", "hit"),
    [
        (1.25, 1.25, 0.3, False),
        (2.5, 1.25, 0.0, False),
        (2.5, 1.25, math.pi / 2, False),
        (2.5, 1.52, 0.0, True),
        (1.25, 2.5, math.pi / 2, False),
        (2.5, 3.75, 0.0, True),
        (2.0, 3.75, 0.0, False),
        (0.2, 1.25, 0.0, True),
        (0.2, 1.25, math.pi / 2, False),
        (-1.0, 1.25, 0.0, True),
    ],
)
def test_a_car_is_in_a_wall_or_not(x: float, y: float, theta: float, hit: bool) -> None:
    assert hits_wall((x, y, theta, 0.25, 0.15)) is hit


def test_overlap_agrees_with_points_of_both_boxes() -> None:
    """Whatever has a point in common overlaps, and what overlaps by more than a little has one."""
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21)), -1).reshape(-1, 2)
    seen = set()
    for _ in range(100):
        a = (*rng.uniform(-0.4, 0.4, 2), rng.uniform(-3, 3), 0.25, 0.15)
        b = (*rng.uniform(-0.4, 0.4, 2), rng.uniform(-3, 3), 0.05, 0.4)
        cos, sin = math.cos(a[2]), math.sin(a[2])
        points = grid * [a[3], a[4]] @ np.array([[cos, sin], [-sin, cos]]) + a[:2]
        nearest = min(gap(b, x, y) for x, y in points)
        assert overlap(a, b) is overlap(b, a)
        assert overlap(a, b) or nearest > 0
        assert not overlap(a, b) or nearest < 0.03
        seen.add(overlap(a, b))
    assert seen == {True, False}


def test_ways_lead_through_doorways_and_keep_right() -> None:
    for start, goal in product(ROOMS, ROOMS):
        points = [centre(start), *way(start, goal)]
        assert points[-1] == centre(goal) and all(room_of(*p) in ROOMS for p in points)
        for (x0, y0), (x1, y1) in pairwise(points):
            theta = math.atan2(y1 - y0, x1 - x0)
            for share in np.linspace(0, 1, 50):
                box = (x0 + share * (x1 - x0), y0 + share * (y1 - y0), theta, 0.25, 0.15)
                assert not hits_wall(box), (start, goal, box)
    assert way((0, 0), (1, 0))[0] == pytest.approx((2.62, 1.20))
    assert way((1, 0), (0, 0))[0] == pytest.approx((2.38, 1.30))
    assert way((0, 0), (0, 1))[0] == pytest.approx((1.30, 2.62))
    assert len(way((0, 1), (1, 1))) == 6


def test_walls_leave_three_doorways() -> None:
    assert len(walls()) == 5
    for x, y in ((2.5, 1.25), (1.25, 2.5), (3.75, 2.5)):
        assert min(gap(wall, x, y) for wall in walls()) == pytest.approx(0.4)
    assert min(gap(wall, 2.5, 3.75) for wall in walls()) == 0
