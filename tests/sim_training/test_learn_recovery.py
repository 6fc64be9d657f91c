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
from resync_robot.planning.execute import Model
from resync_robot.planning.skill_run import run_skill
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.failure_mining import FailedAttempt, explain, mine_stage
from resync_robot.sim_training.learn_recovery import Learned, RecoverySettings, learn_recovery
from resync_robot.sim_training.ppo import PpoSettings
from resync_robot.sim_training.recovery_elsewhere import applied_elsewhere, tried_elsewhere
from resync_robot.sim_training.recovery_problem import Problem, Start, pose_problem
from tests.sim_training.sliding import S, problem, task_at

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
    return mine_stage(domain, domain.embodiment, domain.stages[0], model, 0, 40)


def test_failures_are_explained_by_what_was_run_into(domain: Domain, failures: list[FailedAttempt]) -> None:
    found = explain(domain, failures)
    assert (found.skill, [o.name for o in found.objects]) == ("Fetch", ["r", "p0"])
    assert [o.name for o in found.culprits] == ["door"]
    assert [o.name for o in found.projected] == ["r", "p0", "door"]


def test_each_stage_has_its_own_culprit(domain: Domain, model: Model) -> None:
    found = explain(domain, mine_stage(domain, domain.embodiment, domain.stages[1], model, 0, 10))
    assert [o.name for o in found.culprits] == ["stone"]


def test_failures_without_contact_explain_nothing(domain: Domain, failures: list[FailedAttempt]) -> None:
    untouched = [replace(f, run_into={}) for f in failures]
    with pytest.raises(TrainingError, match="ran into nothing at all"):
        explain(domain, untouched)
    robot = [replace(f, run_into={f.objects[0]: 5.0}) for f in failures]
    with pytest.raises(TrainingError, match="no object explains"):
        explain(domain, robot)


def test_a_scenario_that_does_not_fail_is_an_error(domain: Domain, model: Model) -> None:
    easy = replace(domain.stages[0], scenario="open")
    with pytest.raises(TrainingError, match="tasks of open failed, 2 failures are needed"):
        mine_stage(domain, domain.embodiment, easy, model, 0, 2)


def test_the_view_is_of_the_objects_and_of_nothing_else(domain: Domain, failures: list[FailedAttempt]) -> None:
    state = failures[0].state
    view = RelationalView(explain(domain, failures).projected, domain.relations)
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
    assert domain.embodiment is not None
    starts = [Start(f.task, f.state) for f in failures]
    posed = pose_problem(domain, domain.embodiment, domain.stages[0], model, explain(domain, failures), starts)
    (other,) = applied_elsewhere(posed, 0)
    assert [o.name for o in other.objects] == ["r", "p1", "door"]
    assert str(other.judge.failed) == "Fetch(r, p1)" and {str(a) for a in other.judge.effects} == {"Holding(r, p1)"}
    runs = tried_elsewhere(posed, 0, 8)
    assert {run.features.shape for run in runs} == {(posed.interface.features,)}
    assert [run.succeeded for run in runs[:4]] == [True] * 4
    # Not every room that this takes can be.
    assert 1 <= len(runs) - 4 <= 4 and not any(run.succeeded for run in runs[4:])


def test_what_the_skill_cannot_be_applied_to_says_nothing() -> None:
    """The target of Icy Transport is of the same type as its cargo, and can never be picked up."""
    icy = find_domain("icy-transport")
    body = icy.embodiment
    assert body is not None
    given = Model({s.name: s for s in body.skills()}, Abstraction(icy.predicates, icy.classifiers), icy.operators)
    failed = mine_stage(icy, body, icy.stages[0], given, 0, 4)
    starts = [Start(f.task, f.state) for f in failed]
    posed = pose_problem(icy, body, icy.stages[0], given, explain(icy, failed), starts)
    assert [p.explanation.relevant.name for p in applied_elsewhere(posed, 0)] == ["o2", "target"]
    runs = tried_elsewhere(posed, 0, 4)
    assert [run.succeeded for run in runs] == [True, True, False, False]


def test_a_recovery_is_learned_that_opens_the_door(
    domain: Domain, model: Model, failures: list[FailedAttempt], tmp_path: Path
) -> None:
    """In its executed form: the failed skill, then the policy, until it says itself that it is done; in fresh tasks."""
    stage, found = domain.stages[0], explain(domain, failures)
    starts = [Start(f.task, f.state) for f in failures]
    problem = pose_problem(domain, domain.embodiment, stage, model, found, starts)
    ppo = PpoSettings(
        scenes=32, total_steps=60_000, least_steps=12_000, stop_at=0.95, minibatch=256, anneal_steps=40_000
    )
    settings = RecoverySettings(attempts=120, ppo=ppo, roll_outs=40)
    learned = learn_recovery(problem, 0, tmp_path / "ppo.safetensors", lambda *_: None, settings)
    assert learned.figures["curve"]["success"][-1] >= 0.9
    assert domain.embodiment is not None
    skill = learned.recovery.skill(model.skill(found.skill), domain.embodiment, domain.relations)
    assert [t.name for t in skill.types] == ["robot", "puck", "door"]
    assert _then_fetched(domain, problem.judge, skill.ground(found.projected)) >= 18
    record = learned.recovery.to_record()
    assert record.meta["signature"] == ["robot", "puck", "door"] and record.meta["failed_skill"] == "Fetch"


SHORT = RecoverySettings(
    attempts=20,
    ppo=PpoSettings(scenes=32, steps=16, total_steps=10_240, least_steps=10_240, minibatch=128, anneal_steps=8_000),
    roll_outs=20,
    width=32,
)


def slide() -> Problem:
    rng = np.random.default_rng(0)
    tasks = [task_at(0.0, x) for x in rng.uniform(0.1, 0.3, 16)]
    return problem([Start(task, task.initial) for task in tasks])


def test_equal_seeds_learn_the_same_and_a_finished_checkpoint_is_used(tmp_path: Path) -> None:
    def learn(name: str) -> Learned:
        return learn_recovery(slide(), 1, tmp_path / name, lambda *_: None, SHORT)

    one, two = learn("one"), learn("two")
    weights = [learned.recovery.policy.to_tensors() for learned in (one, two)]
    assert all((weights[0][name] == weights[1][name]).all() for name in weights[0])
    assert one.after and all(0.5 < state[S][0] < 0.8 for state in one.after)
    again = learn("one")
    assert again.figures["curve"]["steps"] == one.figures["curve"]["steps"], "it was finished"


def _then_fetched(domain: Domain, judge, ground) -> int:  # type: ignore[no-untyped-def]
    """In how many of 20 fresh tasks the skill says that it is done, and the failed skill then succeeds."""
    assert domain.embodiment is not None
    scenario, good = domain.scenario("door"), 0
    for seed in range(9000, 9020):
        task = scenario.sample(np.random.default_rng(seed), seed)
        simulator = domain.embodiment.simulate(task)
        simulator.reset(task.initial)
        good += run_skill(simulator, ground).done and judge(simulator, task.initial)
    return good
