"""The process that draws for an emulated lab: whole pictures, and parts of them for less."""

from __future__ import annotations

import time
from typing import Any

import cv2
import numpy as np
import pytest

from resync_robot.core.errors import RenderError, ResyncError
from resync_robot.core.rig import load_rig
from sim_training.lab_pictures import MAX_WINDOW_PX, Pictures
from tests.emulators import RIG_FILE

RIG = load_rig(RIG_FILE)
SCENE = {"scene": {"domain": "cornered-insertion-s", "scenario": "s1", "seed": 0, "episode": 0}}
SIDES = (225, 55, 64, 64)
"""Around a block in a corner of the box, as the front camera sees them."""


def test_without_a_scene_there_are_no_pictures() -> None:
    with pytest.raises(ResyncError, match="no scene"):
        Pictures(RIG).answer({"camera": "wrist"})


@pytest.mark.slow
def test_a_window_shows_what_lies_there_in_the_whole_picture() -> None:
    pictures = Pictures(RIG)
    try:
        pictures.answer(SCENE)
    except RenderError as error:
        pytest.skip(f"no Vulkan device: {error.what}")
    pose: dict[str, Any] = {"camera": "front", "q": RIG.arm.home.tolist(), "opening": 0.1, "objects": {}}
    head, body = pictures.answer(pose)
    count = head["height"] * head["width"] * 3
    whole = np.frombuffer(body, np.uint8, count).reshape(head["height"], head["width"], 3)
    begin = time.perf_counter()
    head, body = pictures.answer({**pose, "window": SIDES, "size": 64})
    part = np.frombuffer(body, np.uint8).reshape(64, 64, 3)
    assert (head["height"], head["width"]) == (64, 64)
    assert time.perf_counter() - begin < 5.0
    left, top, width, height = SIDES
    cut = whole[top : top + height, left : left + width]
    # Exposure and noise are drawn anew; what is seen is the same.
    one, other = (cv2.GaussianBlur(x.astype(np.float32).mean(axis=2), (5, 5), 0).ravel() for x in (cut, part))
    assert np.corrcoef(one, other)[0, 1] > 0.95
    with pytest.raises(ResyncError, match=f"1 to {MAX_WINDOW_PX}"):
        pictures.answer({**pose, "window": SIDES, "size": 5000})
