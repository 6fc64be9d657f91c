"""PickTower and PlaceTower: a tower stays one, from the table into the drawer."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core.fittings import DRAWER
from resync_robot.core.skill import SkillEnd
from resync_robot.core.task import Task
from resync_robot.sim_training.domains.cornered_insertion_l.vocabulary import hand_empty, holding_tower, in_drawer
from resync_robot.sim_training.domains.cornered_insertion_s.domain import on
from tests import furnished_scenes as furnished
from tests import scenes
from tests.furnished_scenes import THE_DRAWER
from tests.policies.followers import Follower
from tests.policies.furnished_worlds import build, run
from tests.scenes import B0, B1, B2, R

PLACE, SHIFT = (-0.04, 0.02), 0.001
"""Where the tower stands in the box, and how far a block is off centre: stud and socket leave it 1.5 mm."""


def task_of(count: int) -> Task:
    """A tower of so many blocks in the box, b0 the lowest, and the drawer open."""
    x, y = PLACE
    blocks = {
        f"b{i}": (x + SHIFT * (-1) ** i, y - SHIFT * (i > 0), 0.3, scenes.FLOOR + i * scenes.HEIGHT)
        for i in range(count)
    }
    return furnished.furnished(blocks, drawer=furnished.drawer_features(DRAWER.travel, np.pi - 0.1))


@pytest.mark.parametrize("count", [2, 3])
def test_a_tower_goes_into_the_drawer_whole(count: int) -> None:
    world = build(task_of(count))
    assert run(world, "PickTower", B1, B0).done
    state = world.perceive()
    assert holding_tower(state, (R, B1, B0)) and not hand_empty(state, (R,))
    assert run(world, "PlaceTower", B1, B0, THE_DRAWER).done
    state = world.perceive()
    assert in_drawer(state, (B0, THE_DRAWER)) and not in_drawer(state, (B1, THE_DRAWER)) and on(state, (B1, B0))
    assert hand_empty(state, (R,)) and (count == 2 or on(state, (B2, B1)))
    assert world.settles()


def test_without_a_tower_both_refuse_and_do_not_move() -> None:
    flat = Follower(furnished.furnished({"b0": (0.0, 0.0), "b1": (-0.09, 0.09)}).initial)
    for name, objects in (("PickTower", (B1, B0)), ("PlaceTower", (B1, B0, THE_DRAWER))):
        outcome = run(flat, name, *objects)
        assert outcome.ending is SkillEnd.REFUSED and flat.tips == []
    standing = Follower(task_of(2).initial)
    assert run(standing, "PlaceTower", B1, B0, THE_DRAWER).reason == "b1 on b0 is not in the hand"


def test_a_tower_that_would_meet_the_palm_is_refused() -> None:
    outcome = run(Follower(task_of(4).initial), "PickTower", B1, B0)
    assert outcome.ending is SkillEnd.REFUSED and "too high" in outcome.reason
