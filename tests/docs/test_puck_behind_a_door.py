"""The guide's domain: its doors turn and its stones give way, but only to a push."""

import numpy as np
import pytest

from resync_robot.core.state import State
from resync_robot.core.task import Task
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.execute import EpisodeResult, ExecuteSettings, Model, plan_and_execute
from tests.domains import PUCK_DOMAIN, puck

BODY = PUCK_DOMAIN.embodiment
assert BODY is not None
SKILLS = {s.name: s for s in BODY.skills()}
MODEL = Model(SKILLS, Abstraction(PUCK_DOMAIN.predicates, PUCK_DOMAIN.classifiers), PUCK_DOMAIN.operators)
ONCE = ExecuteSettings(max_failures=1)
DOOR, STONE, ROBOT, PUCK = puck.DOOR("door"), puck.STONE("stone"), puck.ROBOT("r"), puck.PUCK("p0")


def drawn(scenario: str, seed: int = 0) -> Task:
    return PUCK_DOMAIN.scenarios[scenario].sample(np.random.default_rng(seed), seed)


def push(world: puck.Rooms, times: int, speed: float = 1.0) -> None:  # type: ignore[name-defined]
    for _ in range(times):
        world.act(np.array([speed, 0.0, -1.0]), 0.1)


def carry_out(world: puck.Rooms, task: Task) -> EpisodeResult:  # type: ignore[name-defined]
    return plan_and_execute(world, MODEL, task.goal, ONCE)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("scenario", "what"), [("door", DOOR), ("ajar", DOOR), ("two-pucks", DOOR), ("stone", STONE)], ids=str
)
def test_what_stops_the_given_skill_gives_way_to_a_push(scenario: str, what: object, seed: int) -> None:
    task = drawn(scenario, seed)
    world = puck.Rooms(task)
    assert not carry_out(world, task).success
    assert set(world.contacts()) == {what}
    np.testing.assert_array_equal(world.perceive()[what], task.initial[what])
    push(world, 20)
    assert carry_out(world, task).success


def test_a_door_stays_where_it_is_left_and_near_its_hinge_does_not_turn() -> None:
    task = drawn("door")
    hinge = puck.Rooms(task)._doors[DOOR]
    radius = task.initial.get(ROBOT, "diameter")[0] / 2
    angles = {}
    for lever in (0.1, 0.9):
        features = {o: task.initial[o] for o in task.objects}
        features[DOOR] = np.array([hinge.x, hinge.y + hinge.length / 2, puck.CLOSED, hinge.length, 0.02])
        beside = [hinge.x - radius - 0.02, hinge.y + lever * hinge.length, 0.0, 2 * radius, 0.0]
        world = puck.Rooms(task)
        assert world.reset(State({**features, ROBOT: np.array(beside)}))
        push(world, 1)
        angles[lever] = world.perceive().get(DOOR, "theta")[0]
        for _ in range(5):
            world.act(np.array([-1.0, 0.0, -1.0]), 0.1)
        assert world.perceive().get(DOOR, "theta")[0] == angles[lever]
    assert angles[0.1] == pytest.approx(puck.CLOSED) and angles[0.9] < puck.CLOSED - 0.05


def test_nothing_overlaps_however_it_is_driven() -> None:
    rng = np.random.default_rng(0)
    task = drawn("stone-and-two-pucks")
    world = puck.Rooms(task)
    for i in range(200):
        if i % 10 == 0:
            action = rng.uniform((-1, -1, -1), 1)
        world.act(action, 0.1)
        discs = list(world._discs.values())
        for j, a in enumerate(discs):
            assert a.radius - 0.03 < a.x < puck.WIDTH - a.radius + 0.03
            for b in discs[j + 1 :]:
                assert np.hypot(a.x - b.x, a.y - b.y) > a.radius + b.radius - puck.STRIDE


def test_a_room_follows_from_its_state() -> None:
    """A dream moves the door; the wall comes with it."""
    task = drawn("open")
    state = task.initial.with_features(DOOR, x=task.initial.get(DOOR, "x")[0] + 0.1)
    world = puck.Rooms(task)
    assert world.reset(state) and world.perceive() == state
    inside_the_wall = state.with_features(PUCK, x=world._doors[DOOR].x, y=0.1)
    assert not world.reset(inside_the_wall)


def test_what_is_held_is_held_again_after_a_reset() -> None:
    task = drawn("open")
    world = puck.Rooms(task)
    plan_and_execute(world, MODEL, frozenset({puck.HOLDING(ROBOT, PUCK)}), ONCE)
    held = world.perceive()
    again = puck.Rooms(task)
    assert again.reset(held) and again.perceive() == held
    push(again, 1, speed=-0.5)
    assert puck.holding(held, (ROBOT, PUCK)) and not puck.holding(again.perceive(), (ROBOT, PUCK)), "it was opened"
    again.reset(held)
    again.act(np.array([-0.5, 0.0, 1.0]), 0.1)
    moved = again.perceive()[PUCK][:2] - held[PUCK][:2]
    np.testing.assert_allclose(moved, [-0.05, 0.0], atol=1e-9)


def test_free_gives_what_is_asked_for() -> None:
    for counts in ({puck.PUCK: 3}, {puck.PUCK: 1, puck.STONE: 2}, {puck.DOOR: 0, puck.PAD: 2}):
        state = PUCK_DOMAIN.free(np.random.default_rng(0), 0, counts).initial
        assert all(len(state.of_type(t)) >= n for t, n in counts.items())
