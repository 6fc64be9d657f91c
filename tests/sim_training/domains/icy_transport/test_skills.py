"""The given skills: they fetch and bring, stop in what they cannot cross, and refuse what makes no sense."""

import numpy as np
import pytest

from resync_robot.core.skill import SkillEnd, SkillOutcome
from resync_robot.core.task import Task
from resync_robot.planning.skill_run import run_skill
from resync_robot.sim_training.domains.icy_transport.layouts import O1, O2, ROBOT, TARGET, draw
from resync_robot.sim_training.domains.icy_transport.simulator import Floor
from resync_robot.sim_training.domains.icy_transport.skills import caught_in, skills
from resync_robot.sim_training.domains.icy_transport.vocabulary import ICE, delivered

PICK, PLACE = skills()


def drawn(seed: int, **where: str) -> Task:
    return draw(np.random.default_rng(seed), seed, **where)


@pytest.mark.parametrize("seed", range(3))
def test_a_cargo_is_fetched_and_brought(seed: int) -> None:
    floor = Floor(drawn(seed))
    assert run_skill(floor, PICK.ground((ROBOT, O2))).done
    state = floor.perceive()
    assert state.get(O2, "carried")[0] == 1.0 and np.abs(state[ROBOT][5:8]).max() < 0.01
    assert run_skill(floor, PICK.ground((ROBOT, O1))).ending is SkillEnd.REFUSED
    assert run_skill(floor, PLACE.ground((ROBOT, O2, O1))).ending is SkillEnd.REFUSED
    assert run_skill(floor, PLACE.ground((ROBOT, O2, TARGET))).done
    assert delivered(floor.perceive(), (O2, TARGET)) == 1.0
    assert run_skill(floor, PLACE.ground((ROBOT, O2, TARGET))).ending is SkillEnd.REFUSED


def test_it_stops_where_it_is_caught_and_names_it() -> None:
    floor = Floor(drawn(0, ice="o1"))
    outcome = run_skill(floor, PICK.ground((ROBOT, O1)))
    assert outcome == SkillOutcome(SkillEnd.BLOCKED, "the car is caught in ice")
    assert dict(floor.contacts()) == {ICE("ice"): 1.0}
    assert floor.perceive().get(ROBOT, "forward")[0] > 1.0, "it hits the ice at speed"
    assert run_skill(floor, PICK.ground((ROBOT, O1))).ending is SkillEnd.BLOCKED


def test_what_catches_it_is_what_the_simulator_says() -> None:
    floor = Floor(drawn(2, ice="o1"))
    seen = set()
    for _ in range(150):
        floor.act(np.array([1.0, 0.0, 0.0]), 0.02)
        caught = caught_in(floor.perceive(), ROBOT)
        assert ([] if caught is None else [caught]) == list(floor.contacts())
        seen.add(caught)
    given = drawn(2, ice="o1").initial
    ice = ICE("ice")
    x, y = given.get(ice, "x", "y")
    assert caught_in(given.with_features(ROBOT, x=x, y=y), ROBOT) == ice
    assert caught_in(given.with_features(ROBOT, x=x, y=y).with_features(ice, active=0.0), ROBOT) is None


def test_nothing_is_to_be_fetched_from_the_target() -> None:
    """It is driven to all the same: what is learned about the way there begins like that."""
    floor = Floor(drawn(1))
    outcome = run_skill(floor, PICK.ground((ROBOT, TARGET)))
    assert outcome.ending is SkillEnd.BLOCKED
    np.testing.assert_allclose(floor.perceive()[ROBOT][:2], floor.perceive()[TARGET][:2], atol=0.05)
