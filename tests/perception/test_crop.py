from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core.errors import PerceptionError
from resync_robot.core.rig import load_rig
from resync_robot.core.world import CameraFrame, Window
from resync_robot.perception.crop import cut_out

CAMERA = load_rig().camera("front")


def frame(width: int = CAMERA.width, height: int = CAMERA.height) -> CameraFrame:
    colour = np.zeros((height, width, 3), dtype=np.uint8)
    colour[50:60, 100:120] = (200, 10, 30)
    depth = np.zeros((height, width), dtype=np.uint16)
    return CameraFrame("front", colour, depth, CAMERA.intrinsics, np.eye(4), 3.5)


def test_a_window_is_cut_out_and_scaled() -> None:
    found = cut_out(frame(), CAMERA, Window(100.0, 50.0, 20.0, 10.0), 16)
    assert found.colour.shape == (16, 16, 3) and found.name == "front" and found.time == 3.5
    assert (found.colour == (200, 10, 30)).all()


def test_a_window_may_touch_the_edge_of_the_picture() -> None:
    found = cut_out(frame(), CAMERA, Window(CAMERA.width - 30.0, CAMERA.height - 30.0, 30.0, 30.0), 16)
    assert found.colour.shape == (16, 16, 3)


def test_a_picture_of_another_size_is_refused_and_named() -> None:
    with pytest.raises(PerceptionError, match=r"front.*640 x 480.*424 x 240"):
        cut_out(frame(640, 480), CAMERA, Window(0.0, 0.0, 10.0, 10.0), 16)
