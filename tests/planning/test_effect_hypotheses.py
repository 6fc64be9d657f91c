"""A step may end a relation that no operator speaks of: what is supposed then, and what is not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core.errors import PlanningError
from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Atoms, Object, Operator, Predicate, Variable
from resync_robot.core.vocabulary import BLOCK
from resync_robot.planning.abstract import Abstraction, Exists, ForAll, Not
from resync_robot.planning.effect_hypotheses import check_goal, plan_or_suppose
from resync_robot.planning.execute import EpisodeEnd, ExecuteSettings, Model, plan_and_execute
from resync_robot.planning.search import ground_all
from tests.planning.kitchen import CUP, A, B, Kitchen, Notes, Toy, kitchen
from tests.planning.models import BLOCKS, HAND_EMPTY, HOLDING, ON, PICK, PREDICATES, RECOVER, ROBOT_0, scene

COVERED = Exists(ON, (0,))
BARE = Not(COVERED.predicate)
_r, _b0, _b1 = PICK.parameters[0], Variable("?b0", BLOCK), Variable("?b1", BLOCK)
INSERT = Operator(
    "Insert",
    (_r, _b0, _b1),
    frozenset({HOLDING(_r, _b0), BARE.predicate(_b1)}),
    frozenset({ON(_b0, _b1), HAND_EMPTY(_r), COVERED.predicate(_b1)}),
    frozenset({HOLDING(_r, _b0), BARE.predicate(_b1)}),
)
OPERATORS = (PICK, INSERT, RECOVER)
B0, B1, B2, B3 = BLOCKS


def never(_state: State, _objects: tuple[Object, ...]) -> float:
    return 0.0


ABSTRACTION = Abstraction(
    (*PREDICATES, COVERED.predicate, BARE.predicate),
    {p.name: never for p in PREDICATES} | {COVERED.predicate.name: COVERED, BARE.predicate.name: BARE},
)


def stacked(*pairs: tuple[Object, Object]) -> tuple[list[Object], Atoms]:
    """Three free blocks, an empty hand, the first of each pair on the second."""
    objects, atoms = scene(3, set())
    return objects, ABSTRACTION.derive(atoms | {ON(a, b) for a, b in pairs}, objects)


def test_what_lies_on_the_wrong_base_is_lifted_off_though_no_operator_says_that_this_bares_it() -> None:
    objects, atoms = stacked((B2, B0))
    goal = frozenset({ON(B1, B0), ON(B2, B1)})
    found, supposed = plan_or_suppose(OPERATORS, ABSTRACTION, objects, atoms, goal)
    assert found.atoms == atoms and not found.reaches(goal), "not by the operators as they are"
    assert [str(s) for s in found.steps][:2] == ["Pick(robot, b2)", "Insert(robot, b2, b1)"]
    assert supposed == "Pick(robot, b2) ends On"


def test_a_goal_out_of_reach_names_the_atoms_that_cannot_be_had_together() -> None:
    objects, atoms = stacked()
    check_goal(OPERATORS, ABSTRACTION, objects, atoms, frozenset({ON(B1, B0), ON(B2, B1)}))
    with pytest.raises(PlanningError, match=r"reaches On\(b1, b0\) and On\(b2, b0\) together, and one reaches any"):
        check_goal(OPERATORS, ABSTRACTION, objects, atoms, frozenset({ON(B1, B0), ON(B2, B0), ON(B0, B3)}))
    with pytest.raises(PlanningError, match=r"reaches HandEmpty\(robot\) and Holding\(robot, b1\) together"):
        both = {HOLDING(ROBOT_0, B1), HAND_EMPTY(ROBOT_0)}
        check_goal(OPERATORS, ABSTRACTION, objects, atoms, frozenset({*both, ON(B2, B0)}))
    unreachable = Predicate("Painted", (BLOCK,))(B0)
    with pytest.raises(PlanningError, match=r"nothing achieves Painted\(b0\)"):
        check_goal(OPERATORS, ABSTRACTION, objects, atoms, frozenset({unreachable, ON(B1, B0)}))


def test_nothing_is_supposed_where_a_plan_exists() -> None:
    objects, atoms = stacked()
    found, supposed = plan_or_suppose(OPERATORS, ABSTRACTION, objects, atoms, frozenset({ON(B1, B0)}))
    assert supposed == "" and len(found.steps) == 2
    assert found.reaches(frozenset({ON(B1, B0)})) and not found.reaches(frozenset({ON(B0, B1)}))


def test_a_goal_that_no_supposition_reaches_is_out_of_reach() -> None:
    objects, atoms = stacked((B2, B0))
    lifted = Predicate("Lifted", (BLOCK,))
    with pytest.raises(PlanningError, match="nothing achieves"):
        plan_or_suppose(OPERATORS, ABSTRACTION, objects, atoms, frozenset({lifted(B0)}))


def test_the_shortest_way_on_is_taken_and_another_once_that_is_disproved() -> None:
    objects, atoms = stacked((B1, B0))
    goal = frozenset({ON(B2, B0)})
    disproved: set[str] = set()
    lengths = []
    for _ in range(2):
        found, supposed = plan_or_suppose(OPERATORS, ABSTRACTION, objects, atoms, goal, disproved=disproved)
        assert found.steps[0].applicable(atoms) and supposed not in disproved
        disproved.add(supposed)
        lengths.append(len(found.steps))
    assert lengths == sorted(lengths)
    disproved |= {f"{step} ends On" for step in ground_all(OPERATORS, objects)}
    with pytest.raises(PlanningError):
        plan_or_suppose(OPERATORS, ABSTRACTION, objects, atoms, goal, disproved=disproved)


@given(st.sets(st.tuples(st.sampled_from(BLOCKS), st.sampled_from(BLOCKS)).filter(lambda p: p[0] != p[1])))
def test_deriving_from_atoms_agrees_with_deriving_from_the_state(pairs: set[tuple[Object, Object]]) -> None:
    objects, _ = scene(4, set())

    def on(_state: State, args: tuple[Object, ...]) -> float:
        return float(args in pairs)

    everything = ForAll(ON, (0, 1))
    predicates = (ON, COVERED.predicate, BARE.predicate, everything.predicate)
    abstraction = Abstraction(
        predicates,
        {"On": on, COVERED.predicate.name: COVERED, BARE.predicate.name: BARE, everything.predicate.name: everything},
    )
    state = State({o: np.zeros(len(o.type.features)) for o in objects})
    atoms = abstraction.true_atoms(state)
    basic = frozenset(a for a in atoms if a.predicate == ON)
    assert abstraction.derive(basic, objects) == atoms
    # What was derived from other atoms before does not linger.
    assert abstraction.derive(basic | {COVERED.predicate(b) for b in BLOCKS}, objects) == atoms


def test_a_predicate_whose_base_is_not_grounded_keeps_its_atoms() -> None:
    objects, _ = scene(2, set())
    abstraction = Abstraction((COVERED.predicate,), {"On": never, COVERED.predicate.name: COVERED})
    kept = frozenset({Atom(COVERED.predicate, (B0,))})
    assert abstraction.derive(kept, objects) == kept


def test_the_hand_is_no_outsider_of_what_it_holds() -> None:
    objects, atoms = stacked((B2, B0))
    _, supposed = plan_or_suppose(OPERATORS, ABSTRACTION, objects, atoms, frozenset({ON(B1, B0), ON(B2, B1)}))
    assert ROBOT_0.name in supposed and "Holding" not in supposed


# -- in the loop, with cups --------------------------------------------------------------------------------------------

X, Y = Variable("?x", CUP), Variable("?y", CUP)
ON_CUP, HELD, EMPTY = Predicate("OnCup", (CUP, CUP)), Predicate("Held", (CUP,)), Predicate("Empty", ())
LIDDED = Exists(ON_CUP, (0,))
CLEAR = Not(LIDDED.predicate)
TAKE = Operator("Take", (X,), frozenset({EMPTY(), CLEAR.predicate(X)}), frozenset({HELD(X)}), frozenset({EMPTY()}))
PUT = Operator("Put", (X,), frozenset({HELD(X)}), frozenset({EMPTY()}), frozenset({HELD(X)}))
STACK = Operator(
    "Stack",
    (X, Y),
    frozenset({HELD(X), CLEAR.predicate(Y)}),
    frozenset({ON_CUP(X, Y), EMPTY(), LIDDED.predicate(Y)}),
    frozenset({HELD(X), CLEAR.predicate(Y)}),
)


def cups(world: Kitchen) -> Model:
    """Two cups: `open` means that the other one is on it, `full` that it is in the hand."""
    change = {
        "Take": lambda o: lambda s: s.with_features(o[0], full=1.0).with_features(B if o[0] == A else A, open=0.0),
        "Put": lambda o: lambda s: s.with_features(o[0], full=0.0),
        "Stack": lambda o: lambda s: s.with_features(o[0], full=0.0).with_features(o[1], open=1.0),
    }

    def skill(name: str, count: int) -> Skill:
        done = SkillOutcome(SkillEnd.DONE)
        return Skill(name, (CUP,) * count, lambda objects, first: Toy(world, change[name](objects), done), 10.0, 2.0)

    classifiers = {
        "OnCup": lambda state, objects: float(state.get(objects[1], "open")[0]),
        "Held": lambda state, objects: float(state.get(objects[0], "full")[0]),
        "Empty": lambda state, objects: 1.0 - max(float(state.get(c, "full")[0]) for c in (A, B)),
        LIDDED.predicate.name: LIDDED,
        CLEAR.predicate.name: CLEAR,
    }
    predicates = (ON_CUP, HELD, EMPTY, LIDDED.predicate, CLEAR.predicate)
    skills = {name: skill(name, count) for name, count in (("Take", 1), ("Put", 1), ("Stack", 2))}
    return Model(skills, Abstraction(predicates, classifiers), (TAKE, PUT, STACK))


def test_the_last_resort_swaps_two_cups_and_can_be_switched_off() -> None:
    """No operator says that taking a cup off another one clears that."""
    goal = frozenset({ON_CUP(B, A)})
    world, notes = kitchen(open="b"), Notes()
    result = plan_and_execute(world, cups(world), goal, listener=notes)
    assert result.success and notes.plans == ["Take(a), Put(a), Take(b), Stack(b, a)"]
    assert notes.reasons == ["start; no plan otherwise, perhaps Take(a) ends OnCup"]
    world = kitchen(open="b")
    refused = plan_and_execute(world, cups(world), goal, ExecuteSettings(suppose=False))
    assert refused.end is EpisodeEnd.NO_PLAN and not refused.transitions
