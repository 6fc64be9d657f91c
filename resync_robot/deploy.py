"""Deployment: look around, estimate the objects, ground, plan, and stream joint targets to a robot."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from resync_robot.core.errors import ConfigError

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from hardware.base import Halt, ProtectiveStopError
    from perception.segment import Segmenter
    from resync_robot.backends import Devices
    from resync_robot.core.episode import Episode, EpisodeMeta
    from resync_robot.core.library import Library
    from resync_robot.core.rig import Rig
    from resync_robot.core.task import Domain, Task
    from resync_robot.planning.execute import End, Model, Result


BEWARE = "keep away from the robot or press its emergency stop; then look at it, the cable and the controller"
"""What to do where nobody knows whether it has stopped."""


@dataclass(frozen=True, kw_only=True)
class DeployConfig:
    """Let a robot, simulated or real, reach a goal with what a library knows."""

    backend: Literal["sim", "ur7e", "replay"] = "sim"
    """The robot, gripper and cameras to use. Everything above them is the same code."""

    library: Path | None = None
    """Library folder that train-sim wrote. Default: the shipped one."""

    domain: str = "cornered-insertion-s"
    """The domain whose objects and skills are used."""

    replay: Path | None = None
    """The recording that --backend replay runs over: the same executive, fed with what was recorded."""

    scenario: str = "s1"
    """Where the objects of a simulated episode lie, and the goal unless --goal is given."""

    goal: str | None = None
    """The goal as atoms, such as "On(b1,b0)". Default: that of the scenario."""

    seed: int = 0
    """Seed of the simulated worlds; the first episode's world depends on nothing else."""

    episodes: int = 1
    """How many episodes to run, each in a world of its own."""

    perception: Literal["camera", "oracle"] = "camera"
    """Where poses come from: RGB-D pictures, or the simulator's own state."""

    skills: Literal["auto", "camera", "state"] = "auto"
    """What the learned skills see while they run: pictures, joints and the scan, or the simulator's state. auto:
    pictures, where the library holds a camera policy."""

    segmenter: Literal["colour", "sam3"] = "colour"
    """What finds the blocks in pictures: their hues, or SAM 3 by the prompts of the rig file."""

    dry_run: bool = False
    """Look, ground and plan, and print the plan, but move no skill."""

    confirm: bool = False
    """Ask before each step of the plan."""

    out: Path | None = None
    """Folder of the recordings. Default: runs/DATE-deploy."""

    rig: Path | None = None
    """The facts of the machine, a TOML file. Default: the rig that the simulation assumes."""


def deploy(config: DeployConfig) -> int:
    """Run the episodes of `config`, each recorded whether it succeeds or not.

    Returns:
        0 when every episode reached its goal, or was planned in a dry run, and was recorded whole, else 3; 3 as well
        where nobody knows whether the robot has stopped.

    Raises:
        ResyncError: bad input, or a machine that cannot be used.
        KeyboardInterrupt: somebody ended it; the episode's recording is whole, and has been named.
    """
    from hardware.base import Halt
    from resync_robot.core.library import load_library
    from resync_robot.core.options import MOST_EPISODES, check_range, check_seed
    from resync_robot.core.rig import load_rig
    from resync_robot.knowledge import camera_recovery, learned_model, sees_by_camera, shipped_library
    from resync_robot.learning.camera_view import VIEWS
    from resync_robot.planning.suppose import check_goal
    from resync_robot.progress import say
    from resync_robot.run_folder import check_folder, default_folder
    from resync_robot.signals import held
    from sim_training.domains import find_domain

    check_range("--episodes", config.episodes, 1, MOST_EPISODES)
    check_seed(config.seed)
    domain, rig = find_domain(config.domain), load_rig(config.rig)
    if config.backend == "ur7e":
        _check_rig(config, rig)
    domain.scenario(config.scenario)
    library = load_library(config.library or shipped_library(domain.name))
    by_camera = config.skills == "camera" or (config.skills == "auto" and sees_by_camera(domain, library))
    if by_camera and config.perception == "oracle":
        if config.skills == "camera":
            raise ConfigError("--skills camera needs cameras", "leave out --perception oracle")
        by_camera = False
    segmenter = _segmenter(config, rig)
    model = learned_model(domain, rig, library, camera_recovery(domain, rig, library) if by_camera else None)
    recording = _recording(config)
    if recording is None:
        tasks = [_task(config, domain, config.seed + i) for i in range(config.episodes)]
    else:
        tasks = [_recorded_task(recording, domain)]
    if config.goal is not None:
        for task in tasks:
            # A goal out of reach is a mistake of whoever typed it: said at once, before anything moves.
            atoms = model.abstraction.true_atoms(task.initial)
            check_goal(model.operators, model.abstraction, task.objects, atoms, task.goal)
    folder = config.out or default_folder("deploy")
    check_folder(folder)
    paths = [folder / f"episode-{i:03d}-{config.scenario}-seed{task.seed}.mcap" for i, task in enumerate(tasks)]
    for path in paths:
        if path.exists():
            raise ConfigError(
                f"{path} exists already; recordings are never overwritten", "give another folder to --out"
            )
    if library.rig_hash != rig.hash:
        say(f"Note: the library was learned on another rig ({library.rig_hash}, this one is {rig.hash}).")
    for line in calibration_complaints(config, rig):
        say(f"Warning: {line}.\n  -> resync-robot calibrate check --rig {config.rig or 'rig.toml'}")
    simulated = config.backend == "sim" or (rig.controller is not None and rig.controller.emulated)
    if rig.controller is not None and not rig.controller.full_speed:
        say(
            "The tip moves at 250 mm/s at most, until [controller] full_speed = true says that somebody has watched a "
            "whole slow run."
        )
    noise = " (RGB-D with simulated noise)" if simulated else ""
    say(
        f"Poses from the wrist camera{noise}."
        if config.perception == "camera"
        else "Poses from the simulator (--perception oracle)."
    )
    if by_camera:
        say(f"{domain.recovery} sees pictures of {', '.join(VIEWS)}, the joints, and what the scan measured.")
    elif simulated:
        say(
            f"{domain.recovery} follows its block through the simulator's state while it runs; "
            "everything else is estimated."
        )
    good = 0
    for i, (task, path) in enumerate(zip(tasks, paths, strict=True)):
        # Whoever ends the program meanwhile waits until the robot is let go and the recording closed and named.
        with held():
            outcome = _episode(config, rig, library, model, task, i, path, recording, segmenter)
            good += outcome.good
            try:
                say(f"Episode {i + 1}/{len(tasks)}: {outcome.verdict}; {outcome.skills} skills. {outcome.kept(path)}")
            finally:
                # Also where the terminal is gone that this was to be said on.
                if outcome.error is not None:
                    raise outcome.error
            if outcome.fix:
                say(f"  -> {outcome.fix}")
        # Nobody could find out later what an unrecorded episode did.
        ends = outcome.halt.value if outcome.halt is Halt.UNKNOWN else "" if outcome.recorded else "nothing is recorded"
        if ends:
            if i + 1 < len(tasks):
                say(f"The other {len(tasks) - i - 1} episodes are not begun: {ends}.")
            break
    done = "were planned" if config.dry_run else "reached the goal"
    review = f" Review:  resync-robot review {path}" if path.exists() else ""
    say(f"{good} of {len(tasks)} episodes {done}.{review}")
    return 0 if good == len(tasks) and outcome.halt is not Halt.UNKNOWN and outcome.recorded else 3


@dataclass(frozen=True)
class _Outcome:
    """How an episode ended.

    Attributes:
        reached: whether its goal holds, in truth where that can be had.
        skills: how many were run to an end.
        halt: what is known of the robot; None where nothing moves by itself.
        recorded: the recording is whole; where it is not, the reason was logged when it happened.
        error: what ends the program with the episode.
        fix: what to do about it.
    """

    result: Result
    reached: bool
    skills: int
    halt: Halt | None
    recorded: bool
    error: BaseException | None = None
    fix: str = ""

    def kept(self, path: Path) -> str:
        """What there is of the recording, for people."""
        if self.recorded:
            return f"Recording: {path}"
        return f"Recording incomplete: {path}" if path.exists() else "Nothing of it was recorded."

    @property
    def good(self) -> bool:
        """It came to what it was to come to."""
        from resync_robot.planning.execute import End

        return self.reached or self.result.end is End.PLANNED

    @property
    def verdict(self) -> str:
        """For people; also what is known of the robot, where that is not as it should be or all is not well."""
        from hardware.base import Halt
        from resync_robot.planning.execute import End

        end, reason = self.result.end, self.result.reason
        if self.reached:
            words = "goal reached"
        elif end is End.GOAL:
            words = "failed (the robot believes that it reached the goal, and in truth it did not)"
        else:
            words = (
                f"{end.value} ({reason})" if end in (End.PLANNED, End.STOPPED) else f"failed ({end.value}: {reason})"
            )
        if self.halt is Halt.UNKNOWN or (self.halt is not None and not self.good):
            words += f"; {self.halt.value}"
        return words


def calibration_complaints(config: DeployConfig, rig: Rig) -> list[str]:
    """What is old, bad or missing in the calibration of the rig's cameras, a line each.

    A simulated camera stands where the rig says it does; on a real rig every camera needs a calibration.
    """
    from datetime import date

    from resync_robot.core.calibration_record import complaints

    records = {camera.name: camera.calibration for camera in rig.cameras}
    return complaints(records, rig.calibration_limits, date.today(), expected=config.backend != "sim")


def _segmenter(config: DeployConfig, rig: Rig) -> Segmenter | None:
    """The one asked for, None for that by colour. Raises PerceptionError where it cannot be had."""
    if config.segmenter == "colour":
        return None
    from perception.objects import catalogue_of
    from perception.sam3 import sam3_segmenter

    return sam3_segmenter(rig.sam3, catalogue_of(rig), rig.where)


def _check_rig(config: DeployConfig, rig: Rig) -> None:
    """What the ur7e backend needs to know before anything is read or moved. Raises RobotError or ConfigError."""
    from hardware.ur7e import require_controller

    emulated = require_controller(rig).emulated
    if not emulated and config.perception == "oracle":
        raise ConfigError("no real robot knows where things are", "use --perception camera")


def _recording(config: DeployConfig) -> Episode | None:
    """What --backend replay runs over. Raises ConfigError or EpisodeError."""
    from resync_robot.core.episode import read_episode
    from resync_robot.progress import say

    if config.backend != "replay":
        if config.replay is not None:
            raise ConfigError(f"--replay {config.replay} is for --backend replay", "add --backend replay, or leave it")
        return None
    if config.replay is None:
        raise ConfigError("--backend replay needs a recording", "give one with --replay EPISODE.mcap")
    if config.episodes != 1:
        raise ConfigError(f"--episodes is {config.episodes}; a recording holds one")
    recording = read_episode(config.replay, unbroken=True)
    if recording.missing:
        # Each look is answered by the next one that was recorded; where one is missing, all later ones would be wrong.
        say(
            f"Warning: {recording.path} is not whole: {recording.loss}. A replay needs every look in its order, so it "
            f"has only what comes before the first that is missing: {recording.duration:.1f} s."
        )
    return recording


def _recorded_task(recording: Episode, domain: Domain) -> Task:
    """The recorded episode's objects and goal. Raises ConfigError or EpisodeError."""
    from resync_robot.core.errors import EpisodeError
    from resync_robot.core.task import Task

    if recording.meta.domain != domain.name:
        raise ConfigError(f"{recording.path} is of the domain '{recording.meta.domain}'", "name it with --domain")
    initial = next(iter(recording.truths()), None) or next(iter(recording.states()), None)
    if initial is None:
        raise EpisodeError(f"{recording.path} holds no states of objects", "record one with resync-robot deploy")
    objects = initial[1].objects
    return Task(objects, initial[1], domain.parse_goal(recording.meta.goal, objects), {}, recording.meta.seed)


def _task(config: DeployConfig, domain: Domain, seed: int) -> Task:
    from dataclasses import replace

    from sim_training.domains import world_task

    task = world_task(domain, config.scenario, config.seed, seed - config.seed)
    return task if config.goal is None else replace(task, goal=domain.parse_goal(config.goal, task.objects))


def _episode(
    config: DeployConfig,
    rig: Rig,
    library: Library,
    model: Model,
    task: Task,
    index: int,
    path: Path,
    recording: Episode | None,
    segmenter: Segmenter | None,
) -> _Outcome:
    """Run one episode to whatever end; the robot is let go and the recording closed then."""
    from hardware.base import Halt, RealtimeRobot, RobotError
    from resync_robot import __version__
    from resync_robot.backends import Layout, open_replay, open_simulated, open_ur7e
    from resync_robot.core.episode import EpisodeMeta, EventKind
    from resync_robot.core.episode_writer import EpisodeWriter
    from resync_robot.core.errors import MotionError, PerceptionError
    from resync_robot.deployed_world import DeployedWorld, OracleWorld
    from resync_robot.doubt import doubting
    from resync_robot.planning.execute import End, ExecuteSettings, Result, begin_after, plan_f
    from resync_robot.progress import say
    from resync_robot.recorder import Recorder
    from resync_robot.signals import let_through
    from sim_training.domains import find_domain

    scenario = find_domain(config.domain).scenarios.get(recording.meta.scenario if recording else config.scenario)
    before = scenario.begins_after if scenario else ()
    goal = ", ".join(map(str, sorted(task.goal)))
    meta = EpisodeMeta.of(
        rig,
        library_hash=library.content_hash,
        domain=config.domain,
        scenario=config.scenario,
        goal=goal,
        seed=task.seed,
        backend=config.backend,
        versions={"resync-robot": __version__},
    )
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
        writer = stack.enter_context(EpisodeWriter(path, _dated(meta), devices.clock()))
        standing = [devices.cameras[c.name] for c in rig.cameras if c.mount == "world"] if recording is None else []
        recorder = Recorder(
            writer,
            devices.clock,
            devices.truth,
            [camera.capture for camera in standing],
            live=isinstance(devices.robot, RealtimeRobot),
            confirm=lambda step: not config.confirm or _may_run(str(step)),
            tell=say,
        )
        kind = DeployedWorld if config.perception == "camera" else OracleWorld

        def on_stop(error: ProtectiveStopError) -> None:
            writer.event(devices.clock(), EventKind.STOP, error.what)
            if devices.resume is None or not _acknowledged(error):
                raise error
            devices.resume()

        model = doubting(model)
        say(f"Goal: {goal}")
        reached, ending, fix = False, None, ""
        try:
            with let_through():
                world = kind(
                    devices.robot,
                    devices.cameras,
                    rig,
                    task.objects,
                    live_state=devices.truth,
                    witness=recorder,
                    on_stop=on_stop,
                    abstraction=model.abstraction,
                    segmenter=segmenter,
                )
                world.stream.recorders.append(recorder.on_stream)
                steps = [f"{name}({', '.join(of)})" for name, of in before]
                if not config.dry_run and all(not config.confirm or _may_run(step) for step in steps):
                    begin_after(world, model, before, task.objects, recorder)
                result = plan_f(world, model, task.goal, ExecuteSettings(plan_only=config.dry_run), recorder)
                # What the robot believes at the end does not count where the truth can be had.
                reached = result.success and (
                    devices.truth is None or task.goal <= model.abstraction.true_atoms(devices.truth())
                )
            if result.end is End.NO_PLAN and not result.transitions:
                fix = 'See what it saw in the recording, or give another --goal, such as --goal "On(b1,b0)".'
        except BaseException as error:
            result = Result(*_end(error), (), (), task.initial)
            recorder.on_end(result.end, result.reason)
            # The trouble of one episode is recorded with it, and leaves the others their turn.
            if isinstance(error, PerceptionError | MotionError | RobotError):
                fix = error.fix
            else:
                ending = error
        recorder.let_go()
        halt = None if devices.halt is None else devices.halt()
        if halt is not None:
            recorder.on_halt(halt)
    fix = BEWARE if halt is Halt.UNKNOWN else fix
    return _Outcome(result, reached, recorder.skills, halt, writer.error is None, ending, fix)


def _dated(meta: EpisodeMeta) -> EpisodeMeta:
    """It begins now."""
    from dataclasses import replace
    from datetime import UTC, datetime

    return replace(meta, began=datetime.now(UTC).isoformat())


def _end(error: BaseException) -> tuple[End, str]:
    """How an episode ends that is broken off by this, and why."""
    from resync_robot.core.errors import ResyncError
    from resync_robot.planning.execute import End
    from resync_robot.signals import number_of, words_for

    if isinstance(error, KeyboardInterrupt):
        return End.STOPPED, words_for(number_of(error))
    return End.FAULT, error.what if isinstance(error, ResyncError) else f"{type(error).__name__}: {error}"


def _may_run(step: str) -> bool:
    """Ask. Raises ConfigError where nobody can answer."""
    try:
        return input(f"Run {step}? [y/N] ").strip().lower() in ("y", "yes")
    except EOFError:
        raise ConfigError(
            "--confirm asks before each step, and nobody is there to answer", "run it from a terminal"
        ) from None


def _acknowledged(error: ProtectiveStopError) -> bool:
    """Ask whoever stands at the robot. Without a terminal to answer, nothing is ever acknowledged."""
    from resync_robot.progress import say

    say(f"STOP: {error.what}. Look at the robot, and clear what stopped it.")
    try:
        return input("Type 'clear' to release the stop and go on, anything else to end: ").strip().lower() == "clear"
    except EOFError:
        return False
