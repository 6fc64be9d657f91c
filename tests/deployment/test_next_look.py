"""Few pictures of what the hand may have changed: of blocks, of a lid and what it uncovered, of a drawer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from resync_robot.core.fittings import DRAWER as BUILT
from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.deployment import next_look
from resync_robot.deployment.hand_trace import HandTrace
from resync_robot.deployment.next_look import Chooser, Look, apart
from resync_robot.perception import sights
from resync_robot.perception.objects import catalogue_of
from resync_robot.perception.scan import FURNISHED, Scan
from tests.furnished_scenes import FACE, THE_DRAWER, THE_LID, drawer_features, furnished, in_tray, lid_features
from tests.scenes import B0, B1, BOX_X, THE_BOX

BLOCKS = {"b0": (0.05, 0.0), "b1": (-0.24, -0.42)}
"""One in the box, one on the table to the right of the robot."""
UNCOVERED = furnished(BLOCKS).initial
COVERED = furnished(BLOCKS, lid=lid_features()).initial
LID_AT = tuple(UNCOVERED.get(THE_LID, "x", "y"))
HANDLE = (FACE[0] - BUILT.front[0] - BUILT.reach, FACE[1])


@pytest.fixture(scope="module")
def chooser() -> Chooser:
    rig = load_rig()
    return Chooser(Scan(rig, FURNISHED), rig, catalogue_of(rig, furnished=True))


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is asked to be seen, beside blocks."""
    asked: list[str] = []
    for name in ("of_lid", "of_drawer", "of_box"):
        real = getattr(sights, name)

        def of(*args: object, name: str = name, real=real) -> sights.Sight:
            asked.append(name)
            return real(*args)

        monkeypatch.setattr(next_look.sights, name, of)
    return asked


def trace(*places: tuple[float, float], in_hand: Sequence[Object] = ()) -> HandTrace:
    followed = HandTrace()
    for place in places:
        followed.follow(np.array([*place, 0.05]), in_hand)
    return followed


def look(
    chooser: Chooser,
    followed: HandTrace,
    before: State,
    state: State,
    unseen: Sequence[Object] = (),
    in_hand: Sequence[Object] = (),
) -> Look | None:
    return chooser(followed, before, state, unseen, in_hand, chooser.rig.arm.home)


def test_after_a_lid_was_taken_off_the_lid_and_all_that_it_covered_are_looked_at(
    chooser: Chooser, shown: list[str]
) -> None:
    carried = trace((BOX_X, 0.0), LID_AT, in_hand=[THE_LID])
    found = look(chooser, carried, COVERED, UNCOVERED)
    assert found is not None and {THE_LID, THE_BOX, B0} <= {*found.changed} and THE_DRAWER not in found.changed
    assert shown == ["of_box", "of_lid"]
    assert 3 <= len(found.views) < len(chooser.scan.configurations)


def test_a_block_that_was_never_seen_is_not_looked_for_where_it_was_only_guessed(chooser: Chooser) -> None:
    carried = trace((BOX_X, 0.0), LID_AT, in_hand=[THE_LID])
    found = look(chooser, carried, COVERED, UNCOVERED, unseen=[B0])
    assert found is not None and B0 not in found.changed and THE_BOX in found.changed


def test_a_lid_that_stayed_on_the_box_uncovers_nothing(chooser: Chooser, shown: list[str]) -> None:
    found = look(chooser, trace((BOX_X, 0.0)), COVERED, COVERED, unseen=[B0])
    assert found is not None and found.changed == (THE_LID,) and shown == ["of_lid"]


def test_after_a_skill_of_a_drawer_two_pictures_of_the_drawer_do(chooser: Chooser, shown: list[str]) -> None:
    pulled = trace(*[(HANDLE[0] - s, HANDLE[1]) for s in np.linspace(0, BUILT.travel, 9)])
    found = look(chooser, pulled, UNCOVERED, UNCOVERED)
    assert found is not None and found.changed == (THE_DRAWER,)
    assert shown == ["of_drawer"] and len(found.views) == 2


def test_what_stands_in_a_drawer_goes_with_it_and_is_not_looked_for_where_it_stood(chooser: Chooser) -> None:
    state = in_tray(furnished(BLOCKS, drawer=drawer_features(BUILT.travel)), "b1", "b0").initial
    pushed = trace(*[(HANDLE[0] - BUILT.travel + s, HANDLE[1]) for s in np.linspace(0, BUILT.travel, 9)])
    found = look(chooser, pushed, state, state)
    assert found is not None and {*found.changed} == {B0, B1, THE_DRAWER} and len(found.views) == 2


def test_what_the_hand_put_into_a_drawer_is_looked_at_with_the_drawer(
    chooser: Chooser, shown: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    places: list[np.ndarray] = []
    real = next_look.next_views

    def views(scan, rig, wanted, *args, **rest):
        places.extend(wanted)
        return real(scan, rig, wanted, *args, **rest)

    monkeypatch.setattr(next_look, "next_views", views)
    state = in_tray(furnished(BLOCKS, drawer=drawer_features(BUILT.travel)), "b1", "b0").initial
    there = tuple(state.get(B1, "x", "y"))
    found = look(chooser, trace(there, in_hand=[B1, B0]), UNCOVERED, state)
    assert found is not None and {*found.changed} == {B0, B1, THE_DRAWER}
    assert shown == ["of_drawer"] and len(places) == 1 and places[0] == pytest.approx(there)


def test_far_from_lid_and_drawer_only_blocks_are_looked_at(chooser: Chooser, shown: list[str]) -> None:
    found = look(chooser, trace((BOX_X, 0.0)), UNCOVERED, UNCOVERED)
    assert found is not None and found.changed == (B0,) and not shown and len(found.views) == 2


@pytest.mark.parametrize("dropped", [B1, THE_LID])
def test_what_fell_out_of_the_hand_on_the_way_is_looked_for_everywhere(chooser: Chooser, dropped: Object) -> None:
    """It was carried off, and is not believed to be anywhere that the hand was low."""
    followed = trace((BOX_X, 0.0))
    followed.follow(np.array([BOX_X, 0.0, 0.3]), [dropped])
    assert look(chooser, followed, UNCOVERED, UNCOVERED) is None
    if dropped.type == B1.type:
        assert look(chooser, followed, UNCOVERED, UNCOVERED, in_hand=[dropped]) is not None


def test_with_a_lid_in_the_hand_or_after_no_low_move_everything_is_looked_at(chooser: Chooser) -> None:
    assert look(chooser, trace(LID_AT, in_hand=[THE_LID]), UNCOVERED, UNCOVERED, in_hand=[THE_LID]) is None
    assert look(chooser, HandTrace(), UNCOVERED, UNCOVERED) is None


def test_places_that_one_look_shows_are_named_once() -> None:
    places = [np.array(p) for p in ((0.4, 0.0), (0.43, 0.0), (0.5, 0.0))]
    assert [float(p[0]) for p in apart(places)] == [0.4, 0.5]
