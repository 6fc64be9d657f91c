"""Failure mining: attempt tasks until a skill fails, see what was touched, and make many more such failures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from resync_robot.core.rig import Rig
from resync_robot.core.skill import GroundSkill, SkillOutcome
from resync_robot.core.symbols import Object
from resync_robot.core.task import Domain, Task
from resync_robot.core.trajectory import Trajectory
from resync_robot.learning.failures import Failure, PairGaussian
from resync_robot.planning.execute import ExecuteSettings, Listener, Model, plan_and_execute
from resync_robot.sim_training.physics.world import SimWorld


@dataclass(frozen=True)
class Attempt:
    """One episode of mining: what was tried, and the failure if there was one."""

    task: Task
    trajectory: Trajectory
    failure: Failure | None


class ContactMonitor(Listener):
    """Keeps the peak force between the hand and each object while a skill runs."""

    LOOK_ABOVE_N = 8.0
    """Reading contacts costs more than a physics step, so they are read only when the arm feels something."""

    def __init__(self, world: SimWorld) -> None:
        self.world = world
        self.peaks: dict[Object, float] = {}
        self.failures: list[Failure] = []
        self._before = world.perceive()

    def on_skill_start(self, skill: GroundSkill) -> None:
        self.peaks = {}
        self._before = self.world.perceive()

    def on_control(self, observation: Any, action: Any) -> None:
        if np.linalg.norm(observation.tip_force) > self.LOOK_ABOVE_N:
            for obj, force in self.world.hand_contacts():
                if obj is not None:
                    self.peaks[obj] = max(self.peaks.get(obj, 0.0), force)

    def on_skill_end(self, skill: GroundSkill, outcome: SkillOutcome) -> None:
        if not outcome.done:
            self.failures.append(Failure(self._before, skill.name, skill.objects, dict(self.peaks)))


def is_at_rest(world: SimWorld) -> bool:
    """Let the scene settle; did everything stay where it was put?"""
    return world.settles()


def attempt_task(task: Task, model: Model, rig: Rig) -> Attempt | None:
    """Plan and execute once, up to the first failure; None where the sampled scene does not stand still."""
    world = SimWorld(task, rig)
    if not is_at_rest(world):
        return None
    monitor = ContactMonitor(world)
    result = plan_and_execute(world, model, task.goal, ExecuteSettings(max_failures=1), monitor)
    failed = [t for t in result.transitions if not t.succeeded]
    failure = None
    if failed:
        # A skill may end contented and still not have done its work; the contacts tell either way.
        reported = [f for f in monitor.failures if f.skill == failed[0].skill]
        failure = (
            reported[0]
            if reported
            else Failure(failed[0].before, failed[0].skill, failed[0].objects, dict(monitor.peaks))
        )
    return Attempt(task, Trajectory(result.transitions, task.goal, result.success, "mining"), failure)


def resample_failure(
    domain: Domain, scenario: str, relevant: Object, beside: Object, gaussian: PairGaussian, seed: int
) -> Task:
    """A new initial state with the relevant object beside the failure object in a way drawn from the Gaussian."""
    rng = np.random.default_rng(seed)
    task = domain.scenario(scenario).sample_practice(rng, seed)
    return domain.relocate(task, relevant, beside, gaussian.sample(rng), rng)
