"""A second failure learned on top of a first one: what was known stays, and a library holds all of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from resync_robot.core.library import LearnedFailure, LearnedStage, Library, load_library, save_library
from resync_robot.core.state import State
from resync_robot.core.symbols import Operator
from resync_robot.learning.concepts import learn_concepts
from resync_robot.learning.dataset import StageData
from resync_robot.learning.model import Concepts, load_concepts
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.search import plan
from tests.learning.conftest import one_thread
from tests.learning.episodes import QUICK, success
from tests.learning.toy import Toy, first_stage
from tests.learning.toy_can import CAN, DOMAIN_WITH_CAN, PUSH, ToyWithCan


@pytest.fixture(scope="module")
def data() -> tuple[StageData, StageData]:
    """A cornered block; then a can beside a block, which is of a type that the first stage never saw."""
    cornered, canned = Toy(0), ToyWithCan(0)
    return (
        first_stage(cornered.dreams(60) + cornered.attempts(90)),
        StageData("Push", PUSH, "Pick", canned.dreams(60) + canned.attempts(90)),
    )


@pytest.fixture(scope="module")
def first(data: tuple[StageData, StageData]) -> Concepts:
    with one_thread():
        return learn_concepts(data[:1], DOMAIN_WITH_CAN, config=QUICK)


@pytest.fixture(scope="module")
def second(data: tuple[StageData, StageData], first: Concepts) -> Concepts:
    with one_thread():
        return learn_concepts(data, DOMAIN_WITH_CAN, first, config=QUICK)


def operator(concepts: Concepts, name: str) -> Operator:
    return next(o for o in concepts.operators if o.name == name)


def needs(concepts: Concepts, skill: str) -> set[str]:
    """Names of the learned predicates that a skill needs."""
    return {a.predicate.name for a in operator(concepts, skill).preconditions} & set(concepts.records)


def test_every_skill_keeps_what_it_needed_and_needs_the_new_condition_besides(
    first: Concepts, second: Concepts
) -> None:
    for skill in ("Pick", "Insert"):
        assert needs(first, skill) and needs(first, skill) <= needs(second, skill)
        assert any(second.records[p].meta["stage"] == 2 for p in needs(second, skill))
    assert not needs(second, "Push") and not needs(second, "Recover"), "nothing learned hinders a recovery"
    achieved = {a.predicate.name for a in operator(second, "Push").add}
    assert achieved & needs(second, "Pick") and not achieved & set(first.records)
    assert {a.predicate for a in operator(first, "Recover").add} <= {
        a.predicate for a in operator(second, "Recover").add
    }


def test_skills_rely_on_a_learned_atom_of_each_stage(second: Concepts) -> None:
    for skill, argument in (("Pick", 1), ("Insert", 2)):
        relied_on = second.report["affordances_of"][skill]
        assert {a["argument"] for a in relied_on} == {argument}
        assert {second.records[a["predicate"]].meta["stage"] for a in relied_on} == {1, 2}


@pytest.mark.parametrize("scenario", ["S0", "S1", "S2"])
def test_what_the_first_stage_could_do_is_not_forgotten(second: Concepts, scenario: str) -> None:
    assert success(second, scenario, 20) == 1.0


@pytest.mark.parametrize("scenario", ["can", "both"])
def test_the_new_failure_is_planned_around_alone_and_beside_the_old_one(second: Concepts, scenario: str) -> None:
    assert success(second, scenario, 20, ToyWithCan(1000)) == 1.0


def test_both_recoveries_come_before_the_hand_is_full(second: Concepts) -> None:
    toy = ToyWithCan(6)
    state, goal = toy.scenario("both")
    atoms = Abstraction(second.predicates, second.classifiers).true_atoms(toy.seen(state))
    steps = [str(s) for s in plan(second.operators, state.objects, atoms, goal).steps]
    assert set(steps[:2]) == {"Recover(robot, b0, box)", "Push(robot, b1, can)"}
    assert steps[2:] == ["Pick(robot, b1)", "Insert(robot, b1, b0)"]


def test_a_library_holds_both_stages_and_gives_the_same_model(second: Concepts, tmp_path: Path) -> None:
    box, can = (
        LearnedFailure(skill="Pick", argument=1, objects={o: o}, before={o: {}}, after={o: {}}) for o in ("box", "can")
    )
    stages = (
        LearnedStage(recovery="Recover", scenario="S0", failure=box),
        LearnedStage(recovery="Push", scenario="can", failure=can),
    )
    saved = Library(DOMAIN_WITH_CAN.name, "hash", second.report["pddl"], second.records, {}, stages, {})
    save_library(saved, tmp_path / "library")
    loaded = load_library(tmp_path / "library")
    assert loaded.stages == stages and loaded.content_hash == saved.content_hash
    back = load_concepts(loaded.domain_pddl, loaded.predicates, DOMAIN_WITH_CAN)
    assert set(back.predicates) == set(second.predicates) and set(back.operators) == set(second.operators)
    assert {n: r.meta for n, r in back.records.items()} == {n: r.meta for n, r in second.records.items()}
    toy = ToyWithCan(4)
    for state in (toy.scenario("both")[0], toy.scenario("can")[0], toy.scenario("S2")[0]):
        assert judged(back, state) == judged(second, state)


def judged(concepts: Concepts, state: State) -> dict[object, float]:
    return dict(Abstraction(concepts.predicates, concepts.classifiers).abstract(state))


def test_effect_vectors_are_kept_with_their_stage(first: Concepts, second: Concepts) -> None:
    for name, record in second.records.items():
        assert record.meta["stage"] == (1 if name in first.records else 2)
    neural = {n: r.meta["effects"] for n, r in second.records.items() if "attempts" in r.meta}
    for name, effects in neural.items():
        recovery = "Recover" if second.records[name].meta["stage"] == 1 else "Push"
        assert effects[recovery] == [[[1, 2], 1]], name
    tuned = {entry["predicate"] for entry in second.report["tuned"]}
    assert tuned == {n for n in neural if second.records[n].meta["stage"] == 1}
    derived = [r.meta for r in second.records.values() if r.meta["kind"] == "derived" and r.meta["stage"] == 2]
    assert any(meta["effects"].get("Push") == [[[1], 1]] for meta in derived)


def test_without_cans_nothing_is_asked_of_them(second: Concepts) -> None:
    """A predicate over all cans holds where there is none."""
    toy = Toy(5)
    state, goal = toy.scenario("S4")
    assert not state.of_type(CAN)
    atoms = Abstraction(second.predicates, second.classifiers).true_atoms(toy.seen(state))
    assert [s.name for s in plan(second.operators, state.objects, atoms, goal).steps] == ["Pick", "Insert"]
