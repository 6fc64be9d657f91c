"""OpenDrawer and CloseDrawer: how far they move it, what they do about blocks in front of it, and what they report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from resync_robot.core.fittings import DRAWER
from resync_robot.core.skill import SkillEnd
from resync_robot.core.state import State
from resync_robot.core.world import ArmObservation
from resync_robot.policies.drawers import DrawerSettings
from resync_robot.policies.scripted import ScriptedSettings
from resync_robot.sim_training.domains.cornered_insertion_l.vocabulary import (
    drawer_closed,
    drawer_open,
    hand_empty,
    in_drawer,
)
from resync_robot.sim_training.domains.cornered_insertion_s.domain import on
from resync_robot.sim_training.physics.world import SimWorld
from tests import furnished_scenes as furnished
from tests import scenes
from tests.furnished_scenes import THE_DRAWER
from tests.policies.followers import Follower
from tests.policies.furnished_worlds import build, run
from tests.scenes import B0, B1, R

BLOCKS = {"b0": (0.0, 0.0), "b1": (-0.06, 0.06)}


def opening(state: State) -> float:
    return float(state.get(THE_DRAWER, "opening")[0])


@pytest.mark.parametrize(("given", "yaw"), [(0.0, np.pi), (0.0, np.pi - 0.15), (0.08, np.pi + 0.15)])
def test_a_drawer_is_pulled_open_from_wherever_it_stands(given: float, yaw: float) -> None:
    world = build(furnished.furnished(BLOCKS, drawer=furnished.drawer_features(given, yaw)))
    assert run(world, "OpenDrawer", THE_DRAWER).done
    assert opening(world.perceive()) > DRAWER.travel - 0.01
    assert drawer_open(world.perceive(), (THE_DRAWER,)) and hand_empty(world.perceive(), (R,))


@pytest.mark.parametrize("yaw", [np.pi, np.pi - 0.15])
def test_a_drawer_is_pushed_closed_and_the_tower_in_it_stands(yaw: float) -> None:
    task = furnished.furnished(BLOCKS, drawer=furnished.drawer_features(DRAWER.travel, yaw))
    world = build(furnished.in_tray(task, "b0", "b1"))
    assert in_drawer(world.perceive(), (B0, THE_DRAWER))
    assert run(world, "CloseDrawer", THE_DRAWER).done
    state = world.perceive()
    assert drawer_closed(state, (THE_DRAWER,)) and in_drawer(state, (B0, THE_DRAWER)) and on(state, (B1, B0))
    assert state.get(R, "z")[0] > DRAWER.cabinet[2], "the hand is out of the way again"


def before_the_front(ahead: float, beside: float, opening: float = 0.0) -> tuple[float, float, float, float]:
    """Of a block, in the frame of the box, so far ahead of the handle."""
    x = furnished.FACE[0] - DRAWER.front[0] - DRAWER.reach - opening - ahead - scenes.BOX_X
    return x, furnished.FACE[1] + beside, 0.0, 0.0


def test_a_block_in_the_way_is_pushed_along_and_the_fingers_keep_from_it() -> None:
    world = build(furnished.furnished({"b0": before_the_front(0.065, 0.0)}))
    before = world.perceive().get(B0, "x")[0]
    assert run(world, "OpenDrawer", THE_DRAWER).done
    state = world.perceive()
    assert drawer_open(state, (THE_DRAWER,)) and before - state.get(B0, "x")[0] > 0.05
    # It stands at the handle now, where the fingers would push.
    assert run(world, "CloseDrawer", THE_DRAWER).done
    assert drawer_closed(world.perceive(), (THE_DRAWER,))
    np.testing.assert_allclose(world.perceive()[B0][:3], state[B0][:3], atol=0.004)


class Stuck(SimWorld):
    """A world whose drawer does not move."""

    def step(self) -> None:
        super().step()
        self.built.drawers[THE_DRAWER].motion = (0.0, 0.0)


def test_a_drawer_that_is_stuck_is_let_go_and_told() -> None:
    world = build(furnished.furnished(BLOCKS), Stuck)
    outcome = run(world, "OpenDrawer", THE_DRAWER)
    assert outcome.ending is SkillEnd.BLOCKED and "pulling drawer" in outcome.reason
    assert drawer_closed(world.perceive(), (THE_DRAWER,)) and hand_empty(world.perceive(), (R,))


class Ajar(SimWorld):
    """A world in which something in the cabinet keeps its drawer 60 mm open."""

    def step(self) -> None:
        super().step()
        drawer = self.built.drawers[THE_DRAWER]
        if drawer.motion[0] < 0.06:
            drawer.motion = (0.06, 0.0)


def test_a_drawer_that_does_not_close_is_left_ajar_and_told_how_far() -> None:
    world = build(furnished.furnished(BLOCKS, drawer=furnished.drawer_features(DRAWER.travel)), Ajar)
    outcome = run(world, "CloseDrawer", THE_DRAWER)
    assert outcome.ending is SkillEnd.BLOCKED and "from closed" in outcome.reason
    assert 0.05 < opening(world.perceive()) < 0.07


class Misled(SimWorld):
    """A world whose observations show the drawer beside where it is."""

    def observe(self, live: bool = False) -> ArmObservation:
        seen = super().observe(live)
        return replace(seen, state=seen.state.with_features(THE_DRAWER, y=seen.state.get(THE_DRAWER, "y")[0] - 0.2))


def test_a_handle_that_is_not_there_is_missed_and_told() -> None:
    outcome = run(build(furnished.furnished(BLOCKS), Misled), "OpenDrawer", THE_DRAWER)
    assert outcome.ending is SkillEnd.BLOCKED and "mm apart" in outcome.reason


def test_nothing_is_pushed_with_something_between_the_pads() -> None:
    task = furnished.furnished(BLOCKS, drawer=furnished.drawer_features(DRAWER.travel))
    outcome = run(Follower(task.initial, between=0.05), "CloseDrawer", THE_DRAWER)
    assert outcome.ending is SkillEnd.REFUSED and "50 mm apart" in outcome.reason


def test_a_drawer_is_moved_slower_than_the_hand_travels() -> None:
    assert DrawerSettings().speed < ScriptedSettings().travel_speed / 2
