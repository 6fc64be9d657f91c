"""The process that draws for an emulated lab: whole pictures, and parts of them for less."""

from __future__ import annotations

import json
import time
from typing import Any

import cv2
import numpy as np
import pytest

from resync_robot.core.errors import RenderError, ResyncError
from resync_robot.core.rig import load_rig
from resync_robot.sim_training.emulated_lab.pictures import MAX_WINDOW_PX, Pictures
from resync_robot.sim_training.physics.world import SimWorld
from resync_robot.sim_training.scenes.calibration import Bench, Poster, displaced
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


def test_a_bench_crosses_the_side_door_unchanged() -> None:
    image = np.random.default_rng(0).integers(0, 255, (40, 30)).astype(np.uint8)
    bench = Bench(7, ("b0", "cup"), Poster(image, (0.15, 0.2), "flange", np.eye(4) + 0.25))
    same = Bench.from_json(json.loads(json.dumps(bench.to_json())))
    assert (same.seed, same.names) == (7, ("b0", "cup")) and same.poster is not None
    np.testing.assert_array_equal(same.poster.image, image)
    assert (same.poster.size, same.poster.mount) == ((0.15, 0.2), "flange")
    np.testing.assert_array_equal(same.poster.pose, np.eye(4) + 0.25)
    assert Bench.from_json({"seed": 1, "names": []}) == Bench(1)
    poster = bench.to_json()["poster"]
    for wrong in ({"pose": [1.0]}, {"mount": "wall"}, {"image": "AAAA"}, {"image": 5}, {"size": [1]}):
        with pytest.raises((ValueError, KeyError, TypeError)):
            Bench.from_json({"seed": 1, "names": [], "poster": {**poster, **wrong}})


def test_on_a_bench_the_cameras_stand_off_their_places() -> None:
    pictures, bench = Pictures(RIG), Bench(2, ("b0",))
    try:
        pictures.answer({"scene": {"bench": bench.to_json()}})
    except RenderError as error:
        pytest.skip(f"no Vulkan device: {error.what}")
    head, body = pictures.answer({"camera": "front", "q": RIG.arm.home.tolist(), "opening": 0.1, "objects": {}})
    seen = np.frombuffer(body, np.uint8, head["height"] * head["width"] * 3).reshape(head["height"], -1, 3)
    real = displaced(RIG, 2)
    true, designed = (SimWorld(bench.task(r), r, rendered=True).render("front").colour for r in (real, RIG))
    shift = [np.hypot(*cv2.phaseCorrelate(edges(seen), edges(other))[0]) for other in (true, designed)]
    assert shift[0] < 0.3 and shift[1] > 3.0


def edges(colour: np.ndarray) -> np.ndarray:
    grey = cv2.GaussianBlur(colour.astype(np.float32).mean(axis=2), (5, 5), 0)
    return np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
