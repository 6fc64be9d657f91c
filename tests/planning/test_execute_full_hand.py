"""The executive with a full hand: what is held is put down where that helps, and the plan after it works again."""

from __future__ import annotations

from collections.abc import Callable

from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Object, Operator, Predicate, Variable
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.execute import EpisodeEnd, ExecuteSettings, Model, begin_after, plan_and_execute
from resync_robot.planning.search import plan
from tests.planning.kitchen import CUP, A, B, Kitchen, Notes, Toy, kitchen

HELD, READY, STACKED, EMPTY = (
    Predicate(n, (CUP,) * k) for n, k in (("Held", 1), ("Ready", 1), ("On", 2), ("Empty", 0))
)
X, Y = Variable("?x", CUP), Variable("?y", CUP)
"""Cups as the kitchen has them: `full` means held, `clean` means ready, `open` means that the other one is on it."""

TAKE = Operator("Take", (X,), frozenset({EMPTY(), READY(X)}), frozenset({HELD(X)}), frozenset({EMPTY()}))
STACK = Operator(
    "Stack", (X, Y), frozenset({HELD(X), READY(Y)}), frozenset({STACKED(X, Y), EMPTY()}), frozenset({HELD(X)})
)
FREE = Operator("Free", (X,), frozenset({EMPTY()}), frozenset({READY(X)}))
PUT = Operator("Put", (X,), frozenset({HELD(X)}), frozenset({EMPTY()}), frozenset({HELD(X)}))
GOAL = frozenset({STACKED(A, B)})
Change = Callable[[Kitchen, tuple[Object, ...]], Callable[[State], State]]


def features(cup: int, **values: float) -> Change:
    return lambda world, objects: lambda state: state.with_features(objects[cup], **values)


def stacking(world: Kitchen, objects: tuple[Object, ...]) -> Callable[[State], State]:
    """It works on a base that is truly free; otherwise the cup stays in the hand."""
    held, base = objects
    if world.state.get(base, "clean")[0] < 0.5:
        return lambda state: state
    return lambda state: state.with_features(held, full=0.0).with_features(base, open=1.0)


def model(world: Kitchen, freeing: Change, put: bool = True) -> Model:
    does: dict[str, tuple[int, Change]] = {
        "Take": (1, features(0, full=1.0)),
        "Stack": (2, stacking),
        "Free": (1, freeing),
        "Put": (1, features(0, full=0.0)),
    }

    def skill(name: str) -> Skill:
        arity, change = does[name]
        return Skill(
            name,
            (CUP,) * arity,
            lambda objects, first: Toy(world, change(world, objects), SkillOutcome(SkillEnd.DONE)),
            10.0,
            2.0,
        )

    classifiers = {
        "Held": lambda state, objects: float(state.get(objects[0], "full")[0]),
        "Ready": lambda state, objects: float(state.get(objects[0], "clean")[0]),
        "On": lambda state, objects: float(state.get(objects[1], "open")[0]),
        "Empty": lambda state, objects: 1.0 - max(float(state.get(c, "full")[0]) for c in (A, B)),
    }
    operators = (TAKE, STACK, FREE, PUT) if put else (TAKE, STACK, FREE)
    abstraction = Abstraction((HELD, READY, STACKED, EMPTY), classifiers)
    return Model({name: skill(name) for name in does}, abstraction, operators, {"Ready": None})


def skills(result) -> list[str]:  # type: ignore[no-untyped-def]
    return [f"{t.skill}({', '.join(o.name for o in t.objects)})" for t in result.transitions]


def test_a_full_hand_and_a_blocked_base_have_a_plan() -> None:
    held_over_a_blocked_base = kitchen(full="a", clean="a")
    known = model(held_over_a_blocked_base, features(0, clean=1.0))
    atoms = known.abstraction.true_atoms(held_over_a_blocked_base.state)
    assert str(plan(known.operators, (A, B), atoms, GOAL)) == "Put(a), Free(b), Take(a), Stack(a, b)"
    result = plan_and_execute(held_over_a_blocked_base, known, GOAL)
    assert result.success and len(result.plans) == 1
    held_over_a_free_base = kitchen(full="a", clean="ab")
    assert skills(
        plan_and_execute(held_over_a_free_base, model(held_over_a_free_base, features(0, clean=1.0)), GOAL)
    ) == ["Stack(a, b)"]


def freed_at_the_third_try(tries: list[int]) -> Change:
    def change(world: Kitchen, objects: tuple[Object, ...]) -> Callable[[State], State]:
        tries.append(1)
        return (lambda state: state.with_features(objects[0], clean=1.0)) if len(tries) > 2 else lambda state: state

    return change


def test_what_was_taken_on_trust_is_put_down_where_the_trust_was_wrong() -> None:
    """Free(b) is done twice in vain, so Ready(b) is believed; Stack shows that it is not so, with a full hand."""
    world, notes = kitchen(clean="a"), Notes()
    result = plan_and_execute(world, model(world, freed_at_the_third_try([])), GOAL, listener=notes)
    first = ["Free(b)", "Free(b)", "Take(a)", "Stack(a, b)"]
    assert skills(result) == [*first, "Put(a)", "Free(b)", "Take(a)", "Stack(a, b)"]
    assert result.success and notes.plans[-1] == "Put(a), Free(b), Take(a), Stack(a, b)"

    world = kitchen(clean="a")
    settings = ExecuteSettings(suppose=False)
    stuck = plan_and_execute(world, model(world, freed_at_the_third_try([]), put=False), GOAL, settings)
    assert not stuck.success and skills(stuck)[:4] == first, "without a way to put it down that was the end"


def test_a_base_that_nothing_frees_ends_the_episode() -> None:
    world = kitchen(clean="a")
    result = plan_and_execute(world, model(world, features(0, clean=0.0)), GOAL)
    assert result.end is EpisodeEnd.STUCK and "Stack(a, b)" in result.reason


def test_an_episode_begins_after_its_scenarios_skills() -> None:
    world, heard = kitchen(clean="ab"), Notes()
    known = model(world, features(0, clean=1.0))
    assert begin_after(world, known, (("Take", ("a",)),), (A, B), heard)
    assert [h for h in heard.heard if h.startswith(("start", "end"))] == ["start Take(a)", "end Take(a) done"]
    assert skills(plan_and_execute(world, known, GOAL)) == ["Stack(a, b)"]


def test_where_one_of_those_skills_fails_the_rest_is_not_run() -> None:
    world, heard = kitchen(clean="ab"), Notes()
    known = model(world, features(0, clean=1.0))
    refuse = Skill("Take", (CUP,), lambda o, f: Toy(world, lambda s: s, SkillOutcome(SkillEnd.REFUSED)), 10.0, 2.0)
    broken = Model({**known.skills, "Take": refuse}, known.abstraction, known.operators)
    assert not begin_after(world, broken, (("Take", ("a",)), ("Free", ("b",))), (A, B), heard)
    assert [h for h in heard.heard if h.startswith("start")] == ["start Take(a)"]
    assert begin_after(world, broken, (), (A, B), heard)
