"""A given sequence is run in order, once, as far as its skills do what they should; the goal decides in the end."""

from __future__ import annotations

import pytest

from resync_robot.baselines.human_sequence import Expert, run_human_sequence
from resync_robot.core.errors import UnknownNameError
from resync_robot.core.skill import SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Atoms
from resync_robot.planning.execute import EpisodeEnd
from tests.planning.kitchen import FULL, A, B, Kitchen, Notes, kitchen, model, nothing, setting

GOAL = frozenset({FULL(A)})
BLOCKED = SkillOutcome(SkillEnd.BLOCKED, "a wall")


def says(*names: str) -> Expert:
    """An expert who names these skills, all of cup a."""
    return lambda state, goal: tuple((name, (A,)) for name in names)


def test_every_skill_is_run_once_in_order_with_a_look_before_and_after_each() -> None:
    world, notes = kitchen(), Notes()
    result = run_human_sequence(world, model(world), GOAL, says("Unlid", "Wipe", "Fill"), notes)
    assert (result.end, result.reason, result.plans) == (EpisodeEnd.GOAL, "", ())
    assert [h for h in notes.heard if h != "control"] == [
        "perceived",
        *("start Unlid(a)", "end Unlid(a) done", "perceived"),
        *("start Wipe(a)", "end Wipe(a) done", "perceived"),
        *("start Fill(a)", "end Fill(a) done", "perceived"),
        "over: goal",
    ]
    assert [(t.skill, t.objects, t.succeeded) for t in result.transitions] == [
        (name, (A,), True) for name in ("Unlid", "Wipe", "Fill")
    ]
    assert all(t.after == u.before for t, u in zip(result.transitions, result.transitions[1:], strict=False))
    assert result.final == result.transitions[-1].after == world.state


def test_a_skill_that_is_not_done_ends_the_episode() -> None:
    world, notes = kitchen(), Notes()
    result = run_human_sequence(
        world, model(world, Wipe=(nothing, BLOCKED)), GOAL, says("Unlid", "Wipe", "Fill"), notes
    )
    assert (result.end, result.success) == (EpisodeEnd.STUCK, False)
    assert result.reason == "Wipe(a) did not do what it should (blocked: a wall)"
    assert [(t.skill, t.succeeded) for t in result.transitions] == [("Unlid", True), ("Wipe", False)]
    assert notes.heard[-2:] == ["perceived", "over: stuck"]


@pytest.mark.parametrize("names", [(), ("Unlid",), ("Wipe", "Unlid")])
def test_a_sequence_that_ends_short_of_the_goal_fails(names: tuple[str, ...]) -> None:
    world = kitchen()
    result = run_human_sequence(world, model(world), GOAL, says(*names))
    assert (result.end, result.reason) == (EpisodeEnd.STUCK, "the sequence ended short of the goal")
    assert len(result.transitions) == len(names)


def test_what_holds_in_the_end_decides_as_it_does_for_a_planner() -> None:
    world = kitchen(open="a", clean="a")
    # Full, though the hand was held up on its way back.
    result = run_human_sequence(world, model(world, Fill=(setting("full"), BLOCKED)), GOAL, says("Fill"))
    assert (result.end, result.reason) == (EpisodeEnd.GOAL, "")
    assert not result.transitions[0].succeeded


def test_a_skill_is_not_tried_again_where_its_effect_is_missing() -> None:
    world = kitchen(open="a", clean="a")
    fills = model(world, Fill=(nothing, SkillOutcome(SkillEnd.DONE)))
    result = run_human_sequence(world, fills, GOAL, says("Fill"))
    assert result.end is EpisodeEnd.STUCK
    assert len(result.transitions) == 1


def test_the_expert_is_asked_once_about_what_is_perceived_first() -> None:
    class Misty(Kitchen):
        """Its cups look open."""

        def perceive(self) -> State:
            return self.state.with_features(A, open=1.0)

    asked: list[tuple[State, Atoms]] = []

    def expert(state: State, goal: Atoms) -> tuple[tuple[str, tuple], ...]:
        asked.append((state, goal))
        return (("Wipe", (B,)), ("Fill", (A,)))

    world = Misty(kitchen().state)
    assert run_human_sequence(world, model(world), GOAL, expert).success
    ((state, goal),) = asked
    assert goal == GOAL
    assert state.get(A, "open")[0] == 1.0 and state.get(B, "clean")[0] == 0.0


def test_a_skill_that_the_model_lacks_is_named() -> None:
    world = kitchen()
    with pytest.raises(UnknownNameError, match="Juggle"):
        run_human_sequence(world, model(world), GOAL, says("Juggle"))
