"""Plan_f with a robot that exists on paper only: what it does about what comes true, what does not, and what never."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pytest

from resync_robot.core.errors import UnknownNameError
from resync_robot.core.joints import JointTarget
from resync_robot.core.skill import Ending, GroundSkill, Outcome, Skill
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Atoms, GroundOperator, Object, Operator, Predicate, Type
from resync_robot.core.symbols import Variable as V
from resync_robot.core.world import Observation
from resync_robot.doubt import DoubtingAbstraction
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.execute import Affordance, End, ExecuteSettings, Listener, Model, plan_f, run_skill
from resync_robot.planning.search import Plan

CUP = Type("cup", ("open", "full", "clean"))
"""A cup is opened, cleaned and filled; each feature is 0 or 1, and each predicate reads one."""
A, B = CUP("a"), CUP("b")
PREDICATES = tuple(Predicate(name, (CUP,)) for name in ("Open", "Full", "Clean"))
OPEN, FULL, CLEAN = PREDICATES
_x = V("?x", CUP)
UNLID = Operator("Unlid", (_x,), add=frozenset({OPEN(_x)}))
FILL = Operator("Fill", (_x,), frozenset({OPEN(_x), CLEAN(_x)}), frozenset({FULL(_x)}))
WIPE = Operator("Wipe", (_x,), add=frozenset({CLEAN(_x)}))
LIMIT = (1.0,) * 6


@dataclass
class Kitchen:
    """A `World` of cups. Skills write to `wanted`; each control step makes it true."""

    state: State
    time: float = 0.0
    pace: float = 1.0
    """Share of full speed; each control step takes the longer."""
    log: list[str] = field(default_factory=list)
    wanted: Callable[[State], State] | None = None

    def observe(self, live: bool = False) -> Observation:
        self.log.append(f"observe live={live}")
        return Observation(self.time, np.zeros(6), np.zeros(6), 0.0, np.zeros(3), self.state)

    def act(self, target: JointTarget, duration: float) -> None:
        self.time += duration / self.pace
        self.log.append(f"act {duration}")
        if self.wanted:
            self.state, self.wanted = self.wanted(self.state), None

    def perceive(self) -> State:
        return self.state

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        self.log.append(f"limit {limit}")


@dataclass
class Toy:
    """A policy: `change` the world in its second step, then end with `outcome`; None goes on for ever."""

    kitchen: Kitchen
    change: Callable[[State], State]
    outcome: Outcome | None
    steps: int = 0

    def step(self, observation: Observation) -> JointTarget | Outcome:
        self.steps += 1
        if self.steps == 2:
            self.kitchen.wanted = self.change
        return self.outcome if self.outcome and self.steps > 2 else JointTarget(np.zeros(6), 0.0)


def setting(feature: str, value: float = 1.0) -> Callable[[Object], Callable[[State], State]]:
    return lambda cup: lambda state: state.with_features(cup, **{feature: value})


def nothing(cup: Object) -> Callable[[State], State]:
    return lambda state: state


def kitchen(**true: str) -> Kitchen:
    """Cups a and b; keywords say of which cup a feature holds, such as open="ab"."""
    return Kitchen(State({cup: np.array([float(cup.name in true.get(f, "")) for f in CUP.features]) for cup in (A, B)}))


def model(world: Kitchen, **changes: object) -> Model:
    """All three skills; a keyword replaces what one does: (object -> change of the state, outcome)."""
    done = Outcome(Ending.DONE)
    does = {"Unlid": (setting("open"), done), "Fill": (setting("full"), done), "Wipe": (setting("clean"), done)}
    does |= {k: v for k, v in changes.items() if k in does}

    def skill(name: str) -> Skill:
        change, outcome = does[name]
        return Skill(name, (CUP,), lambda objects, first: Toy(world, change(objects[0]), outcome), 10.0, 2.0)

    def reader(feature: str) -> Callable[[State, tuple[Object, ...]], float]:
        return lambda state, objects: float(state.get(objects[0], feature)[0])

    classifiers = {p.name: reader(p.name.lower()) for p in PREDICATES}
    return Model(
        {name: skill(name) for name in does},
        Abstraction(PREDICATES, classifiers),
        changes.get("operators", (UNLID, FILL, WIPE)),
        changes.get("affordances", {}),
    )


class Notes(Listener):
    """Writes down what it hears."""

    def __init__(self, decline: str = "") -> None:
        self.heard: list[str] = []
        self.reasons: list[str] = []
        self.seen: list[Mapping[Atom, float]] = []
        self.decline = decline

    def on_perceived(self, state: State, atoms: Mapping[Atom, float]) -> None:
        self.heard.append("perceived")
        self.seen.append(atoms)

    def on_plan(self, plan: Plan, reason: str) -> None:
        self.heard.append(f"plan {plan}")
        self.reasons.append(reason)

    def on_step_of_plan(self, index: int) -> None:
        self.heard.append(f"step {index}")

    def on_skill_start(self, skill: GroundSkill) -> None:
        self.heard.append(f"start {skill}")

    def on_control(self, observation: Observation, target: JointTarget) -> None:
        self.heard.append("control")

    def on_skill_end(self, skill: GroundSkill, outcome: Outcome) -> None:
        self.heard.append(f"end {skill} {outcome.ending.value}")

    def on_end(self, end: End, reason: str) -> None:
        self.heard.append(f"over: {end.value}")

    def confirm(self, step: GroundOperator) -> bool:
        self.heard.append(f"may {step}?")
        return str(step) != self.decline

    @property
    def plans(self) -> list[str]:
        return [h.removeprefix("plan ") for h in self.heard if h.startswith("plan ")]


GOAL: Atoms = frozenset({FULL(A)})


def test_a_plan_that_works_is_carried_out_step_by_step() -> None:
    world = kitchen()
    result = plan_f(world, model(world), GOAL)
    assert result.success and result.end is End.GOAL and result.reason == ""
    assert [t.skill for t in result.transitions][-1] == "Fill"
    assert {t.skill for t in result.transitions} == {"Unlid", "Wipe", "Fill"}
    assert all(t.succeeded and t.objects == (A,) for t in result.transitions)
    assert len(result.plans) == 1
    assert result.final == world.state
    for before, after in zip(result.transitions, result.transitions[1:], strict=False):
        assert after.before == before.after


def test_a_goal_that_holds_already_moves_nothing() -> None:
    world = kitchen(full="a")
    result = plan_f(world, model(world), GOAL)
    assert result.success and not result.transitions and not result.plans
    assert not any(line.startswith("act") for line in world.log)


def test_listeners_hear_everything_in_its_order() -> None:
    world, notes = kitchen(open="a", clean="a"), Notes()
    plan_f(world, model(world), GOAL, listener=notes)
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
    result = plan_f(world, model(world, Unlid=(opens_the_second_time, Outcome(Ending.DONE))), GOAL, listener=notes)
    assert result.success
    assert [(t.skill, t.succeeded) for t in result.transitions] == [("Unlid", False), ("Unlid", True), ("Fill", True)]
    assert notes.plans == ["Unlid(a), Fill(a)"] * 2
    assert notes.reasons[1] == "Unlid(a) did not do what it should (done: effects missing)"


def test_it_plans_again_where_the_next_step_lost_its_precondition() -> None:
    world, notes = kitchen(clean="a"), Notes()
    spilled: list[int] = []

    def opens_and_soils_once(cup: Object) -> Callable[[State], State]:
        spilled.append(1)
        return lambda state: state.with_features(cup, open=1.0, clean=float(len(spilled) > 1))

    result = plan_f(world, model(world, Unlid=(opens_and_soils_once, Outcome(Ending.DONE))), GOAL, listener=notes)
    assert result.success
    assert [t.skill for t in result.transitions] == ["Unlid", "Wipe", "Fill"]
    assert notes.reasons[1] == "Fill(a) needs Clean(a)"


def test_a_missing_delete_effect_counts_as_failure() -> None:
    drain = Operator("Fill", (_x,), frozenset({OPEN(_x)}), frozenset({FULL(_x)}), frozenset({OPEN(_x)}))
    world = kitchen(open="ab")
    two = frozenset({FULL(A), FULL(B)})
    result = plan_f(world, model(world, operators=(drain, UNLID)), two, ExecuteSettings(max_failures=1))
    assert result.end is End.STUCK
    assert not result.transitions[0].succeeded


def test_a_goal_beyond_every_operator_ends_with_no_plan() -> None:
    world = kitchen()
    result = plan_f(world, model(world, operators=(UNLID,)), GOAL)
    assert result.end is End.NO_PLAN and not result.success
    assert "Full(a)" in result.reason


def test_the_same_failure_again_and_again_ends_stuck() -> None:
    world = kitchen(open="a", clean="a")
    blocked = (nothing, Outcome(Ending.BLOCKED, "a wall"))
    result = plan_f(world, model(world, Fill=blocked), GOAL, ExecuteSettings(max_failures=2))
    assert result.end is End.STUCK
    assert [t.succeeded for t in result.transitions] == [False, False]
    assert "blocked: a wall" in result.reason


def test_failures_are_counted_for_each_ground_skill_by_itself() -> None:
    world = kitchen(open="ab", clean="ab")
    tries: dict[Object, int] = {A: 0, B: 0}

    def fills_the_second_time(cup: Object) -> Callable[[State], State]:
        tries[cup] += 1
        return setting("full")(cup) if tries[cup] > 1 else nothing(cup)

    two = frozenset({FULL(A), FULL(B)})
    settings = ExecuteSettings(max_failures=2)
    assert plan_f(world, model(world, Fill=(fills_the_second_time, Outcome(Ending.DONE))), two, settings).success


def test_too_many_skills_end_exhausted() -> None:
    world = kitchen()
    result = plan_f(world, model(world), GOAL, ExecuteSettings(max_skills=2))
    assert result.end is End.EXHAUSTED
    assert len(result.transitions) == 2


def test_a_declined_step_stops_the_episode_before_it_moves() -> None:
    world, notes = kitchen(clean="a"), Notes(decline="Fill(a)")
    result = plan_f(world, model(world), GOAL, listener=notes)
    assert result.end is End.STOPPED
    assert result.reason == "Fill(a) was declined"
    assert "start Unlid(a)" in notes.heard and "start Fill(a)" not in notes.heard
    assert notes.heard[-1] == "over: stopped"


AFFORDANCES = {"Fill": Affordance("Clean", 0)}


def test_after_a_failure_the_atom_it_relied_on_is_distrusted_until_restored() -> None:
    # The cup looks clean and is not: filling fails until it was wiped.
    world, notes, wiped = kitchen(open="a", clean="a"), Notes(), []

    def wipe(cup: Object) -> Callable[[State], State]:
        wiped.append(cup)
        return nothing(cup)

    def fill(cup: Object) -> Callable[[State], State]:
        return setting("full")(cup) if wiped else nothing(cup)

    done = Outcome(Ending.DONE)
    blind = model(world, Fill=(fill, done), Wipe=(wipe, done))
    assert plan_f(world, blind, GOAL, ExecuteSettings(max_failures=2)).end is End.STUCK
    wary = model(world, Fill=(fill, done), Wipe=(wipe, done), affordances=AFFORDANCES)
    result = plan_f(world, wary, GOAL, ExecuteSettings(max_failures=2), notes)
    assert result.success
    assert notes.plans == ["Fill(a)", "Wipe(a), Fill(a)"]
    assert notes.seen[-1][CLEAN(A)] == 1.0


def test_distrust_concerns_the_object_that_failed_only() -> None:
    world, notes = kitchen(open="ab", clean="ab"), Notes()

    def only_b(cup: Object) -> Callable[[State], State]:
        return setting("full")(cup) if cup == B else nothing(cup)

    goal = frozenset({FULL(A), FULL(B)})
    fills = model(world, Fill=(only_b, Outcome(Ending.DONE)), affordances=AFFORDANCES)
    plan_f(world, fills, goal, ExecuteSettings(max_failures=2), notes)
    assert not any("Wipe(b)" in plan for plan in notes.plans)
    assert any("Wipe(a)" in plan for plan in notes.plans)


def test_doubt_that_leaves_no_plan_is_dropped_and_the_skill_tried_again() -> None:
    world, notes, tries = kitchen(open="a", clean="a"), Notes(), []

    def fills_the_second_time(cup: Object) -> Callable[[State], State]:
        tries.append(1)
        return setting("full")(cup) if len(tries) > 1 else nothing(cup)

    fills = (fills_the_second_time, Outcome(Ending.DONE))
    without_wiping = model(world, Fill=fills, operators=(UNLID, FILL), affordances=AFFORDANCES)
    result = plan_f(world, without_wiping, GOAL, listener=notes)
    assert result.success
    assert notes.reasons == ["start", "nothing else is left to try than to believe what is most likely"]


@dataclass
class Murky(Kitchen):
    """A kitchen in which nobody sees well how clean the first cup is."""

    def perceive(self) -> State:
        seen = self.state.with_features(A, clean=0.6 if self.state.get(A, "full")[0] < 0.5 else 1.0)
        return State({cup: seen[cup] for cup in seen}, {A: np.diag([0.0, 0.0, 0.25**2])})


def test_where_doubt_leaves_no_plan_the_likelier_atoms_are_planned_with() -> None:
    world, notes = Murky(kitchen(open="a").state), Notes()
    sure = model(world, operators=(UNLID, FILL))
    doubting = DoubtingAbstraction(sure.abstraction)
    assert CLEAN(A) in doubting.doubtful(world.perceive())
    unsure = Model(sure.skills, doubting, sure.operators)
    result = plan_f(world, unsure, GOAL, listener=notes)
    assert result.success and result.reason == ""
    assert notes.reasons == ["nothing else is left to try than to believe what is most likely"]
    # Where something can be done about it, that comes first.
    wiping, notes = Model(sure.skills, doubting, (UNLID, FILL, WIPE)), Notes()
    plan_f(Murky(kitchen(open="a").state), wiping, GOAL, ExecuteSettings(max_skills=1), notes)
    assert notes.plans[0] == "Wipe(a), Fill(a)"


def test_a_likely_goal_that_nothing_can_make_surer_says_so() -> None:
    world = Murky(kitchen().state)
    result = plan_f(world, Model({}, DoubtingAbstraction(model(world).abstraction), ()), frozenset({CLEAN(A)}))
    assert result.success and "not all of it is certain" in result.reason
    result = plan_f(world, Model({}, DoubtingAbstraction(model(world).abstraction), ()), frozenset({OPEN(A)}))
    assert result.end is End.NO_PLAN


def test_a_reaction_is_asked_after_a_failure_and_its_skill_is_run() -> None:
    world, asked = kitchen(open="a", clean="a"), []

    def fill(cup: Object) -> Callable[[State], State]:
        return lambda state: state.with_features(cup, full=float(state.get(B, "clean")[0]))

    known = model(world, Fill=(fill, Outcome(Ending.DONE)))

    def react(failed: GroundSkill, state: State) -> GroundSkill | None:
        asked.append((str(failed), state))
        return known.skill("Wipe").ground((B,))

    result = plan_f(world, known, GOAL, reaction=react)
    assert result.success
    assert [str(a) for a, _ in asked] == ["Fill(a)"]
    assert [(t.skill, t.objects, t.succeeded) for t in result.transitions] == [
        ("Fill", (A,), False),
        ("Wipe", (B,), True),
        ("Fill", (A,), True),
    ]
    assert result.transitions[1].before == asked[0][1]


def test_a_reaction_may_decline() -> None:
    world = kitchen(open="a", clean="a")
    known = model(world, Fill=(nothing, Outcome(Ending.BLOCKED)))
    result = plan_f(world, known, GOAL, reaction=lambda failed, state: None)
    assert result.end is End.STUCK
    assert {t.skill for t in result.transitions} == {"Fill"}


def test_a_skill_that_never_ends_is_stopped_at_its_time_limit() -> None:
    world = kitchen()
    ground = model(world, Wipe=(nothing, None)).skill("Wipe").ground((A,))
    outcome = run_skill(world, ground)
    assert outcome.ending is Ending.TIMEOUT and not outcome.done
    assert 2.0 < world.time < 2.3


@pytest.mark.parametrize(("outcome", "ending"), [(Outcome(Ending.DONE), Ending.DONE), (None, Ending.TIMEOUT)])
def test_the_limit_counts_control_steps_whatever_the_pace(outcome: Outcome | None, ending: Ending) -> None:
    """At 2.5 % of full speed, as in a first run with the slider at 10 %, two steps of 0.1 s take 8 s."""
    world = kitchen()
    world.pace = 0.025
    policy = Toy(world, nothing(A), outcome)
    skill = Skill("Wipe", (CUP,), lambda objects, first: policy, 10.0, 2.0)
    assert run_skill(world, skill.ground((A,))).ending is ending
    assert policy.steps == (3 if outcome else 21)


def test_a_skill_gets_its_rate_its_effort_and_live_poses_and_gives_the_effort_back() -> None:
    world = kitchen()

    def start(objects: tuple[Object, ...], first: Observation) -> Toy:
        return Toy(world, setting("clean")(objects[0]), Outcome(Ending.DONE))

    skill = Skill("Wipe", (CUP,), start, 50.0, 2.0, live_state=True, effort_limit=LIMIT)
    assert run_skill(world, skill.ground((A,))).done
    assert (world.log[0], world.log[-1]) == (f"limit {LIMIT}", "limit None")
    assert {line for line in world.log if line.startswith("observe")} == {"observe live=True"}
    assert {line for line in world.log if line.startswith("act")} == {"act 0.02"}
    assert world.state.get(A, "clean")[0] == 1.0


def test_an_operator_without_a_skill_is_named() -> None:
    world = kitchen()
    whole = model(world)
    without = Model({k: s for k, s in whole.skills.items() if k != "Wipe"}, whole.abstraction, whole.operators)
    with pytest.raises(UnknownNameError, match="Wipe"):
        plan_f(world, without, frozenset({CLEAN(A)}))


def test_a_result_keeps_every_plan() -> None:
    world = kitchen(open="a", clean="a")
    result = plan_f(world, model(world, Fill=(nothing, Outcome(Ending.DONE))), GOAL, ExecuteSettings(max_failures=3))
    assert len(result.plans) == 3
    assert all(str(p) == "Fill(a)" for p in result.plans)
