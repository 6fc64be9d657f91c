from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core.state import State
from resync_robot.core.symbols import Atoms, Operator, Predicate, Variable
from resync_robot.core.vocabulary import BLOCK, ROBOT
from resync_robot.learning.dataset import Dataset, Run, Step
from resync_robot.learning.operators import (
    MIN_EXPLAINED,
    Column,
    OperatorConfig,
    learn_operator,
    lifted_atoms,
    swept,
)

R, B0, B1 = Variable("?r", ROBOT), Variable("?b0", BLOCK), Variable("?b1", BLOCK)
EMPTY, FREE, WET = Predicate("Empty", (ROBOT,)), Predicate("Free", (BLOCK,)), Predicate("Wet", (BLOCK,))
PAIR, HOLDS = Predicate("Pair", (BLOCK, BLOCK)), Predicate("Holds", (ROBOT, BLOCK))


def column(atom, before, after=None, failed=(), learned=True, stage=None) -> Column:
    as_bool = [np.array(v, dtype=bool) for v in (before, before if after is None else after, failed)]
    return Column(atom, *as_bool, learned, np.array([1] * len(failed) if stage is None else stage, dtype=int))


def test_atoms_over_distinct_parameters() -> None:
    assert lifted_atoms(FREE, (R, B0, B1)) == [FREE(B0), FREE(B1)]
    assert lifted_atoms(PAIR, (R, B0, B1)) == [PAIR(B0, B1), PAIR(B1, B0)]
    assert lifted_atoms(PAIR, (R, B0)) == []
    assert lifted_atoms(Predicate("Day", ()), (R, B0)) == [Predicate("Day", ())()]


def test_effects_are_those_of_the_largest_cluster() -> None:
    columns = [
        column(EMPTY(R), [1] * 10, [0] * 10, learned=False),
        column(FREE(B0), [0] * 9 + [1], [1] * 10, learned=False),
    ]
    op = learn_operator("Op", (R, B0), columns, OperatorConfig())
    assert op is not None
    assert (op.add, op.delete, op.preconditions) == ({FREE(B0)}, {EMPTY(R)}, {EMPTY(R)})


def test_what_held_already_is_achieved_as_well() -> None:
    """Where it was so before nothing changes; of the rest most show what the skill does."""
    free = column(FREE(B0), [0] * 5 + [1] * 3 + [0] * 4, [1] * 5 + [1] * 3 + [0] * 4, learned=False)
    op = learn_operator("Op", (R, B0), [free], OperatorConfig())
    assert op is not None and op.add == {FREE(B0)}
    published = learn_operator("Op", (R, B0), [free], OperatorConfig(least_cluster=1.0))
    assert published is not None and published.add == frozenset(), "the largest cluster changes nothing"
    # That one of many gained it by chance does not make it an effect, though it held after all of them.
    wet = column(WET(B0), [0] + [1] * 19, [1] * 20, learned=False)
    op = learn_operator("Op", (R, B0), [wet], OperatorConfig())
    assert op is not None and op.add == frozenset()


def test_a_condition_must_have_held_before_most_successes() -> None:
    columns = [column(EMPTY(R), [1] * 8 + [0] * 2, learned=False), column(FREE(B0), [1] * 7 + [0] * 3, learned=False)]
    op = learn_operator("Op", (R, B0), columns, OperatorConfig())
    assert op is not None and op.preconditions == {EMPTY(R)}


def test_a_learned_condition_must_tell_failures_from_successes() -> None:
    successes = [1] * 20
    free = column(FREE(B0), [1] * 19 + [0], failed=[0] * 9 + [1])
    always = column(WET(B0), successes, failed=[1] * 10)
    default = learn_operator("Op", (R, B0), [free, always], OperatorConfig())
    published = learn_operator("Op", (R, B0), [free, always], OperatorConfig(use_failures=False))
    assert default is not None and default.preconditions == {FREE(B0)}
    assert published is not None and published.preconditions == {FREE(B0), WET(B0)}
    # Without failures nothing learned is shown to matter.
    unfailing = learn_operator("Op", (R, B0), [column(FREE(B0), successes)], OperatorConfig())
    assert unfailing is not None and unfailing.preconditions == frozenset()


def test_a_second_condition_must_explain_what_the_first_does_not() -> None:
    free = column(FREE(B0), [1] * 20, failed=[0] * 8 + [1] * 5)
    same = column(WET(B0), [1] * 20, failed=[0] * 7 + [1] * 6)
    other = column(FREE(B1), [1] * 20, failed=[1] * 8 + [0] * 5)
    op = learn_operator("Op", (R, B0, B1), [same, free, other], OperatorConfig())
    assert op is not None and op.preconditions == {FREE(B0), FREE(B1)}


@pytest.mark.parametrize("handful", range(1, MIN_EXPLAINED + 1))
def test_a_handful_of_failures_makes_no_condition(handful: int) -> None:
    """Two towers that broke had a third block on them, and nobody had ever tried to lift three."""
    free = column(FREE(B0), [1] * 300, failed=[0] * handful)
    op = learn_operator("Op", (R, B0), [free], OperatorConfig())
    assert op is not None and bool(op.preconditions) is (handful >= MIN_EXPLAINED)


def test_each_stage_has_failures_of_its_own_to_explain() -> None:
    """Three causes, a third of all failures each: none rules out half of them, and each is a condition all the same."""
    stage, pair = [1] * 10 + [2] * 10 + [3] * 10, PAIR(B0, B1)
    columns = [
        column(atom, [1] * 20, failed=[int(n != number) for n in stage], stage=stage)
        for number, atom in enumerate((FREE(B0), WET(B0), pair), start=1)
    ]
    op = learn_operator("Op", (R, B0, B1), columns, OperatorConfig())
    assert op is not None and op.preconditions == {FREE(B0), WET(B0), pair}


def pushes(held_after: list[bool]) -> tuple[Dataset, list[Atoms]]:
    """Successes of Push(r, b0) while something else is held, which is so afterwards or is not."""
    robot, blocks = ROBOT("r"), (BLOCK("b0"), BLOCK("b1"))
    held = HOLDS(robot, blocks[1])
    steps = tuple(Step("Push", (robot, blocks[0]), 2 * i, 2 * i + 1) for i in range(len(held_after)))
    run = Run(steps, (), 0, frozenset({held}), True, "dream", (robot, *blocks), 1)
    truth = [frozenset({held} if now else ()) for after in held_after for now in (True, after)]
    state = State({})
    return Dataset((state,) * len(truth), ((0,),) * len(truth), (run,), {"Push": (ROBOT, BLOCK)}), truth


@pytest.mark.parametrize(
    ("held_after", "ends"),
    [
        ([False] * 3, True),
        ([False] * 2, False),
        ([False] * 5 + [True], True),
        ([False] * 4 + [True], False),
        ([True, True, False] * 6, False),
        ([True, False, False] * 6, True),
    ],
)
def test_a_skill_ends_of_every_object_what_its_successes_surely_end_mostly(held_after: list[bool], ends: bool) -> None:
    dataset, truth = pushes(held_after)
    found = swept(dataset, truth, [HOLDS, PAIR], {"Push": (R, B0)})["Push"]
    other = Variable("?any1", BLOCK)
    assert found == (frozenset({HOLDS(R, other)}) if ends else frozenset())


def test_what_a_skill_ends_of_what_it_names_is_no_effect_on_everything() -> None:
    dataset, _ = pushes([False] * 6)
    robot, named = ROBOT("r"), BLOCK("b0")
    truth = [frozenset({HOLDS(robot, named)} if i % 2 == 0 else ()) for i in range(12)]
    assert swept(dataset, truth, [HOLDS], {"Push": (R, B0)})["Push"] == frozenset()


def test_what_a_skill_adds_is_no_exception_to_what_it_ends_of_all_others() -> None:
    """A hand that goes to a block is ready for that one, whatever it was ready for before."""
    robot, blocks = ROBOT("r"), (BLOCK("b0"), BLOCK("b1"))
    named, other = (HOLDS(robot, b) for b in blocks)
    steps = tuple(Step("Push", (robot, blocks[0]), 2 * i, 2 * i + 1) for i in range(12))
    run = Run(steps, (), 0, frozenset({named}), True, "dream", (robot, *blocks), 1)
    truth = [frozenset({other if i % 2 else named}) if now else frozenset({named}) for i in range(12) for now in (1, 0)]
    dataset = Dataset((State({}),) * 24, ((0,),) * 24, (run,), {"Push": (ROBOT, BLOCK)})
    assert swept(dataset, truth, [HOLDS], {"Push": (R, B0)})["Push"] == {HOLDS(R, Variable("?any1", BLOCK))}


def test_what_only_ever_went_before_is_not_needed_unless_it_was_said_or_failures_say_so() -> None:
    """A drawer that was always opened after the lid was off does not need that."""
    said = Operator("Op", (R, B0), frozenset({EMPTY(R)}), frozenset(), frozenset())
    empty = column(EMPTY(R), [1] * 10, [0] * 10, [1] * 8, learned=False)
    dry, telling = (column(FREE(B0), [1] * 10, failed=failed, learned=False) for failed in ([1] * 8, [0] * 8))
    for free, needed in ((dry, {EMPTY(R)}), (telling, {EMPTY(R), FREE(B0)})):
        op = learn_operator("Op", (R, B0), [empty, free], OperatorConfig(), said)
        assert op is not None and op.preconditions == needed
    # Of a recovery nothing was said, and the published formulation asks no failures.
    for config, before in ((OperatorConfig(), None), (OperatorConfig(use_failures=False), said)):
        op = learn_operator("Op", (R, B0), [empty, dry], config, before)
        assert op is not None and op.preconditions == {EMPTY(R), FREE(B0)}


def test_a_skill_that_never_succeeded_has_no_operator() -> None:
    assert learn_operator("Op", (R, B0), [column(FREE(B0), [], failed=[1, 1])], OperatorConfig()) is None
