"""The executive with what it cannot be sure of: distrust after a failure, and atoms that hold perhaps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from resync_robot.core.skill import SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.deployment.uncertain_atoms import SampledAbstraction
from resync_robot.planning.execute import EpisodeEnd, ExecuteSettings, Model, plan_and_execute
from tests.planning.kitchen import (
    CLEAN,
    FILL,
    FULL,
    GOAL,
    OPEN,
    UNLID,
    WIPE,
    A,
    B,
    Kitchen,
    Notes,
    X,
    kitchen,
    model,
    nothing,
    setting,
)

LEARNED = {"Clean": None}


def test_after_a_failure_the_atom_it_relied_on_is_distrusted_until_restored() -> None:
    # The cup looks clean and is not: filling fails until it was wiped.
    world, notes, wiped = kitchen(open="a", clean="a"), Notes(), []

    def wipe(cup: Object) -> Callable[[State], State]:
        wiped.append(cup)
        return nothing(cup)

    def fill(cup: Object) -> Callable[[State], State]:
        return setting("full")(cup) if wiped else nothing(cup)

    done = SkillOutcome(SkillEnd.DONE)
    blind = model(world, Fill=(fill, done), Wipe=(wipe, done))
    assert plan_and_execute(world, blind, GOAL, ExecuteSettings(max_failures=2)).end is EpisodeEnd.STUCK
    wary = model(world, Fill=(fill, done), Wipe=(wipe, done), learned=LEARNED)
    result = plan_and_execute(world, wary, GOAL, ExecuteSettings(max_failures=2), notes)
    assert result.success
    assert notes.plans == ["Fill(a)", "Wipe(a), Fill(a)"]
    assert notes.seen[1][CLEAN(A)] == 0.5 and notes.seen[-1][CLEAN(A)] > 0.9


def test_distrust_concerns_the_object_that_failed_only() -> None:
    world, notes = kitchen(open="ab", clean="ab"), Notes()

    def only_b(cup: Object) -> Callable[[State], State]:
        return setting("full")(cup) if cup == B else nothing(cup)

    goal = frozenset({FULL(A), FULL(B)})
    fills = model(world, Fill=(only_b, SkillOutcome(SkillEnd.DONE)), learned=LEARNED)
    plan_and_execute(world, fills, goal, ExecuteSettings(max_failures=2), notes)
    assert not any("Wipe(b)" in plan for plan in notes.plans)
    assert any("Wipe(a)" in plan for plan in notes.plans)


@pytest.mark.parametrize(
    ("ending", "ran", "reached"), [(SkillEnd.NEEDLESS, "Unlid", True), (SkillEnd.REFUSED, "Wipe", False)]
)
def test_a_recovery_that_nothing_calls_for_shows_that_what_it_brings_about_is_there(
    ending: SkillEnd, ran: str, reached: bool
) -> None:
    """A clean cup looks dirty. Wiping it begins with what only works for a clean one, and that works."""
    world, notes = kitchen(), Notes()
    lid = replace(UNLID, preconditions=frozenset({CLEAN(X)}))
    known = model(world, Wipe=(setting("open"), SkillOutcome(ending)), operators=(lid, FILL, WIPE), learned=LEARNED)
    begins = {"begins_with": lambda objects: known.skill("Unlid").ground(objects)}
    known = replace(known, skills={**known.skills, "Wipe": replace(known.skill("Wipe"), **begins)})
    result = plan_and_execute(world, known, GOAL, listener=notes)
    assert result.success == reached
    assert result.transitions[0].skill == ran and result.transitions[0].succeeded == reached
    assert (notes.seen[1][CLEAN(A)] > notes.seen[0][CLEAN(A)]) == reached
    assert len(result.transitions) <= 5


def test_doubt_that_leaves_no_plan_is_dropped_and_the_skill_tried_again() -> None:
    world, notes, tries = kitchen(open="a", clean="a"), Notes(), []

    def fills_the_second_time(cup: Object) -> Callable[[State], State]:
        tries.append(1)
        return setting("full")(cup) if len(tries) > 1 else nothing(cup)

    fills = (fills_the_second_time, SkillOutcome(SkillEnd.DONE))
    without_wiping = model(world, Fill=fills, operators=(UNLID, FILL), learned=LEARNED)
    result = plan_and_execute(world, without_wiping, GOAL, listener=notes)
    assert result.success
    failed = "Fill(a) did not do what it should (done: effects missing)"
    assert notes.reasons == ["start", f"{failed}; no plan otherwise, relying on Clean(a) (0.68)"]
    assert [p.relies_on for p in result.plans] == [frozenset(), {CLEAN(A)}]


@dataclass
class Murky(Kitchen):
    """A kitchen in which nobody sees well how clean the first cup is."""

    def perceive(self) -> State:
        seen = self.state.with_features(A, clean=0.6 if self.state.get(A, "full")[0] < 0.5 else 1.0)
        return State({cup: seen[cup] for cup in seen}, {A: np.diag([0.0, 0.0, 0.25**2])})


def test_where_doubt_leaves_no_plan_the_likelier_atoms_are_planned_with() -> None:
    world, notes = Murky(kitchen(open="a").state), Notes()
    sure = model(world, operators=(UNLID, FILL))
    doubting = SampledAbstraction(sure.abstraction)
    assert CLEAN(A) in doubting.doubtful(world.perceive())
    unsure = Model(sure.skills, doubting, sure.operators)
    result = plan_and_execute(world, unsure, GOAL, listener=notes)
    assert result.success and result.reason == ""
    assert [r.startswith("start; no plan otherwise, relying on Clean(a) (0.") for r in notes.reasons] == [True]
    # Where something can be done about it, that comes first.
    wiping, notes = Model(sure.skills, doubting, (UNLID, FILL, WIPE)), Notes()
    plan_and_execute(Murky(kitchen(open="a").state), wiping, GOAL, ExecuteSettings(max_skills=1), notes)
    assert notes.plans[0] == "Wipe(a), Fill(a)"


def test_a_likely_goal_that_nothing_can_make_surer_says_so() -> None:
    world = Murky(kitchen().state)
    result = plan_and_execute(world, Model({}, SampledAbstraction(model(world).abstraction), ()), frozenset({CLEAN(A)}))
    assert result.success and "not all of it is certain" in result.reason
    result = plan_and_execute(world, Model({}, SampledAbstraction(model(world).abstraction), ()), frozenset({OPEN(A)}))
    assert result.end is EpisodeEnd.NO_PLAN
