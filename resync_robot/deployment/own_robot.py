"""An episode of a domain with a robot of its own, in the domain's own simulator: no rig, no cameras, the same loop."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from resync_robot.console import say
from resync_robot.core.embodiment import TrainingSimulator
from resync_robot.core.episode_records import SCENE_VIEW, EpisodeMeta
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.errors import ConfigError
from resync_robot.core.library import Library
from resync_robot.core.state import State
from resync_robot.core.task import Domain, Task
from resync_robot.core.world import EffortLimited, Glimpse, Observation
from resync_robot.deployment.episode import EpisodeOutcome, about, carry_out, may_run
from resync_robot.deployment.recorder import Recorder
from resync_robot.deployment.settings import DeployConfig
from resync_robot.deployment.uncertain_atoms import with_sampled_atoms
from resync_robot.library_models import embodiment_of
from resync_robot.planning.execute import Model
from resync_robot.signals import let_through

FILM_HZ = 10.0
"""Of the simulator's own pictures, which are simple ones."""
STATES_EVERY = 0.04
"""s between two recorded states: what moves then looks as if it did."""


@dataclass
class OwnRobot:
    """A domain's own simulator, and a clock that counts the seconds in which it has acted.

    A simulator tells a time of its own with what it observes; but to ask it for the time may be dear.
    """

    simulator: TrainingSimulator[Any, Any]
    time: float = 0.0

    def clock(self) -> float:
        return self.time

    def truth(self) -> State:
        """Where everything is. Never moves the robot, as `perceive` may."""
        state: State = self.simulator.observe(True).state
        return state

    def glimpse(self) -> Glimpse:
        """A copy, for a simulator may paint the next picture over this one."""
        return Glimpse(SCENE_VIEW, np.array(self.simulator.picture()), self.time)


class RecordedWorld:
    """The world of such a robot, whose states and pictures a recorder is told while it acts."""

    def __init__(self, robot: OwnRobot, recorder: Recorder) -> None:
        self._robot, self._recorder = robot, recorder

    def observe(self, live: bool = False) -> Observation:
        seen: Observation = self._robot.simulator.observe(live)
        self._recorder.on_seen(seen.state)
        return seen

    def act(self, action: Any, duration: float, /) -> None:
        self._robot.simulator.act(action, duration)
        self._robot.time += duration
        self._recorder.on_moment(self._robot.time)

    def perceive(self) -> State:
        state = self._robot.simulator.perceive()
        self._recorder.on_moment(self._robot.time)
        return state


class EffortLimitedWorld(RecordedWorld):
    """The same of a simulator that can be told how hard its robot may press."""

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        self._robot.simulator.limit_effort(limit)  # type: ignore[attr-defined]


def run_own_episode(
    config: DeployConfig, domain: Domain, library: Library, model: Model, task: Task, path: Path
) -> EpisodeOutcome:
    """Run one episode to whatever end, and record it.

    Raises:
        ConfigError: the task's scene does not stand still.
    """
    # A scene that cannot be leaves no recording behind.
    with let_through():
        robot = OwnRobot(embodiment_of(domain, None).simulate(task))
        if not robot.simulator.reset(task.initial):
            raise ConfigError(f"the scene of seed {task.seed} does not stand still", "take another --seed")
    meta = EpisodeMeta(rig_hash="", rig={}, domain=domain.name, **about(config, domain, library, task))
    film_hz = FILM_HZ if config.record_pictures is None else config.record_pictures
    model = with_sampled_atoms(model)
    with EpisodeWriter(path, meta) as writer:
        recorder = Recorder(
            writer,
            robot.clock,
            robot.truth,
            (robot.glimpse,) if film_hz else (),
            film_hz or FILM_HZ,
            states_every=STATES_EVERY,
            confirm=lambda step: not config.confirm or may_run(str(step)),
            tell=say,
        )
        kind = EffortLimitedWorld if isinstance(robot.simulator, EffortLimited) else RecordedWorld
        say(f"Goal: {meta.goal}")
        before = domain.scenario(config.scenario).begins_after
        course = carry_out(config, model, task, before, recorder, robot.truth, lambda: kind(robot, recorder))
    recorded = writer.error is None
    return EpisodeOutcome(course.result, course.reached, recorder.skills, None, recorded, course.ending, course.fix)
