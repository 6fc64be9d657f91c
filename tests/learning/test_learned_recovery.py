"""What a learned recovery does: the failed skill first, then the policy, until it is done or gives up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from resync_robot.core.errors import LibraryError
from resync_robot.core.library import Record
from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.learning.learned_recovery import PATIENCE, LearnedRecovery
from resync_robot.learning.recovery_policy import ActorCritic
from resync_robot.learning.relational_view import view_size
from resync_robot.learning.terminals import Terminal
from resync_robot.planning.skill_run import run_skill
from resync_robot.sim_training.domains import world_task
from tests.pucks import DOMAIN, DOOR, PUCK, ROBOT

TYPES = (ROBOT, PUCK, DOOR)
TYPES_BY_NAME = {t.name: t for t in DOMAIN.types}


def terminal(odds: float) -> Terminal:
    """Says the same of every state."""
    made = Terminal(view_size(TYPES, DOMAIN.relations)).eval()
    last = made.net[-1]
    torch.nn.init.zeros_(last.weight)
    torch.nn.init.constant_(last.bias, odds)
    return made


def recovery(done: float) -> LearnedRecovery:
    torch.manual_seed(0)
    policy = ActorCritic(16, 1, view_size(TYPES, DOMAIN.relations), 3)
    return LearnedRecovery(
        name="OpenDoor",
        types=TYPES,
        sees=3,
        failed_skill="Fetch",
        arguments=(0, 1),
        horizon=12,
        policy=policy,
        done=terminal(done),
    )


class Counted:
    """Ends with the first word, or acts so often before it."""

    def __init__(self, ending: SkillEnd, actions: int = 0) -> None:
        self.ending, self.left = ending, actions

    def step(self, observation):
        self.left -= 1
        return np.zeros(3) if self.left >= 0 else SkillOutcome(self.ending, "")


def run(learned: LearnedRecovery, failed: Counted) -> tuple[SkillOutcome, int]:
    """How it ends in the first world of the closed door, and after how many actions."""
    task = world_task(DOMAIN, "door", 0, 0)
    simulator = DOMAIN.embodiment.simulate(task)
    simulator.reset(task.initial)
    rate = DOMAIN.embodiment.rate_hz
    fetch = Skill("Fetch", (ROBOT, PUCK), lambda objects, first: failed, rate, time_limit_s=20, live_state=True)
    skill = learned.skill(fetch, DOMAIN.embodiment, DOMAIN.relations)
    robot, puck, door = (task.initial.of_type(t)[0] for t in TYPES)
    begun = simulator.time
    outcome = run_skill(simulator, skill.ground((robot, puck, door)))
    return outcome, round((simulator.time - begun) * DOMAIN.embodiment.rate_hz)


def test_it_gives_up_after_twice_an_episode_of_training() -> None:
    outcome, actions = run(recovery(-9.0), Counted(SkillEnd.BLOCKED, 3))
    assert (outcome.ending, actions) == (SkillEnd.TIMEOUT, 3 + PATIENCE * 12)


def test_it_is_done_where_beta_says_so_once_the_policy_has_acted() -> None:
    assert run(recovery(9.0), Counted(SkillEnd.BLOCKED, 3)) == (SkillOutcome(SkillEnd.DONE), 4)


@pytest.mark.parametrize("ending", [SkillEnd.DONE, SkillEnd.NEEDLESS])
def test_it_is_needless_where_the_skill_does_not_fail(ending: SkillEnd) -> None:
    outcome, actions = run(recovery(-9.0), Counted(ending, 2))
    assert (outcome.ending, actions) == (SkillEnd.NEEDLESS, 2)
    assert "Fetch does not fail here" in outcome.reason


def test_a_skill_that_refuses_leaves_the_policy_where_it_is() -> None:
    outcome, actions = run(recovery(-9.0), Counted(SkillEnd.REFUSED))
    assert (outcome.ending, actions) == (SkillEnd.TIMEOUT, PATIENCE * 12)


def test_a_record_brings_it_back() -> None:
    record = recovery(0.4).to_record()
    again = LearnedRecovery.from_record("OpenDoor", record, TYPES_BY_NAME)
    assert again.to_record().meta == record.meta
    assert replace(again, policy=None, done=None) == replace(recovery(0.4), policy=None, done=None)
    seen = torch.randn(5, view_size(TYPES, DOMAIN.relations))
    assert torch.equal(again.policy.act(seen), recovery(0.4).policy.act(seen))
    with pytest.raises(LibraryError, match="the record of OpenDoor is no recovery"):
        LearnedRecovery.from_record("OpenDoor", Record({**record.meta, "sees": "3"}, record.tensors), TYPES_BY_NAME)
