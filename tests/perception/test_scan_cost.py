"""What five pictures of 848 x 480 cost: time of one core, and memory above the process."""

from __future__ import annotations

import time
import tracemalloc
from dataclasses import replace

import pytest

from resync_robot.core.rig import Rig
from resync_robot.core.world import CameraFrame
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.objects import SceneEstimator
from tests.perception.raycast import FLOOR, Table


@pytest.fixture(scope="module")
def scan(rig: Rig) -> tuple[SceneEstimator, list[CameraFrame]]:
    large = replace(
        rig,
        cameras=tuple(
            replace(c, width=848, height=480, fx=2 * c.fx, fy=2 * c.fy, cx=2 * c.cx + 0.5, cy=2 * c.cy + 0.5)
            for c in rig.cameras
        ),
    )
    table = Table(large, Catalogue())
    for i, (name, x, y) in enumerate(
        (("b0", 0.40, 0.06), ("b1", 0.55, -0.06), ("b2", 0.45, 0.30), ("b3", 0.45, -0.30))
    ):
        table.block(name, x, y, FLOOR if i < 2 else 0.0, 0.1 * i, 0.060, 0.045)
    return SceneEstimator(large), table.scan()[:5]


def test_memory_stays_far_below_a_gibibyte(scan: tuple[SceneEstimator, list[CameraFrame]]) -> None:
    estimator, frames = scan
    tracemalloc.start()
    found = estimator.estimate(frames)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert set(found.blocks) == {"b0", "b1", "b2", "b3"}
    assert peak < 2**28


@pytest.mark.realtime
def test_computing_takes_less_than_a_second_of_one_core(scan: tuple[SceneEstimator, list[CameraFrame]]) -> None:
    estimator, frames = scan
    estimator.estimate(frames)
    spent = []
    for _ in range(3):
        begun = time.process_time()
        estimator.estimate(frames)
        spent.append(time.process_time() - begun)
    assert min(spent) < 1.0
