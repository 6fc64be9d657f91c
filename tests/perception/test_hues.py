"""The colours of a lab's own things are read off a scan, and what cannot be told is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core.errors import PerceptionError
from resync_robot.core.rig import Rig
from resync_robot.core.world import CameraFrame
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.hues import ALIKE, Hue, apart, find_hues, name_hues
from tests.perception.raycast import GREY, Table

LAB = Catalogue(hues={"cyan": 0.50, "pink": 0.92, "orange": 0.08})
KNOWN = Catalogue()
HUES = st.floats(0.0, 1.0, exclude_max=True)


def look(rig: Rig, *blocks: tuple[str, float, float]) -> list[CameraFrame]:
    table = Table(rig, LAB, box=False)
    for name, x, y in blocks:
        table.block(name, x, y, 0.0, 0.3, 0.055, 0.045)
    return table.scan()


def test_hues_are_read_from_left_to_right(rig: Rig) -> None:
    found = find_hues(look(rig, ("orange", 0.5, 0.0), ("cyan", 0.44, 0.13), ("pink", 0.46, -0.12)), rig, KNOWN)
    for hue, name, place in zip(
        found, ("cyan", "orange", "pink"), ((0.44, 0.13), (0.5, 0.0), (0.46, -0.12)), strict=True
    ):
        assert apart(hue.hue, LAB.hues[name]) < 0.01
        assert hue.spread < 0.02
        np.testing.assert_allclose(hue.place, place, atol=0.01)
    assert name_hues(("b0", "b1", "b2"), found, KNOWN).keys() == {"b0", "b1", "b2"}


def test_an_empty_table(rig: Rig) -> None:
    with pytest.raises(PerceptionError, match="nothing stands on the table"):
        find_hues(look(rig), rig, KNOWN)


def test_two_colours_that_touch_are_no_thing(rig: Rig) -> None:
    frames = look(rig, ("cyan", 0.46, 0.03), ("pink", 0.46, -0.03))
    with pytest.raises(PerceptionError, match="two colours apart"):
        find_hues(frames, rig, KNOWN)


def test_a_grey_thing_has_no_hue(rig: Rig) -> None:
    table = Table(rig, LAB, box=False)
    table._add((0.46, 0.05, 0.02), (0.03, 0.03, 0.02), 0.2, GREY)
    with pytest.raises(PerceptionError, match=r"at \(0.46, 0.05\) m has hardly a colour: 0 % (?s:.*) whiter, light"):
        find_hues(table.scan(), rig, KNOWN)


def of(*hues: float) -> list[Hue]:
    return [Hue(h, 0.01, np.array([0.46, -0.1 * i])) for i, h in enumerate(hues)]


@given(st.lists(HUES, min_size=1, max_size=4))
def test_named_colours_are_one_or_far_enough_apart(hues: list[float]) -> None:
    names = [f"b{i}" for i in range(len(hues))]
    try:
        named = name_hues(names, of(*hues), KNOWN)
    except PerceptionError as error:
        assert "too near" in str(error)
        return
    Catalogue(hues=named)
    for name, hue in zip(names, hues, strict=True):
        assert apart(named[name], hue) <= ALIKE
        assert all(
            apart(named[name], other) > 2 * KNOWN.hue_tolerance for other in named.values() if other != named[name]
        )


def test_red_is_one_colour_on_both_sides_of_zero() -> None:
    named = name_hues(("b0", "b1"), of(0.995, 0.005), KNOWN)
    assert named["b0"] == named["b1"] and apart(named["b0"], 0.0) < 1e-9


def test_as_many_things_as_names() -> None:
    with pytest.raises(PerceptionError, match=r"2 things are seen, .*\(0.46, -0.10\) m; 1 are named: b0"):
        name_hues(("b0",), of(0.1, 0.6), KNOWN)


def test_pictures_of_another_kind_are_refused(rig: Rig) -> None:
    frame = look(rig, ("cyan", 0.46, 0.0))[1]
    for wrong in (
        replace(frame, depth=frame.depth.astype(np.float32) * 1e-4),
        replace(frame, depth=np.zeros_like(frame.depth)),
        replace(frame, colour=frame.colour.astype(np.float32)),
    ):
        with pytest.raises(PerceptionError):
            find_hues([wrong], rig, KNOWN)
