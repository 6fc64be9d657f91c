"""What is drawn for an episode: complete, within its ranges, the same for the same seed."""

from __future__ import annotations

import colorsys

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sim_training.randomise import BLOCK_HUES, draw_physics

NAMES = ("b0", "b1", "b2", "b3")


@given(st.integers(0, 2**32 - 1))
def test_draws_are_complete_and_within_range(seed: int) -> None:
    drawn = draw_physics(np.random.default_rng(seed), NAMES)
    assert set(drawn["masses"]) == set(drawn["colours"]) == set(NAMES)
    assert all(0.05 <= m <= 0.16 for m in drawn["masses"].values())
    # A pad presses and drags: it must hold the block better than the floor does.
    assert drawn["friction_pad"] + drawn["friction_block"] > drawn["friction_block"] + drawn["friction_box"] + 0.5
    assert 0.8 <= drawn["gain"] <= 1.2
    colours = [*drawn["colours"].values(), drawn["box_colour"], drawn["table_colour"]]
    assert all(0 <= channel <= 1 for colour in colours for channel in colour)
    assert drawn["light"]["direction"][2] < 0


@given(st.integers(0, 2**32 - 1))
def test_blocks_are_told_apart_by_hue(seed: int) -> None:
    drawn = draw_physics(np.random.default_rng(seed), NAMES)
    hues = {name: colorsys.rgb_to_hsv(*drawn["colours"][name])[0] for name in NAMES}
    for name, hue in hues.items():
        nearest = min(BLOCK_HUES, key=lambda n: min(abs(hue - BLOCK_HUES[n]), 1 - abs(hue - BLOCK_HUES[n])))
        assert nearest == name


def test_the_same_seed_draws_the_same_and_another_does_not() -> None:
    first, again, other = (draw_physics(np.random.default_rng(s), NAMES) for s in (1, 1, 2))
    assert first == again != other
