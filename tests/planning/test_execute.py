"""The executive with a robot on paper: what it does about what comes true, what does not, and what never does."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import pytest

from resync_robot.core.errors import UnknownNameError
from resync_robot.core.joints import JointTarget
from resync_robot.core.skill import GroundSkill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Object, Operator, Predicate
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.effect_hypotheses import with_relaxed_recoveries
from resync_robot.planning.execute import EpisodeEnd, ExecuteSettings, Model, plan_and_execute
from resync_robot.planning.skill_run import LOOKS
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
    Toy,
    X,
    kitchen,
    model,
    nothing,
    setting,
)

WATER = Predicate("Water", ())
"""Cup b holds the water that others are filled with."""


class Shares(Abstraction):
    """Tells how much water there is, as samples of poses would."""

    def shares(self, state: State) -> dict[Atom, float]:
        return self.abstract(state)


def test_a_plan_that_works_is_carried_out_step_by_step() -> None:
    world = kitchen()
    result = plan_and_execute(world, model(world), GOAL)
    assert result.success and result.end is EpisodeEnd.GOAL and result.reason == ""
    assert [t.skill for t in result.transitions][-1] == "Fill"
    assert {t.skill for t in result.transitions} == {"Unlid", "Wipe", "Fill"}
    assert all(t.succeeded and t.objects == (A,) for t in result.transitions)
    assert len(result.plans) == 1
    assert result.final == world.state
    for before, after in zip(result.transitions, result.transitions[1:], strict=False):
        assert after.before == before.after


def test_a_goal_that_holds_already_moves_nothing() -> None:
    world = kitchen(full="a")
    result = plan_and_execute(world, model(world), GOAL)
    assert result.success and not result.transitions and not result.plans
    assert not any(line.startswith("act") for line in world.log)


def test_listeners_hear_everything_in_its_order() -> None:
    world, notes = kitchen(open="a", clean="a"), Notes()
    plan_and_execute(world, model(world), GOAL, listener=notes)
    controls = ["control"] * 2
    assert notes.heard == [
        "perceived",
        "plan Fill(a)",
        "step 0",
        "may Fill(a)?",
        "start Fill(a)",
        *controls,
        "end Fill(a) done",
        "perceived",
        "over: goal",
    ]
    assert notes.reasons == ["start"]


def test_it_plans_again_where_an_effect_is_missing_though_the_skill_said_done() -> None:
    world = kitchen(clean="a")
    opened: list[int] = []

    def opens_the_second_time(cup: Object) -> Callable[[State], State]:
        opened.append(1)
        return setting("open")(cup) if len(opened) > 1 else nothing(cup)

    notes = Notes()
    result = plan_and_execute(
        world, model(world, Unlid=(opens_the_second_time, SkillOutcome(SkillEnd.DONE))), GOAL, listener=notes
    )
    assert result.success
    assert [(t.skill, t.succeeded) for t in result.transitions] == [("Unlid", False), ("Unlid", True), ("Fill", True)]
    assert notes.plans == ["Unlid(a), Fill(a)"] * 2
    assert notes.reasons[1] == "Unlid(a) did not do what it should (done: effects missing)"
    assert notes.failed == ["Unlid(a)"]


@dataclass
class Glimpses(Kitchen):
    """A kitchen in which the first `wrong` looks after each step do not see what was opened."""

    wrong: int = 0
    looks: int = 0

    def act(self, target: JointTarget, duration: float) -> None:
        super().act(target, duration)
        self.looks = 0

    def perceive(self) -> State:
        self.looks += 1
        return self.state.with_features(A, open=0.0) if self.looks <= self.wrong else self.state


@pytest.mark.parametrize("wrong", range(LOOKS + 1))
def test_it_looks_again_where_a_skill_says_done_and_nothing_is_seen_of_it(wrong: int) -> None:
    world = Glimpses(kitchen(clean="a").state, wrong=wrong)
    result = plan_and_execute(world, model(world), frozenset({OPEN(A)}), ExecuteSettings(max_failures=1))
    assert result.success == (wrong < LOOKS)
    assert world.looks == min(wrong + 1, LOOKS)


@pytest.mark.parametrize(("says", "learned"), [(SkillEnd.BLOCKED, {}), (SkillEnd.DONE, {"Open": None})])
def test_one_look_is_enough_where_the_skill_gave_up_or_a_belief_weighs_its_word(
    says: SkillEnd, learned: Mapping[str, float | None]
) -> None:
    world = Glimpses(kitchen(clean="a").state, wrong=1)
    known = model(world, Unlid=(setting("open"), SkillOutcome(says)), learned=learned)
    plan_and_execute(world, known, frozenset({OPEN(A)}), ExecuteSettings(max_failures=1))
    assert world.looks == 1


def test_it_plans_again_where_the_next_step_lost_its_precondition() -> None:
    world, notes = kitchen(clean="a"), Notes()
    spilled: list[int] = []

    def opens_and_soils_once(cup: Object) -> Callable[[State], State]:
        spilled.append(1)
        return lambda state: state.with_features(cup, open=1.0, clean=float(len(spilled) > 1))

    result = plan_and_execute(
        world, model(world, Unlid=(opens_and_soils_once, SkillOutcome(SkillEnd.DONE))), GOAL, listener=notes
    )
    assert result.success
    assert [t.skill for t in result.transitions] == ["Unlid", "Wipe", "Fill"]
    assert notes.reasons[1] == "Fill(a) needs Clean(a)" and not notes.failed


@pytest.mark.parametrize(("water", "done"), [(0.0, ["Unlid"]), (0.7, ["Unlid", "Wipe", "Fill"])])
def test_what_a_later_step_lacks_is_noticed_at_once_where_it_is_false_and_not_just_in_doubt(
    water: float, done: list[str]
) -> None:
    world = kitchen(full="b")

    def spills(cup: Object) -> Callable[[State], State]:
        return lambda state: state.with_features(cup, open=1.0).with_features(B, full=water)

    wipe = replace(WIPE, preconditions=frozenset({OPEN(X)}))
    fill = replace(FILL, preconditions=FILL.preconditions | {WATER()})
    given = model(world, Unlid=(spills, SkillOutcome(SkillEnd.DONE)), operators=(UNLID, wipe, fill))
    known = given.abstraction
    classifiers = {**known.classifiers, "Water": lambda state, objects: float(state.get(B, "full")[0])}
    notes = Notes()
    wet = replace(given, abstraction=Shares([*known.predicates, WATER], classifiers))
    result = plan_and_execute(world, wet, GOAL, listener=notes)
    assert [t.skill for t in result.transitions] == done
    assert notes.plans[0] == "Unlid(a), Wipe(a), Fill(a)"
    assert result.success is bool(water)


def test_a_missing_delete_effect_counts_as_failure() -> None:
    drain = Operator("Fill", (X,), frozenset({OPEN(X)}), frozenset({FULL(X)}), frozenset({OPEN(X)}))
    world = kitchen(open="ab")
    two = frozenset({FULL(A), FULL(B)})
    result = plan_and_execute(world, model(world, operators=(drain, UNLID)), two, ExecuteSettings(max_failures=1))
    assert result.end is EpisodeEnd.STUCK
    assert not result.transitions[0].succeeded


def test_a_goal_beyond_every_operator_ends_with_no_plan() -> None:
    world = kitchen()
    result = plan_and_execute(world, model(world, operators=(UNLID,)), GOAL)
    assert result.end is EpisodeEnd.NO_PLAN and not result.success
    assert "Full(a)" in result.reason


def test_the_same_failure_again_and_again_ends_stuck() -> None:
    world = kitchen(open="a", clean="a")
    blocked = (nothing, SkillOutcome(SkillEnd.BLOCKED, "a wall"))
    result = plan_and_execute(world, model(world, Fill=blocked), GOAL, ExecuteSettings(max_failures=2))
    assert result.end is EpisodeEnd.STUCK
    assert [t.succeeded for t in result.transitions] == [False, False]
    assert "blocked: a wall" in result.reason


def test_what_was_learned_is_doubted_where_restoring_it_fails_again_and_again() -> None:
    """Clean is said to be false whatever is wiped; filling the cup works all the same."""
    unwiped, learned = (nothing, SkillOutcome(SkillEnd.DONE)), {"Clean": None}
    world = kitchen(open="a")
    notes = Notes()
    result = plan_and_execute(world, model(world, Wipe=unwiped, learned=learned), GOAL, listener=notes)
    assert [t.skill for t in result.transitions] == ["Wipe", "Wipe", "Fill"]
    assert result.success
    assert [t.succeeded for t in result.transitions] == [False, True, True]
    assert 0.9 < notes.seen[2][CLEAN(A)] < 1, "and it is told so"

    world = kitchen(open="a")
    broken = (nothing, SkillOutcome(SkillEnd.BLOCKED))
    result = plan_and_execute(world, model(world, Wipe=broken, learned=learned), GOAL)
    assert [t.skill for t in result.transitions] == ["Wipe"] * 4 + ["Fill"], "later where the skill agrees"
    assert result.success

    world = kitchen(open="a")
    assert not plan_and_execute(world, model(world, Wipe=unwiped), GOAL).success, "what was given is not doubted"


def test_a_skill_that_was_tried_against_what_was_learned_and_failed_is_not_tried_at_once_again() -> None:
    world = kitchen(open="a")
    unfilled = model(
        world,
        Wipe=(nothing, SkillOutcome(SkillEnd.DONE)),
        Fill=(nothing, SkillOutcome(SkillEnd.BLOCKED)),
        learned={"Clean": None},
    )
    result = plan_and_execute(world, unfilled, GOAL)
    assert [t.skill for t in result.transitions] == ["Wipe", *["Wipe", "Fill"] * 5]
    assert result.end is EpisodeEnd.STUCK


def test_failures_are_counted_for_each_ground_skill_by_itself() -> None:
    world = kitchen(open="ab", clean="ab")
    tries: dict[Object, int] = {A: 0, B: 0}

    def fills_the_second_time(cup: Object) -> Callable[[State], State]:
        tries[cup] += 1
        return setting("full")(cup) if tries[cup] > 1 else nothing(cup)

    two = frozenset({FULL(A), FULL(B)})
    settings = ExecuteSettings(max_failures=2)
    assert plan_and_execute(
        world, model(world, Fill=(fills_the_second_time, SkillOutcome(SkillEnd.DONE))), two, settings
    ).success


def test_too_many_skills_end_exhausted() -> None:
    world = kitchen()
    result = plan_and_execute(world, model(world), GOAL, ExecuteSettings(max_skills=2))
    assert result.end is EpisodeEnd.EXHAUSTED
    assert len(result.transitions) == 2


def test_an_episode_ends_at_its_horizon_of_control_steps() -> None:
    world = kitchen()
    result = plan_and_execute(world, model(world), GOAL, ExecuteSettings(horizon=3))
    assert (result.end, result.reason) == (EpisodeEnd.EXHAUSTED, "3 control steps were taken")
    assert [t.succeeded for t in result.transitions] == [True, False], "the second skill was cut short"
    world = kitchen()
    longer = plan_and_execute(world, model(world), GOAL, ExecuteSettings(horizon=6))
    assert longer.success and result.steps == 3 and longer.steps == 6


def test_a_declined_step_stops_the_episode_before_it_moves() -> None:
    world, notes = kitchen(clean="a"), Notes(decline="Fill(a)")
    result = plan_and_execute(world, model(world), GOAL, listener=notes)
    assert result.end is EpisodeEnd.STOPPED
    assert result.reason == "Fill(a) was declined"
    assert "start Unlid(a)" in notes.heard and "start Fill(a)" not in notes.heard
    assert notes.heard[-1] == "over: stopped"


def test_a_plan_that_is_only_asked_for_ends_planned_and_nothing_is_run_or_asked() -> None:
    world, notes = kitchen(), Notes(decline="Unlid(a)")
    result = plan_and_execute(world, model(world), GOAL, ExecuteSettings(plan_only=True), notes)
    assert (result.end, result.success, result.transitions) == (EpisodeEnd.PLANNED, False, ())
    assert result.reason == f"{len(result.plans[0].steps)} steps"
    assert notes.heard[-1] == "over: planned" and not [h for h in notes.heard if h.startswith("start ")]


def test_a_reaction_is_asked_after_a_failure_and_its_skill_is_run() -> None:
    world, asked = kitchen(open="a", clean="a"), []

    def fill(cup: Object) -> Callable[[State], State]:
        return lambda state: state.with_features(cup, full=float(state.get(B, "clean")[0]))

    known = model(world, Fill=(fill, SkillOutcome(SkillEnd.DONE)))

    def react(failed: GroundSkill, state: State) -> GroundSkill | None:
        asked.append((str(failed), state))
        return known.skill("Wipe").ground((B,))

    result = plan_and_execute(world, known, GOAL, reaction=react)
    assert result.success
    assert [str(a) for a, _ in asked] == ["Fill(a)"]
    assert [(t.skill, t.objects, t.succeeded) for t in result.transitions] == [
        ("Fill", (A,), False),
        ("Wipe", (B,), True),
        ("Fill", (A,), True),
    ]
    assert result.transitions[1].before == asked[0][1]


@pytest.mark.parametrize(
    ("retry", "skills"), [(False, ["Fill", "Wipe", "Unlid", "Fill"]), (True, ["Fill", "Wipe", "Fill"])]
)
def test_what_a_reaction_mended_is_tried_at_once_if_wanted_whatever_is_believed(retry: bool, skills: list[str]) -> None:
    """Wiping a cup makes it look as if it were closed, which it is not."""
    world = kitchen(open="a", clean="a")

    def fill(cup: Object) -> Callable[[State], State]:
        return lambda state: state.with_features(cup, full=float(state.get(B, "clean")[0]))

    def wipe(cup: Object) -> Callable[[State], State]:
        return lambda state: state.with_features(cup, clean=1.0).with_features(A, open=0.0)

    done = SkillOutcome(SkillEnd.DONE)
    known = model(world, Fill=(fill, done), Wipe=(wipe, done))
    result = plan_and_execute(
        world, known, GOAL, ExecuteSettings(retry=retry), reaction=lambda *_: known.skill("Wipe").ground((B,))
    )
    assert result.success and [t.skill for t in result.transitions] == skills


def test_a_reaction_may_decline() -> None:
    world = kitchen(open="a", clean="a")
    known = model(world, Fill=(nothing, SkillOutcome(SkillEnd.BLOCKED)))
    result = plan_and_execute(world, known, GOAL, reaction=lambda failed, state: None)
    assert result.end is EpisodeEnd.STUCK
    assert {t.skill for t in result.transitions} == {"Fill"}


def test_an_operator_without_a_skill_is_named() -> None:
    world = kitchen()
    whole = model(world)
    without = Model({k: s for k, s in whole.skills.items() if k != "Wipe"}, whole.abstraction, whole.operators)
    with pytest.raises(UnknownNameError, match="Wipe"):
        plan_and_execute(world, without, frozenset({CLEAN(A)}))


def test_a_result_keeps_every_plan() -> None:
    world = kitchen(open="a", clean="a")
    result = plan_and_execute(
        world, model(world, Fill=(nothing, SkillOutcome(SkillEnd.DONE))), GOAL, ExecuteSettings(max_failures=3)
    )
    assert len(result.plans) == 3
    assert all(str(p) == "Fill(a)" for p in result.plans)


def test_a_step_that_is_needless_by_now_is_left_out() -> None:
    """Opening one cup opens the other as well."""
    world = kitchen(clean="ab")
    both = (lambda state: setting("open")(A)(setting("open")(B)(state)), SkillOutcome(SkillEnd.DONE))
    known = model(world)
    unlid = known.skill("Unlid")
    known = replace(
        known,
        skills={**known.skills, "Unlid": replace(unlid, start=lambda objects, first: Toy(world, *both))},
    )
    result = plan_and_execute(world, known, frozenset({FULL(A), FULL(B)}))
    assert result.success
    assert sorted(t.skill for t in result.transitions) == ["Fill", "Fill", "Unlid"]


def test_where_no_plan_is_left_it_goes_on_against_what_is_known() -> None:
    """Clean is said to be false, nothing wipes, and filling the cup works all the same."""
    learned = {"Clean": None}
    world = kitchen(open="a")
    known = model(world, learned=learned)
    unwiped = replace(known, operators=tuple(o for o in known.operators if o.name != "Wipe"))
    result = plan_and_execute(world, unwiped, GOAL)
    assert result.success and [t.skill for t in result.transitions] == ["Fill"]
    world = kitchen(open="a")
    known = model(world, learned=learned)
    unwiped = replace(known, operators=tuple(o for o in known.operators if o.name != "Wipe"))
    assert plan_and_execute(world, unwiped, GOAL, ExecuteSettings(suppose=False)).end is EpisodeEnd.NO_PLAN


def test_what_was_given_is_dropped_from_the_preconditions_of_recoveries_alone() -> None:
    recovery = Operator("Wipe", (X,), frozenset({OPEN(X)}), frozenset({CLEAN(X)}))
    other = Operator("Fill", (X,), frozenset({OPEN(X), CLEAN(X)}), frozenset({FULL(X)}))
    relaxed = with_relaxed_recoveries((recovery, other), {"Clean"})
    assert relaxed == (replace(recovery, preconditions=frozenset()), other)
