"""Tasks: who stands where, and that nothing is in the way of those that are free."""

import math

import numpy as np
import pytest

from resync_robot.core.errors import ConfigError
from resync_robot.sim_training.domains.icy_transport.floor_plan import room_of
from resync_robot.sim_training.domains.icy_transport.layouts import O1, O2, ROBOT, TARGET, UNSEEN, USUAL, draw, free
from resync_robot.sim_training.domains.icy_transport.simulator import Floor
from resync_robot.sim_training.domains.icy_transport.vocabulary import CAR, ICE, ITEM, MUD


def test_cargo_and_target_lie_in_the_rooms_that_the_car_is_not_in() -> None:
    targets = set()
    for seed in range(30):
        state = draw(np.random.default_rng(seed), seed).initial
        rooms = [room_of(*state[o][:2]) for o in (ROBOT, O1, O2, TARGET)]
        assert rooms[0] == (0, 0) and len(set(rooms)) == 4
        targets.add(rooms[3])
    assert len(targets) == 3


@pytest.mark.parametrize("guarded", [O1, O2, TARGET])
def test_a_region_lies_before_the_doorway_of_what_it_guards(guarded) -> None:  # type: ignore[no-untyped-def]
    for seed in range(10):
        state = draw(np.random.default_rng(seed), seed, mud=guarded.name).initial
        x, y, theta = state[MUD("mud")][:3]
        assert room_of(x, y) != room_of(*state[guarded][:2])
        assert math.dist((x, y), state[guarded][:2]) == pytest.approx(2.1)
        back = state[guarded][:2] + 2.1 * np.array([math.cos(theta), math.sin(theta)])
        np.testing.assert_allclose(back, (x, y))


def test_physics_lies_between_its_edges_and_beyond_them() -> None:
    for name, (low, high) in USUAL.items():
        drawn = [draw(np.random.default_rng(s), s).physics[name] for s in range(20)]
        beyond = [draw(np.random.default_rng(s), s, physics=UNSEEN).physics[name] for s in range(20)]
        assert low <= min(drawn) < max(drawn) <= high < min(beyond)


def test_free_draws_as_many_as_asked() -> None:
    counts = {ITEM: 6, ICE: 2, MUD: 1}
    for seed in range(10):
        task = free(np.random.default_rng(seed), seed, counts)
        assert {kind: len(task.initial.of_type(kind)) for kind in counts} == counts
        assert Floor(task).reset(task.initial)
    assert len(free(np.random.default_rng(0), 0, {}).objects) == 4


def test_more_than_has_room_is_refused() -> None:
    with pytest.raises(ConfigError, match="99 items have no room"):
        free(np.random.default_rng(0), 0, {ITEM: 99})
    with pytest.raises(ConfigError, match="2 cars"):
        free(np.random.default_rng(0), 0, {CAR: 2})
