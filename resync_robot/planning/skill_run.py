"""One skill, run to its end: the loop between an observation and the next action, and the look at what came of it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from resync_robot.core.errors import InterruptedMotionError
from resync_robot.core.skill import GroundSkill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.world import EffortLimited, Observation, World

LOOKS = 3
"""How often the world is looked at, at most, where a skill says that it is done and what it should bring about is not
seen: one of the two errs, and to look again is cheaper than to do the step again."""


class SkillListener:
    """Hears how a skill runs."""

    def on_skill_start(self, skill: GroundSkill) -> None: ...

    def on_control(self, observation: Observation, action: Any) -> None: ...

    def on_skill_end(self, skill: GroundSkill, outcome: SkillOutcome) -> None: ...


def looks(world: World, outcome: SkillOutcome) -> Iterator[State]:
    """What is seen after a skill: once, or, where it says that it is done, as often as the caller goes on asking, up to
    `LOOKS` times."""
    for _ in range(LOOKS if outcome.done else 1):
        yield world.perceive()


def what_was_done(ground: GroundSkill, outcome: SkillOutcome) -> tuple[GroundSkill, bool]:
    """What a run of a skill was a run of, and whether that is done: a recovery that nothing calls for is a successful
    run of what it mends."""
    return (ground.first, True) if outcome.ending is SkillEnd.NEEDLESS else (ground, outcome.done)


def run_skill(world: World, ground: GroundSkill, listener: SkillListener | None = None) -> SkillOutcome:
    """Run one ground skill to its end or its time limit.

    The limit counts control steps: a robot that runs at a fraction of full speed stretches them on its own clock, and
    a skill is not to fail for that.
    """
    return run_for(world, ground, listener or SkillListener())[0]


def run_for(
    world: World, ground: GroundSkill, listener: SkillListener, most: int | None = None
) -> tuple[SkillOutcome, int]:
    """`run_skill` with at most so many control steps; also how many there were."""
    skill = ground.skill
    listener.on_skill_start(ground)
    arm = world if isinstance(world, EffortLimited) else None
    if arm is not None:
        arm.limit_effort(skill.effort_limit)
    observation = world.observe(skill.live_state)
    policy = skill.start(ground.objects, observation)
    steps = 0
    while True:
        answer = policy.step(observation)
        if isinstance(answer, SkillOutcome):
            break
        if most is not None and steps >= most:
            answer = SkillOutcome(SkillEnd.TIMEOUT, "the episode's horizon is reached")
            break
        listener.on_control(observation, answer)
        try:
            world.act(answer, 1.0 / skill.rate_hz)
        except InterruptedMotionError as error:
            answer = SkillOutcome(SkillEnd.BLOCKED, error.what)
            break
        steps += 1
        observation = world.observe(skill.live_state)
        if steps > skill.time_limit_s * skill.rate_hz:
            answer = SkillOutcome(SkillEnd.TIMEOUT, f"not done after {skill.time_limit_s:.0f} s")
            break
    if arm is not None:
        arm.limit_effort(None)
    listener.on_skill_end(ground, answer)
    return answer, steps
