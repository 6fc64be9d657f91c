"""From a library to a model: everything it holds, and clear words where it does not fit."""

from __future__ import annotations

from dataclasses import replace

import pytest

from resync_robot.core.errors import LibraryError, PolicyError
from resync_robot.core.library import Record, load_library
from resync_robot.core.rig import load_rig
from resync_robot.core.vocabulary import BLOCK, ROBOT
from resync_robot.curriculum.context import Known
from resync_robot.learning.model import Concepts
from resync_robot.library_models import (
    camera_recovery,
    initial_model,
    known_concepts,
    learned_model,
    make_library,
    sees_by_camera,
    shipped_library,
)
from resync_robot.planning.execute import Model
from resync_robot.planning.pddl import domain_to_pddl
from resync_robot.planning.search import plan
from resync_robot.sim_training.domains import find_domain
from tests import scenes
from tests.domains import PUCK_DOMAIN
from tests.libraries import DOMAIN, given_library, recovery_record

RIG, CORNERED = load_rig(), find_domain(DOMAIN)
ON = CORNERED.predicate("On")


def test_the_given_model_plans_obliviously() -> None:
    model = initial_model(CORNERED, RIG)
    assert set(model.skills) == {"Pick", "Insert", "Place"}
    initial = scenes.scene({"b0": (scenes.CORNER, scenes.CORNER), "b1": (0.0, 0.0)}).initial
    goal = CORNERED.parse_goal("On(b1,b0)", initial.objects)
    found = plan(model.operators, initial.objects, model.abstraction.true_atoms(initial), goal)
    assert str(found) == "Pick(r, b1), Insert(r, b1, b0)"


def with_recovery(record: Record) -> Model:
    """The given model and the recovery of a record, which no operator speaks of yet."""
    return Known(domain=CORNERED.spec, rig=RIG).with_recovery(CORNERED.recovery, record).open().model


def test_a_recovery_beside_it_changes_neither_symbols_nor_plans() -> None:
    given, model = initial_model(CORNERED, RIG), with_recovery(recovery_record())
    assert set(model.skills) == {"Pick", "Insert", "Place", CORNERED.recovery}
    assert model.operators == given.operators
    assert model.abstraction.predicates == given.abstraction.predicates
    assert [t.name for t in model.skill(CORNERED.recovery).types] == ["robot", "block", "box"]
    assert model.skill(CORNERED.recovery).live_state


def test_a_library_comes_back_as_the_model_it_was_made_of() -> None:
    concepts = Concepts(
        CORNERED.predicates,
        CORNERED.classifiers,
        CORNERED.operators,
        {},
        {
            "experience": {"Pick": [{"predicate": "HandEmpty", "argument": 0, "held": [1, 2], "otherwise": [0, 3]}]},
        },
    )
    stage = given_library().stages[0]
    library = make_library(CORNERED, RIG, stage, recovery_record(), concepts, {"seed": 1})
    model = learned_model(CORNERED, RIG, library)
    assert set(model.operators) == set(CORNERED.operators)
    assert set(model.abstraction.predicates) == set(CORNERED.predicates)
    pick = next(o for o in CORNERED.operators if o.name == "Pick").ground((ROBOT("r"), BLOCK("b")))
    hand_empty = next(iter(pick.preconditions))
    # Nine of ten are expected before there is experience, and a little less than usual in each of the circumstances.
    expected = 0.95 * (1 + 4.5) / (5 + 5)
    assert [model.costs.success(pick, atoms) for atoms in ({hand_empty}, set())] == pytest.approx(
        [(1 + 10 * expected) / 12, 10 * expected / 13]
    )
    assert model.learned == {}
    assert library.stages == (stage,)
    assert (library.rig_hash, library.provenance) == (RIG.hash, {"seed": 1})


def test_a_later_stage_comes_to_what_was_known() -> None:
    """Two recoveries, each with its record, stage and camera policy; the model has both."""
    first = replace(given_library(), policies={"Recover": {"config.json": b"1"}})
    concepts = known_concepts(CORNERED, first)
    stage = replace(first.stages[0], recovery="Push", scenario="s2")
    policy = {"config.json": b"2"}
    both = make_library(CORNERED, RIG, stage, recovery_record(0.5), concepts, {"seed": 2}, policy, known=first)
    assert [s.recovery for s in both.stages] == ["Recover", "Push"] and both.stage("Push") == stage
    assert both.skills["Recover"] is first.skills["Recover"] and set(both.skills) == {"Recover", "Push"}
    assert both.policies == {"Recover": {"config.json": b"1"}, "Push": policy}
    assert set(learned_model(CORNERED, RIG, both).skills) == {"Pick", "Insert", "Place", "Recover", "Push"}
    with pytest.raises(LibraryError, match="no skill 'Pull'"):
        both.stage("Pull")


def test_what_a_domain_was_given_since_a_library_was_learned_comes_with_it() -> None:
    before = [o for o in CORNERED.operators if o.name in ("Pick", "Insert")]
    older = replace(
        given_library(),
        domain_pddl=domain_to_pddl(
            CORNERED.name,
            CORNERED.types,
            [p for p in CORNERED.predicates if p.name != "On"],
            [replace(o, add=o.add - {ON(*o.parameters[1:])} if o.name == "Insert" else o.add) for o in before],
        ),
    )
    model = learned_model(CORNERED, RIG, older)
    learned = {o.name: o for o in model.operators}
    assert set(learned) == {"Pick", "Insert", "Place"} and learned["Place"] in CORNERED.operators
    assert ON not in {a.predicate for a in learned["Insert"].add}, "what was learned stays as it was"
    assert set(model.abstraction.predicates) == set(CORNERED.predicates)


def test_the_shipped_library_puts_down_what_is_in_the_hand_to_free_its_base() -> None:
    """Nobody told the planner to: the recovery was learned with an empty hand, and Place empties it."""
    model = learned_model(CORNERED, RIG, load_library(shipped_library(DOMAIN)))
    corner = scenes.scene({"b0": (scenes.CORNER, scenes.CORNER), "b1": (0.0, 0.0)}).initial
    x, y, z = corner.get(BLOCK("b1"), "x", "y", "z")
    held = corner.with_features(BLOCK("b1"), z=z + 0.25)
    held = held.with_features(ROBOT("r"), x=x, y=y, z=z + 0.25, opening=scenes.WIDTH)
    atoms, goal = model.abstraction.true_atoms(held), CORNERED.parse_goal("On(b1,b0)", held.objects)
    found = plan(model.operators, held.objects, atoms, goal, costs=model.costs)
    assert str(found) == "Place(r, b1), Recover(r, b0, box), Pick(r, b1), Insert(r, b1, b0)"


def test_outcomes_may_contradict_learned_classifiers_alone_as_far_as_these_err() -> None:
    library = load_library(shipped_library(DOMAIN))
    learned = learned_model(CORNERED, RIG, library).learned
    assert {n: e for n, e in learned.items() if not n.endswith("-box")} == pytest.approx(
        {n: 1 - library.predicates[f"{n}-box"].meta["accuracy"] for n in ("ReadyPick",)}
    )
    assert set(learned) == {"ReadyPick", "ReadyPick-box"}, "none derived from On"


def test_a_library_of_another_domain_is_refused() -> None:
    with pytest.raises(LibraryError, match="learned in 'kitchen'"):
        learned_model(CORNERED, RIG, replace(given_library(), domain="kitchen"))


def test_a_library_without_the_recovery_is_refused() -> None:
    with pytest.raises(LibraryError, match="no skill 'Recover'"):
        learned_model(CORNERED, RIG, replace(given_library(), skills={}))
    with pytest.raises(LibraryError, match="no stage"):
        learned_model(CORNERED, RIG, replace(given_library(), stages=()))


@pytest.mark.parametrize("part", ["policy", "terminal"])
def test_a_recovery_record_that_lacks_a_part_is_refused(part: str) -> None:
    record = recovery_record()
    without_meta = replace(record, meta={k: v for k, v in record.meta.items() if k != part})
    without_weights = replace(record, tensors={k: v for k, v in record.tensors.items() if not k.startswith(part)})
    for broken in (without_meta, without_weights):
        with pytest.raises(LibraryError):
            with_recovery(broken)


@pytest.mark.parametrize(
    "execution",
    [
        {"variants": {"Pick_Recover": "Pick"}},
        {"experience": {"Pick": [{"predicate": "HandEmpty", "argument": 0, "held": [3, 2], "otherwise": [0, 0]}]}},
        {"experience": {"Pick": [{"predicate": "HandEmpty", "argument": 1, "held": [1, 2], "otherwise": [0, 0]}]}},
        {"experience": {"Pick": [{"predicate": "HandEmpty", "argument": 7, "held": [1, 2], "otherwise": [0, 0]}]}},
        {"experience": {"Pick": [{"predicate": "Bare", "argument": 0, "held": [1, 2], "otherwise": [0, 0]}]}},
        {"experience": {"Juggle": [{"predicate": "HandEmpty", "argument": 0, "held": [1, 2], "otherwise": [0, 0]}]}},
        {"experience": {"Pick": [{"predicate": "HandEmpty", "argument": 0}]}},
        {
            "experience": {
                "Pick": [
                    {
                        "predicate": "On",
                        "form": "Exists",
                        "over": [1],
                        "argument": 0,
                        "held": [1, 2],
                        "otherwise": [0, 0],
                    }
                ]
            }
        },
        {
            "experience": {
                "Pick": [
                    {
                        "predicate": "On",
                        "form": "Exists",
                        "over": [2],
                        "argument": 1,
                        "held": [1, 2],
                        "otherwise": [0, 0],
                    }
                ]
            }
        },
    ],
)
def test_execution_that_does_not_fit_the_domain_is_refused(execution: dict[str, object]) -> None:
    with pytest.raises(LibraryError, match=r"execution\.json does not fit"):
        learned_model(CORNERED, RIG, replace(given_library(), execution=execution))


# -- the recovery by camera -------------------------------------------------------------------------------------------


def test_a_library_without_a_camera_policy_says_how_to_go_on() -> None:
    assert not sees_by_camera(CORNERED, given_library())
    with pytest.raises(LibraryError, match="no camera policy for 'Recover'") as caught:
        camera_recovery(CORNERED, RIG, given_library())
    assert "--skills state" in caught.value.fix


def test_a_broken_camera_policy_is_one_clear_error() -> None:
    library = replace(given_library(), policies={CORNERED.recovery: {"resync.json": b"{"}})
    assert sees_by_camera(CORNERED, library)
    with pytest.raises(PolicyError, match="no camera policy"):
        camera_recovery(CORNERED, RIG, library)


def test_a_recovery_can_be_put_in_place_of_the_one_that_follows_the_state() -> None:
    other = replace(learned_model(CORNERED, RIG, given_library()).skill(CORNERED.recovery), live_state=False)
    model = learned_model(CORNERED, RIG, given_library(), [other])
    assert model.skill(CORNERED.recovery) is other


def test_a_library_is_refused_where_the_types_are_others() -> None:
    library = replace(given_library(), types_hash=CORNERED.types_hash)
    assert learned_model(CORNERED, RIG, library).operators
    robot, block, box = CORNERED.types
    other = replace(CORNERED, types=(robot, replace(block, features=(*block.features, "colour")), box))
    assert other.types_hash != CORNERED.types_hash
    with pytest.raises(LibraryError, match="types of 'cornered-insertion-s' are not those any more"):
        learned_model(other, RIG, library)


def test_a_domain_with_an_embodiment_brings_its_own_skills() -> None:
    assert set(initial_model(PUCK_DOMAIN, RIG).skills) == {"Fetch", "Bring"}
