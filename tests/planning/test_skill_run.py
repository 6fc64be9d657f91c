"""One skill at a time, with a robot on paper: how long it may take, what it is given, and how often it is looked at."""

from __future__ import annotations

import pytest

from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.symbols import Object
from resync_robot.core.world import Observation
from resync_robot.planning.skill_run import LOOKS, looks, run_skill
from tests.planning.kitchen import CUP, LIMIT, A, Toy, kitchen, model, nothing, setting


def test_a_skill_that_never_ends_is_stopped_at_its_time_limit() -> None:
    world = kitchen()
    ground = model(world, Wipe=(nothing, None)).skill("Wipe").ground((A,))
    outcome = run_skill(world, ground)
    assert outcome.ending is SkillEnd.TIMEOUT and not outcome.done
    assert 2.0 < world.time < 2.3


@pytest.mark.parametrize(
    ("outcome", "ending"), [(SkillOutcome(SkillEnd.DONE), SkillEnd.DONE), (None, SkillEnd.TIMEOUT)]
)
def test_the_limit_counts_control_steps_whatever_the_pace(outcome: SkillOutcome | None, ending: SkillEnd) -> None:
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
        return Toy(world, setting("clean")(objects[0]), SkillOutcome(SkillEnd.DONE))

    skill = Skill("Wipe", (CUP,), start, 50.0, 2.0, live_state=True, effort_limit=LIMIT)
    assert run_skill(world, skill.ground((A,))).done
    assert (world.log[0], world.log[-1]) == (f"limit {LIMIT}", "limit None")
    assert {line for line in world.log if line.startswith("observe")} == {"observe live=True"}
    assert {line for line in world.log if line.startswith("act")} == {"act 0.02"}
    assert world.state.get(A, "clean")[0] == 1.0


@pytest.mark.parametrize(("says", "most"), [(SkillEnd.DONE, LOOKS), (SkillEnd.BLOCKED, 1), (SkillEnd.TIMEOUT, 1)])
def test_only_what_says_that_it_is_done_is_looked_at_again(says: SkillEnd, most: int) -> None:
    assert list(looks(kitchen(), SkillOutcome(says))) == [kitchen().state] * most
