"""One episode of a deployment: open the machine, record, run to whatever end, let go, and tell how it went."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from resync_robot.core.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from contextlib import AbstractContextManager
    from typing import Any

    from resync_robot.core.episode import Episode
    from resync_robot.core.library import Library
    from resync_robot.core.rig import Rig
    from resync_robot.core.state import State
    from resync_robot.core.task import Domain, Task
    from resync_robot.core.world import Glimpse, World
    from resync_robot.deployment.recorder import Recorder
    from resync_robot.deployment.replayed_episode import Replayed
    from resync_robot.deployment.settings import DeployConfig
    from resync_robot.hardware.base import Halt, ProtectiveStopError
    from resync_robot.hardware.devices import Devices
    from resync_robot.perception.segment import Segmenter
    from resync_robot.planning.execute import EpisodeEnd, EpisodeResult, Model


BEWARE = "keep away from the robot or press its emergency stop; then look at it, the cable and the controller"
"""What to do where nobody knows whether it has stopped."""


@dataclass(frozen=True)
class EpisodeOutcome:
    """How an episode ended.

    Attributes:
        reached: whether its goal holds, in truth where that can be had.
        skills: how many were run to an end.
        halt: what is known of the robot; None where nothing moves by itself.
        recorded: the recording is whole; where it is not, the reason was logged when it happened.
        error: what ends the program with the episode.
        fix: what to do about it.
        replayed: of a replay, how it went.
    """

    result: EpisodeResult
    reached: bool
    skills: int
    halt: Halt | None
    recorded: bool
    error: BaseException | None = None
    fix: str = ""
    replayed: Replayed | None = None

    def kept(self, path: Path) -> str:
        """What there is of the recording, for people."""
        if self.recorded:
            return f"Recording: {path}"
        return f"Recording incomplete: {path}" if path.exists() else "Nothing of it was recorded."

    @property
    def good(self) -> bool:
        """It came to what it was to come to."""
        from resync_robot.planning.execute import EpisodeEnd

        if self.replayed is not None:
            return self.replayed.same
        return self.reached or self.result.end is EpisodeEnd.PLANNED

    @property
    def verdict(self) -> str:
        """For people; also what is known of the robot, where that is not as it should be or all is not well."""
        from resync_robot.hardware.base import Halt
        from resync_robot.planning.execute import EpisodeEnd

        end, reason = self.result.end, self.result.reason
        if self.replayed is not None:
            return self.replayed.verdict
        if self.reached:
            words = "goal reached"
        elif end is EpisodeEnd.GOAL:
            words = "failed (the robot believes that it reached the goal, and in truth it did not)"
        else:
            words = (
                f"{end.value} ({reason})"
                if end in (EpisodeEnd.PLANNED, EpisodeEnd.STOPPED)
                else f"failed ({end.value}: {reason})"
            )
        if self.halt is Halt.UNKNOWN or (self.halt is not None and not self.good):
            words += f"; {self.halt.value}"
        return words


@dataclass(frozen=True)
class Course:
    """How the part of an episode went in which the robot may act.

    Attributes:
        reached: whether the goal holds, in truth where that can be had.
        fix: what to do about it.
        ending: what ends the program with the episode.
        broken_off: what broke it off; None where it came to an end by itself.
    """

    result: EpisodeResult
    reached: bool
    fix: str = ""
    ending: BaseException | None = None
    broken_off: BaseException | None = None


def carry_out(
    config: DeployConfig,
    model: Model,
    task: Task,
    before: tuple[tuple[str, tuple[str, ...]], ...],
    recorder: Recorder,
    truth: Callable[[], State] | None,
    open_world: Callable[[], World[Any, Any]],
) -> Course:
    """Begin as the scenario says, plan and execute to whatever end; the recorder hears of it all.

    Args:
        before: what is run before the episode begins, see `Scenario.begins_after`.
        truth: the simulator's own state; None where nobody knows it.
    """
    from resync_robot.core.errors import MotionError, PerceptionError
    from resync_robot.hardware.answers import Departure, RecordingOverError
    from resync_robot.hardware.base import RobotError
    from resync_robot.planning.execute import EpisodeEnd, EpisodeResult, ExecuteSettings, begin_after, plan_and_execute
    from resync_robot.signals import let_through

    try:
        with let_through():
            world = open_world()
            steps = [f"{name}({', '.join(of)})" for name, of in before]
            if not config.dry_run and all(not config.confirm or may_run(step) for step in steps):
                begin_after(world, model, before, task.objects, recorder)
            result = plan_and_execute(world, model, task.goal, ExecuteSettings(plan_only=config.dry_run), recorder)
            # What the robot believes at the end does not count where the truth can be had.
            reached = result.success and (truth is None or task.goal <= model.abstraction.true_atoms(truth()))
        no_plan = result.end is EpisodeEnd.NO_PLAN and not result.transitions
        return Course(result, reached, "See what it saw in the recording, or give another --goal." if no_plan else "")
    except BaseException as error:
        result = EpisodeResult(*_end(error), (), (), task.initial)
        recorder.on_end(result.end, result.reason)
        # The trouble of one episode is recorded with it, and leaves the others their turn.
        if isinstance(error, PerceptionError | MotionError | RobotError):
            return Course(result, False, error.fix, None, error)
        ending = None if isinstance(error, Departure | RecordingOverError) else error
        return Course(result, False, "", ending, error)


def run_episode(
    config: DeployConfig,
    domain: Domain,
    rig: Rig,
    library: Library,
    model: Model,
    task: Task,
    index: int,
    path: Path,
    recording: Episode | None,
    segmenter: Segmenter | None,
) -> EpisodeOutcome:
    """Run one episode to whatever end; the robot is let go and the recording closed then."""
    from resync_robot.console import say
    from resync_robot.core.episode_records import EpisodeMeta, EventKind
    from resync_robot.core.episode_writer import EpisodeWriter
    from resync_robot.deployment.devices import open_simulated
    from resync_robot.deployment.recorder import Recorder
    from resync_robot.deployment.replayed_episode import ReplayRecorder, judge
    from resync_robot.deployment.uncertain_atoms import with_sampled_atoms
    from resync_robot.deployment.world import DeployedWorld, OracleWorld
    from resync_robot.hardware.base import Halt, RealtimeRobot
    from resync_robot.hardware.devices import Layout, ReplayedDevices, open_replay, open_ur7e
    from resync_robot.signals import let_through

    scenario = domain.scenarios.get(config.scenario)
    before = scenario.begins_after if scenario else ()
    meta = EpisodeMeta.of(rig, domain=config.domain, **about(config, domain, library, task))
    if config.backend == "sim":
        opened: AbstractContextManager[Devices] = open_simulated(task, rig)
    elif recording is not None:
        opened = open_replay(recording)
    else:
        opened = open_ur7e(Layout(config.domain, config.scenario, config.seed, index), rig)
    with ExitStack() as stack:
        # The devices come first: where there is no robot, no recording is left behind.
        with let_through():
            devices = stack.enter_context(opened)
        writer = stack.enter_context(EpisodeWriter(path, meta, devices.clock()))
        film, film_hz = film_of(config, devices)
        recorder = (Recorder if recording is None else ReplayRecorder)(
            writer,
            devices.clock,
            devices.truth,
            film,
            film_hz,
            live=isinstance(devices.robot, RealtimeRobot),
            confirm=lambda step: not config.confirm or may_run(str(step)),
            tell=say,
        )
        kind = OracleWorld if config.perception == "oracle" else DeployedWorld

        def on_stop(error: ProtectiveStopError) -> None:
            writer.event(devices.clock(), EventKind.STOP, error.what)
            if devices.resume is None or not (recording is not None or _acknowledged(error)):
                raise error
            devices.resume()

        model = with_sampled_atoms(model)

        def open_world() -> World[Any, Any]:
            world = kind(
                devices.robot,
                devices.cameras,
                rig,
                task.objects,
                live_state=devices.live,
                witness=recorder,
                on_stop=on_stop,
                abstraction=model.abstraction,
                segmenter=segmenter,
                stream=devices.stream,
                ready=devices.ready,
            )
            world.stream.recorders.append(recorder.on_stream)
            return world

        say(f"Goal: {meta.goal}")
        if recording is not None and isinstance(recorder, ReplayRecorder) and isinstance(devices, ReplayedDevices):
            recorder.compare_with(recording, devices.answers)
        course = carry_out(config, model, task, before, recorder, devices.truth, open_world)
        result, reached = course.result, course.reached
        recorder.let_go()
        halt = None if devices.halt is None else devices.halt()
        if halt is not None:
            recorder.on_halt(halt)
        replayed = None
        if recording is not None and isinstance(devices, ReplayedDevices):
            replayed = judge(recording, devices.answers, result.end, result.reason, course.broken_off)
    fix = BEWARE if halt is Halt.UNKNOWN else course.fix
    return EpisodeOutcome(result, reached, recorder.skills, halt, writer.error is None, course.ending, fix, replayed)


def about(config: DeployConfig, domain: Domain, library: Library, task: Task) -> Mapping[str, Any]:
    """What `EpisodeMeta` says of an episode that begins now, but for its robot and where its domain is found."""
    from datetime import UTC, datetime

    from resync_robot import __version__
    from resync_robot.deployment.replayed_episode import settings_of
    from resync_robot.library_models import learned_names

    return {
        "library_hash": library.content_hash,
        "scenario": config.scenario,
        "goal": ", ".join(map(str, sorted(task.goal))),
        "seed": task.seed,
        "backend": config.backend,
        "versions": {"resync-robot": __version__},
        "began": datetime.now(UTC).isoformat(),
        "objects": {o.name: o.type.name for o in task.objects},
        "settings": settings_of(config),
        "types": {t.name: t.to_json() for t in domain.types},
        "model": {"pddl": library.domain_pddl, "learned": learned_names(domain, library)},
    }


def film_of(config: DeployConfig, devices: Devices) -> tuple[tuple[Callable[[], Glimpse], ...], float]:
    """What is filmed, and how often, Hz."""
    hz = devices.film_hz if config.record_pictures is None else config.record_pictures
    return (devices.film, hz) if hz else ((), devices.film_hz)


def _end(error: BaseException) -> tuple[EpisodeEnd, str]:
    """How an episode ends that is broken off by this, and why."""
    from resync_robot.core.errors import ResyncError
    from resync_robot.planning.execute import EpisodeEnd
    from resync_robot.signals import number_of, words_for

    if isinstance(error, KeyboardInterrupt):
        return EpisodeEnd.STOPPED, words_for(number_of(error))
    return EpisodeEnd.FAULT, error.what if isinstance(error, ResyncError) else f"{type(error).__name__}: {error}"


def may_run(step: str) -> bool:
    """Ask. Raises ConfigError where nobody can answer."""
    try:
        return input(f"Run {step}? [y/N] ").strip().lower() in ("y", "yes")
    except EOFError:
        raise ConfigError(
            "--confirm asks before each step, and nobody is there to answer", "run it from a terminal"
        ) from None


def _acknowledged(error: ProtectiveStopError) -> bool:
    """Ask whoever stands at the robot. Without a terminal to answer, nothing is ever acknowledged."""
    from resync_robot.console import say

    say(f"STOP: {error.what}. Look at the robot, and clear what stopped it.")
    try:
        return input("Type 'clear' to release the stop and go on, anything else to end: ").strip().lower() == "clear"
    except EOFError:
        return False
