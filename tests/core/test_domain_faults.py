"""What is wrong with a domain is named before anything of it runs."""

from dataclasses import replace
from typing import Any

import pytest

from resync_robot.core.domain_faults import faults, skill_faults
from resync_robot.core.embodiment import Stage
from resync_robot.core.symbols import Operator, Predicate, Type, Variable
from resync_robot.core.task import Domain
from tests.domains import PUCK_DOMAIN as GOOD

STRANGE = Type("ghost", ("x",))
ROBOT = GOOD.types[0]
BODY = GOOD.embodiment
assert BODY is not None


def of(domain: Domain) -> str:
    return "\n".join(f"{what} -> {fix}" for what, fix in faults(domain))


def test_a_good_domain_has_no_fault() -> None:
    assert of(GOOD) == ""
    assert list(skill_faults(GOOD, BODY.skills())) == []


def with_scenario(**change: Any) -> Domain:
    return replace(GOOD, scenarios={**GOOD.scenarios, "open": replace(GOOD.scenarios["open"], **change)})


@pytest.mark.parametrize(
    ("domain", "words"),
    [
        (replace(GOOD, name=3), "name is of type int -> make it a str"),
        (replace(GOOD, name="My Domain"), "use small letters, digits and '-'"),
        (replace(GOOD, types=list(GOOD.types)), "types is of type list -> make it a tuple of Type"),
        (replace(GOOD, types=()), "there are no types"),
        (replace(GOOD, stages=()), "there are no stages"),
        (replace(GOOD, scenarios={}), "there are no scenarios"),
        (replace(GOOD, operators=(*GOOD.operators, "Open")), "a tuple with Operator, str in it"),
        (replace(GOOD, classifiers=[]), "classifiers is of type list -> make it a dictionary"),
        (replace(GOOD, free=3), "free is of type int -> make it a function"),
        (replace(GOOD, embodiment="arm"), "embodiment is of type str"),
        (replace(GOOD, types=(*GOOD.types, ROBOT)), "type 'robot' is there twice"),
        (replace(GOOD, types=(*GOOD.types, Type("disc", ("x", "x")))), "feature of type disc 'x' is there twice"),
        (replace(GOOD, types=(*GOOD.types, Type("disc", "x"))), "the features of type disc are 'x'"),
        (replace(GOOD, predicates=(*GOOD.predicates, Predicate("at", ()))), "predicate 'at' is there twice"),
        (replace(GOOD, predicates=(*GOOD.predicates, Predicate("Seen", (STRANGE,)))), "Seen is about type 'ghost'"),
        (replace(GOOD, predicates=(*GOOD.predicates, Predicate("Seen", ()))), "predicate Seen has no classifier"),
        (replace(GOOD, classifiers={**GOOD.classifiers, "At": 1.0}), "the classifier of At is of type float"),
        (replace(GOOD, classifiers={**GOOD.classifiers, "Att": len}), "there is a classifier 'Att'"),
        (replace(GOOD, operators=(*GOOD.operators, GOOD.operators[0])), "operator 'Fetch' is there twice"),
        (replace(GOOD, operators=(Operator("Wait", ()),)), "operator Wait changes nothing"),
        (
            replace(GOOD, operators=(Operator("Haunt", (Variable("?g", STRANGE),)),)),
            "operator Haunt is about type 'ghost'",
        ),
        (replace(GOOD, predicates=GOOD.predicates[:2], classifiers={}), "Bring uses At, which is not among the predic"),
        (with_scenario(name="opened"), "scenario 'opened' is filed under 'open'"),
        (with_scenario(sample=None), "sample of scenario open is of type NoneType"),
        (with_scenario(after_stage=3), "scenario open is for after stage 3 -> one of 0 (none) to 2"),
        (replace(GOOD, scenarios={**GOOD.scenarios, "x": 1}), "scenario 'x' is of type int"),
        (replace(GOOD, stages=(Stage(recovery="Open", scenario="shut", horizon=3),)), "Open learns in 'shut'"),
        (replace(GOOD, stages=(Stage(recovery="Open", scenario="open", horizon=3),)), "which is for tests"),
        (replace(GOOD, stages=(Stage(recovery="Fetch", scenario="door", horizon=3),)), "a skill that is given already"),
        (replace(GOOD, stages=(Stage(recovery="Open", scenario="door", horizon=0),)), "Open has a horizon of 0"),
        (replace(GOOD, stages=GOOD.stages * 2), "recovery 'OpenDoor' is there twice"),
        (replace(GOOD, embodiment=replace(BODY, actions={})), "embodiment.actions is of type dict"),
        (replace(GOOD, embodiment=replace(BODY, actions={"vx": 1.0})), "action 'vx' goes from least to greatest 1.0"),
        (replace(GOOD, embodiment=replace(BODY, actions={"vx": (1.0, -1.0)})), "action 'vx' goes from"),
        (replace(GOOD, embodiment=replace(BODY, rate_hz=0.0)), "embodiment.rate_hz is 0.0"),
        (replace(GOOD, embodiment=replace(BODY, simulate=None)), "embodiment.simulate is of type NoneType"),
    ],
)
def test_each_fault_is_named(domain: Domain, words: str) -> None:
    assert words in of(domain)


SKILLS = BODY.skills()


@pytest.mark.parametrize(
    ("skills", "words"),
    [
        (list(SKILLS), "embodiment.skills() returns of type list"),
        (SKILLS[:1], "operator Bring has no skill; there are Fetch"),
        (
            (SKILLS[0], replace(SKILLS[1], types=SKILLS[1].types[:2])),
            "skill Bring takes (robot, puck), its operator (rob",
        ),
        ((SKILLS[0], replace(SKILLS[1], rate_hz=0.0)), "skill Bring has a rate or a time limit"),
        ((*SKILLS, SKILLS[0]), "skill 'Fetch' is there twice"),
    ],
)
def test_each_fault_of_the_skills_is_named(skills: Any, words: str) -> None:
    assert words in "\n".join(what for what, _ in skill_faults(GOOD, skills))


def test_what_a_scenario_begins_after_is_a_skill() -> None:
    domain = with_scenario(begins_after=(("Fly", ("r",)),))
    assert [w for w, _ in skill_faults(domain, SKILLS)] == ["scenario open begins after 'Fly', which is no skill"]
