"""Deployment: look around, estimate the objects, ground, plan, and let the robot act: an arm, or a domain's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from resync_robot.core.errors import ConfigError
from resync_robot.deployment.plan_files import check_plan_files, write_plan_files
from resync_robot.deployment.settings import DeployConfig

MOST_FILM_HZ = 30.0
"""As fast as the cameras stream."""

if TYPE_CHECKING:
    from resync_robot.core.episode import Episode
    from resync_robot.core.rig import Rig
    from resync_robot.core.task import Domain, Task
    from resync_robot.deployment.episode import EpisodeOutcome
    from resync_robot.perception.segment import Segmenter
    from resync_robot.planning.execute import Model


@dataclass(frozen=True)
class _Robot:
    """What the episodes of one deployment have in common.

    Attributes:
        notes: what to tell a person before the first.
        run: runs one, given its task, its number and where it is recorded.
    """

    model: Model
    notes: tuple[str, ...]
    run: Callable[[Task, int, Path], EpisodeOutcome]


def deploy(config: DeployConfig) -> int:
    """Run the episodes of `config`, each recorded whether it succeeds or not.

    Returns:
        0 when every episode reached its goal, or was planned in a dry run, or went as recorded in a replay, and was
        recorded whole, else 3; 3 as well where nobody knows whether the robot has stopped.

    Raises:
        ResyncError: bad input, or a machine that cannot be used.
        KeyboardInterrupt: somebody ended it; the episode's recording is whole, and has been named.
    """
    from resync_robot.console import say
    from resync_robot.core.files import check_folder
    from resync_robot.core.options import MOST_EPISODES, check_range, check_seed
    from resync_robot.core.runs import default_folder
    from resync_robot.deployment.replayed_episode import as_recorded, recorded_task
    from resync_robot.planning.effect_hypotheses import check_goal

    check_range("--episodes", config.episodes, 1, MOST_EPISODES)
    check_range("--record-pictures", config.record_pictures or 0.0, 0.0, MOST_FILM_HZ)
    check_seed(config.seed)
    domain = _domain(config)
    recording = _recording(config)
    if recording is not None:
        config = as_recorded(config, recording)
        domain = _domain(config)
    config = replace(config, scenario=config.scenario or domain.first_test.name)
    check_plan_files(config)
    robot = _own_robot(config, domain) if domain.embodiment is not None else _arm(config, domain, recording)
    if recording is None:
        tasks = [_task(config, domain, config.seed + i) for i in range(config.episodes)]
    else:
        tasks = [recorded_task(recording, domain)]
    if config.goal is not None and recording is None:
        for task in tasks:
            # A goal out of reach is a mistake of whoever typed it: said at once, before anything moves.
            atoms = robot.model.abstraction.true_atoms(task.initial)
            check_goal(robot.model.operators, robot.model.abstraction, task.objects, atoms, task.goal)
    folder = config.out or default_folder("deploy")
    check_folder(folder)
    paths = [folder / f"episode-{i:03d}-{config.scenario}-seed{task.seed}.mcap" for i, task in enumerate(tasks)]
    for path in paths:
        if path.exists():
            raise ConfigError(
                f"{path} exists already; recordings are never overwritten", "give another folder to --out"
            )
    for line in robot.notes:
        say(line)
    return _run(config, domain, robot, list(zip(tasks, paths, strict=True)), recording)


def _run(
    config: DeployConfig, domain: Domain, robot: _Robot, episodes: list[tuple[Task, Path]], recording: Episode | None
) -> int:
    """Run them one after the other, and tell how each went. Returns the exit code."""
    from resync_robot.console import say
    from resync_robot.hardware.base import Halt
    from resync_robot.signals import held

    good = 0
    for i, (task, path) in enumerate(episodes):
        # Whoever ends the program meanwhile waits until the robot is let go and the recording closed and named.
        with held():
            outcome = robot.run(task, i, path)
            good += outcome.good
            try:
                words = f"{outcome.verdict}; {outcome.skills} skills. {outcome.kept(path)}"
                say(f"Episode {i + 1}/{len(episodes)}: {words}")
            finally:
                # Also where the terminal is gone that this was to be said on.
                if outcome.error is not None:
                    raise outcome.error
            if outcome.fix:
                say(f"  -> {outcome.fix}")
            if config.pddl is not None and outcome.result.plans:
                plan = outcome.result.plans[0]
                say(write_plan_files(config.pddl, domain, robot.model, task, config.scenario, plan))
        # Nobody could find out later what an unrecorded episode did.
        ends = outcome.halt.value if outcome.halt is Halt.UNKNOWN else "" if outcome.recorded else "nothing is recorded"
        if ends:
            if i + 1 < len(episodes):
                say(f"The other {len(episodes) - i - 1} episodes are not begun: {ends}.")
            break
    done = "were planned" if config.dry_run else "reached the goal"
    if recording is not None:
        done = "went as recorded"
    review = f" Review:  resync-robot review {path}" if path.exists() else ""
    say(f"{good} of {len(episodes)} episodes {done}.{review}")
    return 0 if good == len(episodes) and outcome.halt is not Halt.UNKNOWN and outcome.recorded else 3


def _domain(config: DeployConfig) -> Domain:
    """Raises ConfigError where it brings a robot of its own, and an option is given that this has no use for."""
    from resync_robot.commands.own_robot import check_own_robot
    from resync_robot.sim_training.domains import find_domain

    domain = find_domain(config.domain)
    if domain.embodiment is not None:
        check_own_robot(
            {
                f"--backend {config.backend}": config.backend != "sim",
                "--rig": config.rig is not None,
                "--perception camera": config.perception == "camera",
                "--skills camera": config.skills == "camera",
                f"--segmenter {config.segmenter}": config.segmenter != "colour",
            }
        )
    return domain


def _own_robot(config: DeployConfig, domain: Domain) -> _Robot:
    """That of a domain, in its own simulator. Raises LibraryError or UnknownNameError."""
    from resync_robot.core.library import load_library
    from resync_robot.deployment.own_robot import run_own_episode
    from resync_robot.library_models import learned_model, shipped_library

    domain.scenario(config.scenario)
    library = load_library(config.library or shipped_library(domain.name))
    model = learned_model(domain, None, library)
    config = replace(config, perception="oracle", skills="state")
    return _Robot(
        model,
        (f"Poses, also those that skills follow, from the simulator of {domain.name}.",),
        lambda task, _, path: run_own_episode(config, domain, library, model, task, path),
    )


def _arm(config: DeployConfig, domain: Domain, recording: Episode | None) -> _Robot:
    """The arm of a rig, with cameras: simulated, real, or recorded. Raises ResyncError."""
    from resync_robot.commands.sources import deployed_by_camera
    from resync_robot.core.library import load_library
    from resync_robot.core.rig import load_rig
    from resync_robot.deployment.episode import run_episode
    from resync_robot.deployment.replayed_episode import check_rig
    from resync_robot.library_models import camera_recovery, learned_model, shipped_library

    rig = load_rig(config.rig)
    if config.perception == "auto":
        config = replace(config, perception="camera")
    if config.backend == "ur7e":
        _check_rig(config, rig)
    if recording is None:
        domain.scenario(config.scenario)
    else:
        check_rig(recording, rig)
    library = load_library(config.library or shipped_library(domain.name))
    by_camera = deployed_by_camera(config, domain, rig, library)
    segmenter = _segmenter(config, rig)
    model = learned_model(domain, rig, library, [camera_recovery(domain, rig, library)] if by_camera else [])
    config = replace(config, skills="camera" if by_camera else "state")
    note = f"Note: the library was learned on another rig ({library.rig_hash}, this one is {rig.hash})."
    return _Robot(
        model,
        (*([note] if library.rig_hash != rig.hash else []), *_arm_notes(config, domain, rig, recording)),
        lambda task, i, path: run_episode(config, domain, rig, library, model, task, i, path, recording, segmenter),
    )


def _arm_notes(config: DeployConfig, domain: Domain, rig: Rig, recording: Episode | None) -> list[str]:
    """What to know of the cameras, of how fast the arm is, and of what is seen by camera."""
    from resync_robot.learning.camera_view import VIEWS

    # Over a recording nothing moves by it any more.
    complaints = calibration_complaints(config, rig) if recording is None else []
    notes = [f"Warning: {line}." for line in complaints]
    if complaints:
        notes.append(
            f"  -> resync-robot calibrate check --rig {config.rig or 'rig.toml'}; for a camera that never was: "
            "calibrate hand-eye --camera NAME"
        )
    backend = config.backend if recording is None else recording.meta.backend
    simulated = backend == "sim" or (rig.controller is not None and rig.controller.emulated)
    if rig.controller is not None and not rig.controller.full_speed:
        notes.append(
            "The tip moves at 250 mm/s at most, until [controller] full_speed = true says that somebody has watched a "
            "whole slow run."
        )
    noise = " (RGB-D with simulated noise)" if simulated else ""
    notes.append(
        f"Poses from the wrist camera{noise}."
        if config.perception == "camera"
        else "Poses from the simulator (--perception oracle)."
    )
    if config.skills == "camera":
        notes.append(f"{domain.recovery} sees pictures of {', '.join(VIEWS)}, the joints, and what the scan measured.")
    elif simulated:
        notes.append(
            f"{domain.recovery} follows its block through the simulator's state while it runs; "
            "everything else is estimated."
        )
    return notes


def calibration_complaints(config: DeployConfig, rig: Rig) -> list[str]:
    """What is old, bad or missing in the calibration of the rig's cameras, a line each.

    A simulated or emulated camera stands where the rig says it does; on a real rig every camera needs a calibration.
    """
    from datetime import date

    from resync_robot.core.calibration_record import complaints

    records = {camera.name: camera.calibration for camera in rig.cameras}
    real = config.backend == "ur7e" and not (rig.controller is not None and rig.controller.emulated)
    return complaints(records, rig.calibration_limits, date.today(), expected=real)


def _segmenter(config: DeployConfig, rig: Rig) -> Segmenter | None:
    """The one asked for, None for that by colour. Raises PerceptionError where it cannot be had."""
    if config.segmenter == "colour":
        return None
    from resync_robot.perception.objects import catalogue_of
    from resync_robot.perception.sam3 import sam3_segmenter

    return sam3_segmenter(rig.sam3, catalogue_of(rig), rig.where)


def _check_rig(config: DeployConfig, rig: Rig) -> None:
    """What the ur7e backend needs to know before anything is read or moved. Raises RobotError or ConfigError."""
    from resync_robot.hardware.ur7e import require_controller

    emulated = require_controller(rig).emulated
    if not emulated and config.perception == "oracle":
        raise ConfigError("no real robot knows where things are", "use --perception camera")


def _recording(config: DeployConfig) -> Episode | None:
    """What --backend replay runs over. Raises ConfigError or EpisodeError."""
    from resync_robot.console import say
    from resync_robot.core.episode import read_episode

    if config.backend != "replay":
        if config.replay is not None:
            raise ConfigError(f"--replay {config.replay} is for --backend replay", "add --backend replay, or leave it")
        return None
    if config.replay is None:
        raise ConfigError("--backend replay needs a recording", "give one with --replay EPISODE.mcap")
    if config.episodes != 1:
        raise ConfigError(f"--episodes is {config.episodes}; a recording holds one")
    recording = read_episode(config.replay, unbroken=True)
    if not recording.meta.rig:
        raise ConfigError(
            f"{recording.path} is of a robot of the domain's own, and a replay needs an arm",
            f"look at it: resync-robot review {recording.path}",
        )
    if recording.missing:
        # Each look is answered by the next one that was recorded; where one is missing, all later ones would be wrong.
        say(
            f"Warning: {recording.path} is not whole: {recording.loss}. A replay needs every look in its order, so it "
            f"has only what comes before the first that is missing: {recording.duration:.1f} s."
        )
    return recording


def _task(config: DeployConfig, domain: Domain, seed: int) -> Task:
    from resync_robot.sim_training.domains import world_task

    task = world_task(domain, config.scenario, config.seed, seed - config.seed)
    return task if config.goal is None else replace(task, goal=domain.parse_goal(config.goal, task.objects))
