from __future__ import annotations

import colorsys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core.errors import PerceptionError
from resync_robot.core.world import CameraFrame
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.segment import ColourSegmenter

CATALOGUE = Catalogue()
WOOD = (225, 215, 200)


def blank() -> CameraFrame:
    colour = np.tile(np.array(WOOD, np.uint8), (240, 424, 1))
    return CameraFrame("wrist", colour, np.full((240, 424), 5000, np.uint16), np.eye(3), np.eye(4), 0.0)


def paint(colour: np.ndarray, top: int, left: int, hue: float, saturation: float = 0.8, value: float = 0.8) -> None:
    colour[top : top + 40, left : left + 40] = [255 * c for c in colorsys.hsv_to_rgb(hue % 1.0, saturation, value)]


def test_every_colour_of_the_catalogue_is_told_apart() -> None:
    frame = blank()
    for i, hue in enumerate(CATALOGUE.hues.values()):
        paint(frame.colour, 100, 20 + 90 * i, hue)
    segments = ColourSegmenter(CATALOGUE).segment(frame)
    assert sorted(s.label for s in segments) == sorted(CATALOGUE.hues)
    for i, name in enumerate(CATALOGUE.hues):
        mask = next(s.mask for s in segments if s.label == name)
        assert abs(int(mask.sum()) - 1600) < 170
        assert mask[120, 40 + 90 * i]


@settings(max_examples=30, deadline=None)
@given(
    name=st.sampled_from(sorted(CATALOGUE.hues)),
    shift=st.floats(-0.03, 0.03),
    saturation=st.floats(0.5, 1.0),
    value=st.floats(0.3, 1.0),
    gain=st.floats(0.8, 1.1),
)
def test_light_and_paint_may_vary(name: str, shift: float, saturation: float, value: float, gain: float) -> None:
    frame = blank()
    paint(frame.colour, 100, 200, CATALOGUE.hues[name] + shift, saturation, value)
    noise = np.random.default_rng(0).normal(0, 2.5, frame.colour.shape)
    noisy = replace(frame, colour=np.clip(frame.colour * gain + noise, 0, 255).astype(np.uint8))
    assert [s.label for s in ColourSegmenter(CATALOGUE).segment(noisy)] == [name]


@pytest.mark.parametrize("name", sorted(CATALOGUE.hues))
def test_a_strong_colour_is_found_in_a_deep_shadow_and_a_dark_grey_is_nothing(name: str) -> None:
    frame = blank()
    frame.colour[:] = (20, 18, 15)
    paint(frame.colour, 100, 200, CATALOGUE.hues[name], 0.9, 0.085)
    noise = np.random.default_rng(0).normal(0, 1.5, frame.colour.shape)
    noisy = replace(frame, colour=np.clip(frame.colour + noise, 0, 255).astype(np.uint8))
    segments = ColourSegmenter(CATALOGUE).segment(noisy)
    assert [s.label for s in segments] == [name]
    assert segments[0].mask[105:135, 205:235].mean() > 0.95


def test_table_box_and_specks_are_nothing() -> None:
    frame = blank()
    frame.colour[50:150, 50:150] = (90, 95, 100)
    frame.colour[200:203, 200:203] = (220, 30, 30)
    assert ColourSegmenter(CATALOGUE).segment(frame) == []


def test_a_block_in_two_parts_gives_two_segments() -> None:
    frame = blank()
    paint(frame.colour, 100, 100, 0.6)
    paint(frame.colour, 100, 200, 0.6)
    assert [s.label for s in ColourSegmenter(CATALOGUE).segment(frame)] == ["b1", "b1"]


@pytest.mark.parametrize("colour", [np.zeros((240, 424), np.uint8), np.zeros((240, 424, 3), np.float32)])
def test_a_picture_of_another_format_is_refused(colour: np.ndarray) -> None:
    with pytest.raises(PerceptionError, match="RGB8"):
        ColourSegmenter(CATALOGUE).segment(replace(blank(), colour=colour))
