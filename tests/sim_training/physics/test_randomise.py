"""What is drawn for an episode: complete, within its ranges, the same for the same seed."""

from __future__ import annotations

import colorsys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.sim_training.physics import textures
from resync_robot.sim_training.physics.randomise import (
    BLOCK_HUES,
    HARD,
    PICTURED,
    PRACTICE,
    UNSEEN,
    USUAL,
    draw_physics,
)

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
    lamps = drawn["light"]["lamps"]
    assert 1 <= len(lamps) <= 3 and all(lamp["direction"][2] < 0 for lamp in lamps)
    assert 1.0 <= drawn["camera"]["gamma"] <= 2.2


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


@given(st.integers(0, 2**32 - 1), st.floats(-1.0, 5.0), st.floats(0.01, 3.0))
def test_usual_draws_lie_between_the_edges_and_unseen_ones_never_do(seed: int, low: float, width: float) -> None:
    low, high = abs(low) + 0.1, abs(low) + 0.1 + width
    assert low <= USUAL.draw(np.random.default_rng(seed), low, high) <= high
    outside = UNSEEN.draw(np.random.default_rng(seed), low, high)
    assert 0.9 * low - 1e-9 <= outside <= low + 1e-9 or high - 1e-9 <= outside <= 1.1 * high + 1e-9


def test_practice_draws_between_the_same_edges_and_near_them_more_often() -> None:
    usual, practice = (
        np.array([r.draw(np.random.default_rng(seed), 2.0, 3.0) for seed in range(400)]) for r in (USUAL, PRACTICE)
    )
    assert practice.min() >= 2.0 and practice.max() <= 3.0
    # One draw each, so that the same seed keeps its order among all.
    np.testing.assert_array_equal(np.argsort(usual), np.argsort(practice))
    near = [np.mean((drawn < 2.1) | (drawn > 2.9)) for drawn in (usual, practice)]
    assert near[0] == pytest.approx(0.2, abs=0.06) and near[1] == pytest.approx(0.41, abs=0.06)


def test_unseen_surfaces_are_of_kinds_that_training_never_draws() -> None:
    kinds = {"usual": set(), "pictured": set(), "unseen": set()}
    for seed in range(60):
        for name, ranges in (("usual", USUAL), ("pictured", PICTURED), ("unseen", UNSEEN)):
            drawn = draw_physics(np.random.default_rng(seed), NAMES, ranges)
            kinds[name] |= {s["kind"] for s in drawn.get("surfaces", {}).values()}
    assert kinds["usual"] == set()
    assert kinds["pictured"] and kinds["unseen"] and not kinds["pictured"] & kinds["unseen"]


def test_light_and_surfaces_leave_the_rest_of_a_world_as_it_is() -> None:
    for seed in range(10):
        plain, hard = (draw_physics(np.random.default_rng(seed), NAMES, r) for r in (USUAL, HARD))
        same = {"friction_pad", "friction_block", "friction_box", "gain", "masses", "colours", "pad_stiffness"}
        assert all(plain[k] == hard[k] for k in same) and plain["light"] != hard["light"]


def test_training_has_worlds_with_and_without_shadows_hard_and_soft_and_hard_light_always_has() -> None:
    texels = {
        name: [draw_physics(np.random.default_rng(s), NAMES, r)["light"]["texels"] for s in range(60)]
        for name, r in (("usual", USUAL), ("hard", HARD))
    }
    assert 15 < texels["usual"].count(0) < 45 and len(set(texels["usual"])) > 3
    assert min(texels["hard"]) > max(texels["usual"])


@pytest.mark.parametrize("kind", [*textures.TRAINED, *textures.UNSEEN])
def test_a_surface_varies_in_brightness_and_keeps_its_hue(kind: str) -> None:
    pixels = textures.surface(kind, 3, 0.4, (0.6, 0.5, 0.4))[..., :3].astype(float)
    assert pixels.std() > 3 and pixels.max() <= 0.6 * 255 + 1
    ratio = pixels[..., 0] / pixels[..., 2]
    assert np.abs(ratio - 1.5).max() < 0.05
