"""Dreams of a door that is in the way: what is placed where, and what becomes of it; no arm, and nothing is learned."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core.errors import TrainingError
from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.task import Domain
from resync_robot.core.trajectory import Trajectory, Transition
from resync_robot.core.world import Observation
from resync_robot.learning.dataset import ATTEMPT
from resync_robot.learning.failures import FailureModel, fit_beside, place_beside, resampling
from resync_robot.library_models import initial_model
from resync_robot.planning.outcome_costs import JitteredCosts
from resync_robot.planning.search import plan
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.dreaming import Dream, Dreamer, Placement, causes_of, reference_of, tally

PUCKS = Path(__file__).parents[2] / "docs" / "puck_behind_a_door.py"
DOMAIN = find_domain(str(PUCKS))
ROBOT, PUCK, PAD, DOOR, STONE = DOMAIN.types
THE_DOOR, P0 = DOOR("door"), PUCK("p0")


class Ram:
    """Drives at the door as fast as it can: what a recovery would have learned."""

    def __init__(self, objects: tuple[Object, ...], first: Observation) -> None:
        self._robot, _, self._door = objects
        self._steps = 0

    def step(self, seen: Observation) -> np.ndarray | SkillOutcome:
        self._steps += 1
        if seen.state[self._door][2] < 0.6 or self._steps > 120:
            return SkillOutcome(SkillEnd.DONE if self._steps <= 120 else SkillEnd.TIMEOUT)
        way = seen.state[self._door][:2] - seen.state[self._robot][:2]
        return np.array([*(way / np.hypot(*way)), -1.0])


def _states(scenario: str, count: int = 12) -> list[State]:
    return [DOMAIN.scenario(scenario).sample(np.random.default_rng(s), s).initial for s in range(count)]


def _failure() -> FailureModel:
    return FailureModel(
        recovery="OpenDoor",
        skill="Fetch",
        argument=1,
        relevant=PUCK,
        causes=(THE_DOOR,),
        before={THE_DOOR: fit_beside(DOMAIN, _states("door"), THE_DOOR, P0)},
        after={THE_DOOR: fit_beside(DOMAIN, _states("open"), THE_DOOR, P0)},
    )


def _dreamer(domain: Domain = DOMAIN, failures: tuple[FailureModel, ...] | None = None) -> Dreamer:
    model = initial_model(domain, None)
    skill = Skill("OpenDoor", (ROBOT, PUCK, DOOR), Ram, 10.0, time_limit_s=20, live_state=True)
    model = replace(model, skills={**model.skills, "OpenDoor": skill, "Shove": replace(skill, name="Shove")})
    assert domain.embodiment is not None
    return Dreamer(domain, domain.embodiment, failures or (_failure(),), model, {ROBOT: 1, PUCK: 1, PAD: 1})


def test_every_combination_has_its_quota() -> None:
    stone = replace(_failure(), recovery="Shove", causes=(STONE("stone"),))
    dreamer = _dreamer(failures=(_failure(), stone))
    combinations = dreamer.combinations()
    # Two failures, each absent, or before or after beside either of two pucks; not both absent.
    assert len(combinations) == len(set(combinations)) == 5 * 5 - 1
    dreams = dreamer.dreams(48, 8, first_seed=100)
    counts = Counter(d.placements for d in dreams if not d.attempt and not d.wander)
    assert set(counts) == set(combinations) and set(counts.values()) == {2}
    attempts = Counter(d.placements for d in dreams if d.attempt)
    assert set(attempts.values()) == {2} and all(len(p) == 1 for p in attempts)
    assert [d.placements[0].failure for d in dreams if d.wander] == [1, 1]
    assert len({d.seed for d in dreams}) == len(dreams)


def test_a_scene_that_can_have_no_more_objects_has_fewer_references() -> None:
    assert DOMAIN.free is not None
    alone = replace(DOMAIN, free=lambda rng, seed, counts: DOMAIN.free(rng, seed, {**counts, PUCK: 1, PAD: 1}))  # type: ignore[misc]
    assert {p[0].reference for p in _dreamer(alone).combinations()} == {0}


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), when=st.sampled_from(["before", "after"]), reference=st.integers(0, 1))
def test_the_door_is_put_beside_the_puck_as_its_gaussian_has_it(seed: int, when: str, reference: int) -> None:
    dreamer, dream = _dreamer(), Dream((Placement(0, when, reference),), seed)
    task = dreamer.task(dream)
    assert task.initial == dreamer.task(dream).initial
    puck, relation = reference_of(task.initial, dreamer.failures[0], reference), resampling(DOMAIN, DOOR, PUCK)
    seen = relation.see(task.initial[THE_DOOR][None], task.initial[puck][None])[0]
    gaussian = (dreamer.failures[0].before if when == "before" else dreamer.failures[0].after)[THE_DOOR]
    sigma = np.sqrt(np.diag(gaussian.covariance))
    # Directions are taken for the nearest that can be seen, so only the position is as it was drawn.
    assert (np.abs(seen[:2] - gaussian.mean[:2]) < 5 * sigma[:2]).all()


@settings(max_examples=40, deadline=None)
@given(x=st.floats(-2, 2), y=st.floats(-2, 2), angle=st.floats(-3.1, 3.1))
def test_what_is_placed_is_seen_where_it_was_put(x: float, y: float, angle: float) -> None:
    """Also beside a round thing: a door behind a puck is not one before it."""
    state, relative = _states("door", 1)[0], np.array([x, y, np.cos(angle), np.sin(angle)])
    placed = place_beside(DOMAIN, state, THE_DOOR, P0, relative, np.random.default_rng(0))
    seen = resampling(DOMAIN, DOOR, PUCK).see(placed[THE_DOOR][None], placed[P0][None])[0]
    np.testing.assert_allclose(seen, relative, atol=1e-9)
    np.testing.assert_array_equal(placed[P0], state[P0])


def test_what_is_fixed_stays_and_the_other_is_moved() -> None:
    built_in, state = replace(DOMAIN, fixed=(DOOR,)), _states("door", 1)[0]
    placed = place_beside(built_in, state, THE_DOOR, P0, np.array([0.3, 0.1, 1.0, 0.0]), np.random.default_rng(0))
    np.testing.assert_array_equal(placed[THE_DOOR], state[THE_DOOR])
    assert not np.array_equal(placed[P0], state[P0])


def test_before_the_recovery_is_needed_and_leads_to_the_goal() -> None:
    dreamer = _dreamer()
    lived = [dreamer.live(Dream((Placement(0, "before", 0),), seed)) for seed in range(12)]
    trajectories = [t for some in lived for t in some]
    solved = [[(x.skill, x.succeeded) for x in t.transitions] for t in trajectories if t.solved]
    assert len(solved) >= 8 and all(names[0] == ("Fetch", False) for names in solved)
    assert sum(("OpenDoor", True) in names for names in solved) >= 8
    after = [t for seed in range(12) for t in dreamer.live(Dream((Placement(0, "after", 0),), seed))]
    assert sum(t.solved for t in after) >= 8
    assert not any(x.skill == "OpenDoor" for t in after for x in t.transitions)


def test_attempts_are_spread_between_failure_and_success_and_mend_nothing() -> None:
    dreamer = _dreamer()
    dreams = [Dream((Placement(0, "before", 0),), seed, attempt=True) for seed in range(24)]
    lived = [t for dream in dreams for t in dreamer.live(dream)]
    assert {t.source for t in lived} == {ATTEMPT}
    firsts = [t.transitions[0].succeeded for t in lived]
    assert 3 <= sum(firsts) <= len(firsts) - 3
    assert not any(x.skill == "OpenDoor" for t in lived for x in t.transitions)


def test_wanderings_aim_at_nothing_and_hold_the_recovery() -> None:
    dreamer = _dreamer()
    lived = [t for seed in range(12, 24) for t in dreamer.live(Dream((Placement(0, "before", 0),), seed, wander=True))]
    assert {(t.source, t.solved) for t in lived} <= {(ATTEMPT, False)}
    assert all(x.succeeded for t in lived for x in t.transitions)
    assert any(x.skill == "OpenDoor" for t in lived for x in t.transitions)


def test_a_recovery_that_the_failure_leaves_no_room_for_comes_first_in_a_second_try() -> None:
    """With its reaction asleep, the dream is dreamed again from its beginning."""
    failure = replace(_failure(), skill="Bring", argument=1)
    lived = [_dreamer(failures=(failure,)).live(Dream((Placement(0, "before", 0),), seed)) for seed in range(6)]
    seconds = [some[1] for some in lived if len(some) == 2]
    assert len(seconds) >= 4 and all(t.transitions[0].skill == "OpenDoor" for t in seconds)
    assert any(t.solved for t in seconds)


def test_a_scene_without_what_is_needed_says_so() -> None:
    state, failure = _states("open", 1)[0], _failure()
    with pytest.raises(TrainingError, match="has 1 objects of type puck, 3 are needed"):
        reference_of(state, failure, 2)
    with pytest.raises(TrainingError, match="no stone that could stand in the way"):
        causes_of(state, replace(failure, causes=(STONE("stone"),)))
    with pytest.raises(TrainingError, match="has no scene to dream in"):
        _dreamer(replace(DOMAIN, free=None)).combinations()


def test_another_cause_of_the_type_stands_in() -> None:
    task = DOMAIN.scenario("stone-aside").sample(np.random.default_rng(0), 0)
    failure = replace(_failure(), causes=(STONE("other"),))
    assert [o.name for o in causes_of(task.initial, failure)] == ["stone"]


def test_the_tally_counts_by_source() -> None:
    dreamer = _dreamer()
    lived = [t for seed in range(3) for t in dreamer.live(Dream((Placement(0, "after", 1),), seed))]
    assert tally(lived) == {"after1@1": {"dreamed": len(lived), "solved": sum(t.solved for t in lived)}}


@pytest.mark.parametrize(
    ("lived", "kept"),
    [
        ("Fetch! OpenDoor Fetch Bring", 4),
        ("Fetch! OpenDoor! Fetch! Fetch!", 2),
        ("OpenDoor! Shove OpenDoor Fetch", 4),
        ("OpenDoor! Shove! Fetch!", 2),
        ("Fetch! Fetch!", 2),
    ],
)
def test_a_dream_ends_where_a_recovery_failed_and_no_other_one_followed(lived: str, kept: int) -> None:
    state = _states("door", 1)[0]
    steps = tuple(Transition(state, w.rstrip("!"), (), state, not w.endswith("!")) for w in lived.split())
    dreamer = _dreamer(failures=(_failure(), replace(_failure(), recovery="Shove")))
    trajectory = Trajectory(steps, frozenset(), True, "before1@0")
    ended = dreamer._until_in_vain(trajectory)
    assert ended.transitions == steps[:kept] and ended.solved == (kept == len(steps))


def test_dreams_do_not_always_begin_with_the_same_thing() -> None:
    """With two pucks to fetch and nothing in the way, now the one is fetched first and now the other."""
    task = DOMAIN.scenario("two-pucks").sample(np.random.default_rng(0), 0)
    model = initial_model(DOMAIN, None)
    atoms = model.abstraction.true_atoms(task.initial)
    first = {
        plan(model.operators, task.objects, atoms, task.goal, costs=JitteredCosts(model.costs, seed)).steps[0]
        for seed in range(12)
    }
    assert len({step.objects[1] for step in first}) == 2
