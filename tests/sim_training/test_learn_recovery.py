"""A recovery learned in a domain that is no arm: a door that is in the way, found, explained, and pushed open."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from resync_robot.core.errors import TrainingError
from resync_robot.core.task import Domain
from resync_robot.learning.relational_view import RelationalView
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.execute import Model, run_skill
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.domains.icy_transport import ICY_TRANSPORT
from resync_robot.sim_training.failure_mining import FailedAttempt, explain, mine_stage
from resync_robot.sim_training.learn_recovery import (
    RecoverySettings,
    applied_elsewhere,
    attempts_elsewhere,
    learn_recovery,
    pose_problem,
)
from resync_robot.sim_training.ppo import PpoSettings

PUCKS = Path(__file__).parents[2] / "docs" / "puck_behind_a_door.py"


@pytest.fixture(scope="module")
def domain() -> Domain:
    return find_domain(str(PUCKS))


@pytest.fixture(scope="module")
def model(domain: Domain) -> Model:
    assert domain.embodiment is not None
    skills = {s.name: s for s in domain.embodiment.skills()}
    return Model(skills, Abstraction(domain.predicates, domain.classifiers), domain.operators)


@pytest.fixture(scope="module")
def failures(domain: Domain, model: Model) -> list[FailedAttempt]:
    return mine_stage(domain, domain.stages[0], model, 0, 40)


def test_failures_are_explained_by_what_was_run_into(failures: list[FailedAttempt]) -> None:
    found = explain(failures)
    assert (found.skill, [o.name for o in found.objects]) == ("Fetch", ["r", "p0"])
    assert [o.name for o in found.culprits] == ["door"]
    assert [o.name for o in found.projected] == ["r", "p0", "door"]


def test_each_stage_has_its_own_culprit(domain: Domain, model: Model) -> None:
    found = explain(mine_stage(domain, domain.stages[1], model, 0, 10))
    assert [o.name for o in found.culprits] == ["stone"]


def test_failures_without_contact_explain_nothing(failures: list[FailedAttempt]) -> None:
    untouched = [replace(f, run_into={}) for f in failures]
    with pytest.raises(TrainingError, match="ran into nothing at all"):
        explain(untouched)
    robot = [replace(f, run_into={f.skill.objects[0]: 5.0}) for f in failures]
    with pytest.raises(TrainingError, match="no object explains"):
        explain(robot)


def test_a_scenario_that_does_not_fail_is_an_error(domain: Domain, model: Model) -> None:
    easy = replace(domain.stages[0], scenario="open")
    with pytest.raises(TrainingError, match="tasks of open failed, 2 failures are needed"):
        mine_stage(domain, easy, model, 0, 2)


def test_the_view_is_of_the_objects_and_of_nothing_else(domain: Domain, failures: list[FailedAttempt]) -> None:
    state = failures[0].state
    view = RelationalView(explain(failures).projected, domain.relations)
    assert view(state).shape == (view.size,)
    pad = next(o for o in state.objects if o.type.name == "pad")
    np.testing.assert_array_equal(view(state.with_features(pad, x=9.0)), view(state))
    everything_moved = state
    for obj in state.objects:
        x, y = state.get(obj, "x", "y")
        everything_moved = everything_moved.with_features(obj, x=x + 0.7, y=y - 0.2)
    np.testing.assert_allclose(view(everything_moved), view(state), atol=1e-9)


def test_it_is_tried_with_other_objects_as_well(domain: Domain, model: Model, failures: list[FailedAttempt]) -> None:
    """What was run into is put beside another puck as it lay beside the first, and the skill applied to that one."""
    problem = pose_problem(domain, domain.stages[0], model, explain(failures), failures)
    (other,) = applied_elsewhere(domain, problem, 0)
    assert [o.name for o in other.view.objects] == ["r", "p1", "door"]
    assert str(other.judge.failed) == "Fetch(r, p1)" and {str(a) for a in other.judge.effects} == {"Holding(r, p1)"}
    (free, fetched), (shut, blocked) = attempts_elsewhere(domain, other, problem, 0, 4)
    assert list(fetched) == [True] * 4
    # Not every room that this takes can be.
    assert 1 <= len(blocked) <= 4 and not blocked.any()
    assert free.shape[1] == shut.shape[1] == problem.view.size


def test_what_the_skill_cannot_be_applied_to_says_nothing() -> None:
    """The target of Icy Transport is of the same type as its cargo, and can never be picked up."""
    body = ICY_TRANSPORT.embodiment
    assert body is not None
    skills = {s.name: s for s in body.skills()}
    abstraction = Abstraction(ICY_TRANSPORT.predicates, ICY_TRANSPORT.classifiers)
    model = Model(skills, abstraction, ICY_TRANSPORT.operators)
    failures = mine_stage(ICY_TRANSPORT, ICY_TRANSPORT.stages[0], model, 0, 4)
    problem = pose_problem(ICY_TRANSPORT, ICY_TRANSPORT.stages[0], model, explain(failures), failures)
    cargo, target = applied_elsewhere(ICY_TRANSPORT, problem, 0)
    assert [p.about.name for p in (cargo, target)] == ["o2", "target"]
    assert [list(y) for _, y in attempts_elsewhere(ICY_TRANSPORT, cargo, problem, 0, 2)] == [[True] * 2, [False] * 2]
    assert list(attempts_elsewhere(ICY_TRANSPORT, target, problem, 0, 2)) == []


def test_a_recovery_is_learned_that_opens_the_door(
    domain: Domain, model: Model, failures: list[FailedAttempt], tmp_path: Path
) -> None:
    """In its executed form: the failed skill, then the policy, until it says itself that it is done; in fresh tasks."""
    stage, found = domain.stages[0], explain(failures)
    problem = pose_problem(domain, stage, model, found, failures)
    ppo = PpoSettings(
        scenes=32, total_steps=60_000, least_steps=12_000, stop_at=0.95, minibatch=256, anneal_steps=40_000
    )
    settings = RecoverySettings(attempts=120, ppo=ppo, roll_outs=40)
    recovery, figures = learn_recovery(domain, problem, 0, tmp_path / "ppo.safetensors", lambda *_: None, settings)
    assert figures["curve"]["success"][-1] >= 0.9
    assert domain.embodiment is not None
    skill = recovery.skill(model.skill(found.skill), domain.embodiment, domain.relations)
    assert [t.name for t in skill.types] == ["robot", "puck", "door"]
    assert _then_fetched(domain, problem.judge, skill.ground(found.projected)) >= 18
    record = recovery.to_record()
    assert record.meta["signature"] == ["robot", "puck", "door"] and record.meta["failed_skill"] == "Fetch"


def _then_fetched(domain: Domain, judge, ground) -> int:  # type: ignore[no-untyped-def]
    """In how many of 20 fresh tasks the skill says that it is done, and the failed skill then succeeds."""
    assert domain.embodiment is not None
    scenario, good = domain.scenario("door"), 0
    for seed in range(9000, 9020):
        task = scenario.sample(np.random.default_rng(seed), seed)
        simulator = domain.embodiment.simulate(task)
        simulator.reset(task.initial)
        good += run_skill(simulator, ground).done and judge(simulator)
    return good


def test_a_domain_without_a_robot_cannot_be_mined(domain: Domain, model: Model) -> None:
    nobody = replace(domain, embodiment=None)
    with pytest.raises(TrainingError, match="declares no embodiment"):
        mine_stage(nobody, domain.stages[0], model, 0, 1)
