"""Blocks of one colour keep the names they had; one too many is never guessed away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.perception.blocks import BlockEstimate, Glimpse
from resync_robot.perception.naming import name_blocks
from resync_robot.perception.objects import SceneEstimate
from resync_robot.perception.pose import BoxEstimate

ALIKE = (("b0", "b4"), ("b1",))
NAMES = ("b0", "b1", "b4")
PLACES = {"b0": np.array([0.4, 0.1]), "b1": np.array([0.5, 0.0]), "b4": np.array([0.6, -0.1])}


def estimate(name: str, x: float, y: float) -> BlockEstimate:
    features = np.array([x, y, 0.02, 1, 0, 0, 0, 0.06, 0.06, 0.045])
    return BlockEstimate(name, features, np.eye(10) * 1e-6, 0.045, True, False, 4)


def scene(*blocks: BlockEstimate, surplus: tuple[BlockEstimate, ...] = ()) -> SceneEstimate:
    return SceneEstimate(BoxEstimate(np.zeros(11), np.eye(11)), {b.name: b for b in blocks}, {}, surplus)


@given(st.floats(-0.03, 0.03), st.floats(-0.03, 0.03), st.booleans())
def test_names_follow_the_places_whatever_order_the_scan_gave(dx: float, dy: float, swapped: bool) -> None:
    first, second = ("b4", "b0") if swapped else ("b0", "b4")
    seen = scene(estimate(first, 0.4 + dx, 0.1), estimate(second, 0.6, -0.1 + dy))
    named, ambiguous = name_blocks(seen, ALIKE, NAMES, (), PLACES)
    assert not ambiguous
    assert named.blocks["b0"].features[0] == pytest.approx(0.4 + dx)
    assert named.blocks["b4"].features[1] == pytest.approx(-0.1 + dy)
    assert all(b.name == n for n, b in named.blocks.items())


def test_without_a_memory_all_names_are_handed_out() -> None:
    named, ambiguous = name_blocks(scene(estimate("b0", 0.4, 0), estimate("b4", 0.6, 0)), ALIKE, NAMES, (), {})
    assert set(named.blocks) == {"b0", "b4"} and not ambiguous


def test_one_in_the_hand_is_not_the_one_on_the_table() -> None:
    seen = scene(estimate("b0", 0.6, -0.1))
    named, _ = name_blocks(seen, ALIKE, NAMES, ("b0",), PLACES)
    assert set(named.blocks) == {"b4"}
    both = scene(estimate("b0", 0.4, 0.1), estimate("b4", 0.6, -0.1))
    assert set(name_blocks(both, ALIKE, NAMES, ("b0",), PLACES)[0].blocks) == {"b0", "b4"}


def test_a_block_seen_twice_is_the_one_that_stands_where_it_was() -> None:
    seen = scene(estimate("b1", 0.62, 0.2), surplus=(estimate("b1", 0.503, 0.0),))
    named, ambiguous = name_blocks(seen, ALIKE, NAMES, (), PLACES)
    assert not ambiguous
    assert named.blocks["b1"].features[0] == pytest.approx(0.503)


@pytest.mark.parametrize("places", [{}, {"b1": np.array([0.3, 0.3])}])
def test_a_block_seen_twice_elsewhere_stays_open(places: dict[str, np.ndarray]) -> None:
    seen = scene(estimate("b1", 0.62, 0.2), surplus=(estimate("b1", 0.503, 0.0),))
    named, ambiguous = name_blocks(seen, ALIKE, NAMES, (), places)
    assert "b1" not in named.blocks
    assert sorted(ambiguous["b1"][:, 0]) == pytest.approx([0.503, 0.62])


def test_other_colours_are_left_alone() -> None:
    b1 = estimate("b1", 0.1, 0.1)
    named, _ = name_blocks(scene(b1), ALIKE, NAMES, (), PLACES)
    assert named.blocks == {"b1": b1}


@pytest.mark.parametrize("seen_as", ["b0", "b4"])
@pytest.mark.parametrize("places", [{}, PLACES])
def test_what_is_glimpsed_is_the_one_that_was_not_seen(seen_as: str, places: dict[str, np.ndarray]) -> None:
    other = ({"b0", "b4"} - {seen_as}).pop()
    seen = replace(scene(estimate(seen_as, 0.6, -0.1)), glimpses={other: Glimpse(other, np.array([0.4, 0.1]))})
    named, _ = name_blocks(seen, ALIKE, NAMES, (), places)
    assert len(named.blocks) == len(named.glimpses) == 1
    assert set(named.blocks) | set(named.glimpses) == {"b0", "b4"}
    (glimpse,) = named.glimpses.values()
    assert glimpse.name in named.glimpses and glimpse.centre[0] == 0.4
    if places:
        assert set(named.blocks) == {"b4"}
