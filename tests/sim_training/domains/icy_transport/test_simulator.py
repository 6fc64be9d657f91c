"""The car's physics, and what the simulator promises to learning."""

import math

import numpy as np
import pytest

from resync_robot.core.state import State
from resync_robot.core.task import Task
from resync_robot.sim_training.domains.icy_transport.layouts import O1, O2, ROBOT, TARGET, draw
from resync_robot.sim_training.domains.icy_transport.simulator import Floor
from resync_robot.sim_training.domains.icy_transport.vocabulary import ICE, MUD

PHYSICS = {"mass": 0.5, "push": 0.8, "hold_back": 1.5}
AHEAD, NOTHING = np.array([2.0, 0.0, 0.0]), np.zeros(3)


def task(**car: float) -> Task:
    """The car in the middle of its room, cargo and target in the others; ice before the doorway on the right."""
    state = State(
        {
            ROBOT: np.array([1.25, 1.25, 0.0, 0.5, 0.3, 0.0, 0.0, 0.0]),
            O1: np.array([4.4, 1.25, math.pi, 0.2, 0.0, 0.0]),
            O2: np.array([3.75, 4.4, -math.pi / 2, 0.2, 0.0, 0.0]),
            TARGET: np.array([1.25, 4.4, -math.pi / 2, 0.2, 1.0, 0.0]),
            ICE("ice"): np.array([2.3, 1.25, math.pi, 0.1, 0.8, 1.0]),
        }
    ).with_features(ROBOT, **car)
    return Task(state.objects, state, frozenset(), PHYSICS, 0)


def driven(floor: Floor, action: np.ndarray, steps: int) -> Floor:
    for _ in range(steps):
        floor.act(action, 0.02)
    return floor


def test_it_gains_speed_and_loses_a_tenth_a_second() -> None:
    floor = driven(Floor(task()), AHEAD, 10)
    forward = floor.perceive().get(ROBOT, "forward")[0]
    assert forward == pytest.approx(4.0 * 0.02 * sum(0.955**i for i in range(10)), rel=1e-3)
    rolling = driven(Floor(task(forward=1.0, sideways=0.5, turning=0.2)), NOTHING, 50).perceive()
    assert rolling.get(ROBOT, "turning")[0] == pytest.approx(0.02)
    assert np.hypot(*rolling.get(ROBOT, "forward", "sideways")) == pytest.approx(0.1 * math.hypot(1.0, 0.5))


def test_speeds_are_along_the_car_and_the_time_passes() -> None:
    floor = Floor(task(theta=math.pi / 2, forward=1.0))
    floor.act(NOTHING, 0.02)
    x, y = floor.perceive().get(ROBOT, "x", "y")
    assert x == pytest.approx(1.25) and y > 1.26 and floor.observe().time == pytest.approx(0.02)


@pytest.mark.parametrize("steer", [1.0, -1.0])
def test_it_steers(steer: float) -> None:
    floor = driven(Floor(task()), np.array([0.0, 0.0, steer]), 10)
    assert floor.perceive().get(ROBOT, "theta")[0] * steer > 0.1


def test_actions_beyond_their_limits_count_as_the_limits() -> None:
    a, b = driven(Floor(task()), 9 * AHEAD, 20), driven(Floor(task()), AHEAD, 20)
    assert a.perceive() == b.perceive()


def test_a_wall_stops_it() -> None:
    floor = driven(Floor(task(theta=math.pi, x=0.5)), AHEAD, 100)
    x, forward = floor.perceive().get(ROBOT, "x", "forward")
    assert 0.25 <= x < 0.30 and forward < 0.2


@pytest.mark.parametrize(("kind", "side"), [(ICE, -1.0), (MUD, 1.0)])
def test_ice_takes_it_to_the_right_and_mud_to_the_left(kind, side: float) -> None:  # type: ignore[no-untyped-def]
    given = task(x=2.2)
    features = {o: given.initial[o] for o in given.initial if o.type is not ICE}
    region = kind("region")
    state = State({**features, region: np.array([2.3, 1.25, math.pi, 0.1, 0.8, 1.0])})
    floor = Floor(Task(state.objects, state, frozenset(), PHYSICS, 0))
    assert dict(floor.contacts()) == {region: 1.0}
    driven(floor, NOTHING, 5)
    assert floor.perceive().get(ROBOT, "sideways")[0] * side > 0.05
    floor.reset(state.with_features(region, active=0.0))
    driven(floor, NOTHING, 5)
    assert floor.perceive().get(ROBOT, "sideways")[0] == 0 and not floor.contacts()


def test_it_holds_a_loaded_car_back() -> None:
    speeds = []
    for carried in (0.0, 1.0):
        given = task(x=2.2).initial.with_features(O1, carried=carried)
        given = given.with_features(O1, x=2.2, y=1.25) if carried else given
        floor = Floor(task())
        assert floor.reset(given)
        driven(floor, NOTHING, 5)
        speeds.append(floor.perceive().get(ROBOT, "forward")[0])
    assert speeds[0] == 0 and speeds[1] < -0.1


def test_a_region_is_off_once_it_is_crossed_and_not_before() -> None:
    ice = ICE("ice")
    floor = driven(Floor(task(x=2.1, forward=1.0)), -AHEAD, 60)
    assert not floor.contacts() and floor.perceive().get(ice, "active")[0] == 1.0, "it backed out"
    floor = Floor(task(x=2.1, forward=1.5))
    against = np.array([2.0, 0.8, 0.0])
    for _ in range(40):
        floor.act(against, 0.02)
        behind = floor.perceive().get(ROBOT, "x")[0] - 0.25 > 2.35
        if not behind:
            assert floor.perceive().get(ice, "active")[0] == 1.0
    assert behind and floor.perceive().get(ice, "active")[0] == 0.0


def test_cargo_is_loaded_where_the_car_touches_it_and_unloaded_over_the_target() -> None:
    floor = driven(Floor(task(x=3.9, forward=0.5)), AHEAD, 10)
    state = floor.perceive()
    assert state.get(O1, "carried")[0] == 1.0
    np.testing.assert_array_equal(state[O1][:2], state[ROBOT][:2])
    near = state.with_features(ROBOT, x=1.25, y=4.2, theta=math.pi / 2, forward=1.0).with_features(O1, x=1.25, y=4.2)
    assert floor.reset(near)
    driven(floor, NOTHING, 30)
    state = floor.perceive()
    assert state.get(O1, "carried")[0] == 0.0
    assert 0.05 < math.dist(state[O1][:2], state[TARGET][:2]) <= 0.1, "it stays where the car let it go"


def test_one_cargo_at_a_time() -> None:
    carrying = task(x=4.1, forward=0.5).initial.with_features(O2, x=4.1, y=1.25, carried=1.0)
    floor = Floor(task())
    assert floor.reset(carrying)
    driven(floor, NOTHING, 10)
    assert [floor.perceive().get(o, "carried")[0] for o in (O1, O2)] == [0.0, 1.0]


@pytest.mark.parametrize(
    ("obj", "values"),
    [
        (ROBOT, {"x": 0.1}),
        (ROBOT, {"x": 2.5, "y": 1.6}),
        (ROBOT, {"x": 4.2}),
        (O1, {"x": 2.5, "y": 3.0}),
        (O1, {"x": 6.0}),
        (O1, {"carried": 1.0}),
        (TARGET, {"carried": 1.0}),
        (TARGET, {"y": -1.0}),
        (ICE("ice"), {"x": 5.5}),
    ],
    ids=lambda v: str(v),
)
def test_what_cannot_stand_is_refused(obj, values: dict[str, float]) -> None:  # type: ignore[no-untyped-def]
    given = task()
    floor = Floor(given)
    assert floor.reset(given.initial)
    assert not floor.reset(given.initial.with_features(obj, **values))


def test_a_state_is_put_back_as_it_was_wherever_it_came_from() -> None:
    """Speeds included: a failure is replayed from its state alone."""
    given = draw(np.random.default_rng(3), 3, ice="o1")
    floor = driven(Floor(given), np.array([1.5, 0.4, 0.3]), 30)
    state, kept = floor.perceive(), floor.save()
    ends = []
    for put_back in (lambda: None, lambda: floor.restore(kept)):
        put_back()
        ends.append(driven(floor, np.array([-1.0, 0.2, -0.5]), 30).perceive())
    assert ends[0] == ends[1]
    other = Floor(given)
    assert other.reset(state)
    driven(other, np.array([-1.0, 0.2, -0.5]), 30)
    for obj in state:
        np.testing.assert_allclose(other.perceive()[obj], ends[0][obj], atol=1e-9)


def test_cargo_is_put_back_as_well() -> None:
    floor = Floor(task(x=3.9, forward=0.5))
    kept, before = floor.save(), floor.perceive()
    driven(floor, AHEAD, 10)
    loaded, after = floor.save(), floor.perceive()
    assert after.get(O1, "carried")[0] == 1.0
    for snapshot, state in ((kept, before), (loaded, after), (kept, before)):
        floor.restore(snapshot)
        assert floor.perceive() == state
        driven(floor, AHEAD, 5)
