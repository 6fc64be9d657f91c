"""Who is to blame for a failure: what the robot ran into last, and the skill that failed first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from resync_robot.core.skill import Policy, Skill, SkillEnd, SkillOutcome
from resync_robot.core.symbols import Object
from resync_robot.core.world import Observation
from resync_robot.library_models import initial_model
from resync_robot.sim_training.domains import find_domain, world_task
from resync_robot.sim_training.failure_mining import (
    LATELY,
    Explanation,
    FailedAttempt,
    _LastContacts,
    as_explained,
    attempt,
)
from tests.pucks import DOMAIN, DOOR, PUCK, ROBOT, STONE

HAND, WALL, CRATE = ROBOT("robot"), DOOR("door"), STONE("stone")
PICK = Skill("Fetch", (ROBOT, PUCK), lambda objects, first: None, 10.0, 20.0).ground((HAND, PUCK("p0")))


class GivesUp:
    """Fails at once."""

    def step(self, observation: Observation) -> SkillOutcome:
        return SkillOutcome(SkillEnd.BLOCKED)


class Touching:
    """A simulator that only tells what is touched, moment after moment."""

    def __init__(self, *moments: set[object]) -> None:
        self.moments, self.now = moments, 0

    def contacts(self) -> dict[object, float]:
        self.now += 1
        return dict.fromkeys(self.moments[self.now - 1], 1.0)


@pytest.mark.parametrize(
    ("moments", "blamed"),
    [
        ([{CRATE}, *[set()] * (LATELY + 1), {WALL}], {WALL}),
        ([{CRATE}, *[set()] * LATELY, {WALL}], {CRATE, WALL}),
        ([set(), {WALL}, *[set()] * 40], {WALL}),
        ([{CRATE}] * 2 + [{WALL}] * LATELY, {WALL}),
        ([set()] * 9, set()),
    ],
    ids=["touched on the way", "at once", "drew back", "long ago", "nothing"],
)
def test_what_was_run_into_last_is_blamed(moments: list[set[object]], blamed: set[object]) -> None:
    heard = _LastContacts(Touching(*moments))
    heard.on_skill_start(PICK)
    for _ in moments[:-1]:
        heard.on_control(None, None)
    heard.on_skill_end(PICK, SkillOutcome(SkillEnd.BLOCKED))
    assert heard.ended is not None and set(heard.ended[1]) == blamed


def test_a_skill_that_fails_inside_a_recovery_is_what_failed() -> None:
    """A recovery that begins with Fetch, and does not help, leaves Fetch's failure to be learned from."""
    task = world_task(DOMAIN, "door", 0, 0)
    model = initial_model(DOMAIN, None)
    robot, puck = task.initial.of_type(ROBOT)[0], task.initial.of_type(PUCK)[0]
    fetch = model.skill("Fetch")
    useless = replace(fetch, name="Useless", begins_with=lambda objects: fetch.ground(objects))
    failed = attempt(DOMAIN.embodiment, task, replace(model, skills={**model.skills, "Fetch": useless}))
    assert failed is not None and (failed.skill, failed.objects) == ("Fetch", (robot, puck))
    assert {o.type for o in failed.run_into} == {DOOR}
    assert useless.ground((robot, puck)).first == fetch.ground((robot, puck))


@pytest.mark.parametrize("learned", [{}, {"Ready": None}], ids=["nothing learned", "something learned"])
def test_what_the_next_attempt_gets_past_is_no_failure_to_learn_from_once_something_was_learned(
    learned: dict[str, None],
) -> None:
    task, model, tries = world_task(DOMAIN, "open", 0, 0), initial_model(DOMAIN, None), []
    fetch = model.skill("Fetch")

    def start(objects: tuple[Object, ...], first: Observation) -> Policy:
        tries.append(objects)
        return fetch.start(objects, first) if len(tries) > 1 else GivesUp()

    clumsy = replace(model, skills={**model.skills, "Fetch": replace(fetch, start=start)}, learned=learned)
    failed = attempt(DOMAIN.embodiment, task, clumsy)
    assert (failed is None) == bool(learned)


def test_the_same_failure_on_the_way_to_something_else_has_other_names() -> None:
    icy = find_domain("icy-transport")
    task = world_task(icy, "0", 0, 0)
    named = {o.name: o for o in task.objects}
    car, first, second, ice = (named[n] for n in ("robot", "o1", "o2", "ice"))
    explained = Explanation("GoToPickObject", (car, first), first, (ice,))
    failure = FailedAttempt(task, task.initial, task.initial, "GoToPickObject", (car, second), {ice: 1.0})
    assert as_explained(failure, explained) == {first: second, second: first}
    assert as_explained(replace(failure, objects=(car, first)), explained) == {}
    assert as_explained(replace(failure, run_into={}), explained) is None
    assert as_explained(replace(failure, skill="GoToPlaceObject"), explained) is None
    swapped = task.renamed({first: second, second: first})
    np.testing.assert_array_equal(swapped.initial[first], task.initial[second])
    assert swapped.renamed({first: second, second: first}) == task
