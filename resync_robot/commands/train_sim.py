"""Training in simulation, stage by stage: mine failures, learn the recovery, dream, discover concepts, distil, save."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from resync_robot.core.errors import ConfigError, DiskError
from resync_robot.core.files import disk_fault
from resync_robot.given import Given

if TYPE_CHECKING:
    from collections.abc import Mapping

    from resync_robot.core.library import Library
    from resync_robot.core.task import Domain
    from resync_robot.curriculum.run_folder import RunFolder
    from resync_robot.curriculum.run_settings import RunSettings

QUICK_MINUTES = 34
"""Of --preset quick on two cores, with the camera policy; README says the same."""


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Learn from failures in simulation and write a library."""

    # None stands for what was not given: a run that is resumed keeps what it began with, and takes nothing else.

    domain: Given[str] = None
    """The domain to train in: a name, a file (path.py or path.py:NAME), or package.module:NAME. Default:
    cornered-insertion-s."""

    preset: Annotated[
        Literal["smoke", "quick", "full"] | None,
        tyro.conf.arg(
            help_behavior_hint="",
            help=f"How much to train: quick (default) takes about {QUICK_MINUTES} minutes on two cores, full is for a "
            "workstation, smoke only tests the way.",
        ),
    ] = None

    seed: Given[int] = None
    """Seed of every random draw. The same seed gives the same library on one machine. Default: 0."""

    out: Given[Path] = None
    """Folder of the run. Default: runs/DATE-DOMAIN."""

    resume: bool = False
    """Go on where the run in --out (default: the latest one of this domain) was cut off, with its own settings."""

    rig: Given[Path] = None
    """The robot and cameras to train for, a TOML file. Default: the rig that the simulation assumes."""

    device: Given[Literal["cpu", "cuda"]] = None
    """Where the arm's recovery and its camera policy are learned; cuda: the recovery in thousands of scenes in
    ManiSkill. All else runs on the CPU, the verdicts too. Default: cpu."""

    concepts: Given[Literal["default", "paper"]] = None
    """How predicates and operators are learned: this project's choices (default) or the published formulation."""

    skills: Given[Literal["camera", "state"]] = None
    """camera (default): teach the recovery to see by camera as well, at the end. state: leave it at the simulator's
    state."""

    stages: Given[str] = None
    """The stages to learn, by number or by the name of their recovery, separated by commas. Default: all that the
    domain declares, or those that the library of --from does not know."""

    library: Annotated[Path | None, tyro.conf.arg(name="from", help_behavior_hint="")] = None
    """A library to build on, a folder. Of another domain it only takes over the recoveries that stages here have as
    well, and their camera policies. Default: begin with the given model."""

    workers: int = 2
    """Simulation processes, for --device cpu."""


def train(config: TrainConfig) -> None:
    """Run every stage of `config` that its run folder does not hold yet, and save the library.

    Raises:
        ResyncError: bad input, a run folder that another process writes or whose files are damaged, a full disk, or a
            stage that cannot produce what the next one needs.
    """
    from resync_robot.commands.own_robot import check_own_robot
    from resync_robot.console import say
    from resync_robot.core.files import check_folder, write_json
    from resync_robot.core.lock import LOCK, sole_writer
    from resync_robot.core.options import MOST_WORKERS, check_range, check_seed
    from resync_robot.core.runs import default_folder, latest_folder
    from resync_robot.curriculum.run_folder import RunFolder
    from resync_robot.curriculum.run_settings import CONFIG, SHAPING, RunSettings
    from resync_robot.sim_training.domains import find_domain

    given = {name: getattr(config, name) for name in SHAPING if getattr(config, name) is not None}
    domain = find_domain(given.get("domain", RunSettings.domain))
    if "domain" in given:
        given["domain"] = domain.spec
    if config.library is not None:
        given["library"] = str(config.library.resolve())
    if domain.embodiment is not None:
        check_own_robot(
            {
                "--rig": config.rig is not None,
                "--device cuda": config.device == "cuda",
                "--skills camera": config.skills == "camera",
            }
        )
        given["skills"] = "state"
    begun = RunSettings(**given)
    check_seed(begun.seed)
    check_range("--workers", config.workers, 1, MOST_WORKERS)
    if config.resume:
        path = config.out or latest_folder(domain.name)
        if not (path / CONFIG).exists():
            raise ConfigError(f"{path} holds no run to resume", "start one without --resume")
    else:
        path = config.out or default_folder(domain.name)
    check_folder(path)
    with sole_writer(path / LOCK, path, "give another folder with --out"):
        settings, rig = _resumed(path, given) if config.resume else (_new(path, begun), None)
        folder = RunFolder(path)
        folder.sweep()
        folder.find_rig(rig, config.rig)
        folder.keep_rig(config.rig)
        _check_device(settings, folder)
        if settings.skills == "camera":
            _check_renderer()
        write_json(path / CONFIG, _kept(settings, folder))
        _quiet_threads()
        try:
            found = find_domain(settings.domain)
            _run(settings, config.workers, found, folder)
        except KeyboardInterrupt:
            say(f"What is done is kept. Go on with:  resync-robot train-sim --resume --out {path}")
            raise
        except Exception as error:
            fault = disk_fault(error)
            if fault is None:
                raise
            again = f"free space there, then go on: resync-robot train-sim --resume --out {path}"
            raise DiskError(fault.what, again) from None


def _new(path: Path, settings: RunSettings) -> RunSettings:
    """Refuse a folder in which something is left of another run, or is somebody else's: a run names its files without
    asking. Raises ConfigError."""
    from resync_robot.curriculum.run_folder import RIG_FILE

    if (path / "config.json").exists():
        raise ConfigError(f"{path} already holds a run", "add --resume to go on with it, or give another --out")
    if (path / "stages").is_dir() and any((path / "stages").iterdir()):
        raise ConfigError(
            f"{path / 'stages'} is left of a run whose config.json is gone",
            "remove it, or give another --out",
        )
    # The two are what a run leaves that was refused before it began.
    others = [p.name for p in path.iterdir() if p.name not in ("stages", RIG_FILE) and not p.name.startswith(".")]
    if others:
        raise ConfigError(f"{path} holds other files, such as {min(others)}", "give a new folder with --out")
    return settings


def _resumed(path: Path, given: Mapping[str, Any]) -> tuple[RunSettings, str | None]:
    from resync_robot.curriculum.run_settings import read_settings
    from resync_robot.sim_training.domains import find_domain

    return read_settings(path, given, find_domain)


def _kept(settings: RunSettings, folder: RunFolder) -> dict[str, Any]:
    """What config.json holds: with it a run goes on, and anybody sees how its library came about."""
    from dataclasses import asdict

    from resync_robot.core.runs import git_hash

    return {**asdict(settings), "rig": folder.rig.hash, "git": git_hash()}


def _origin(settings: RunSettings, folder: RunFolder, domain: Domain, library: Library | None) -> dict[str, Any]:
    """The same for a library, which is handed on: it names no files of this machine."""
    built_on = f"{library.domain} {library.content_hash}" if library is not None else ""
    return {**_kept(settings, folder), "domain": domain.name, "library": built_on}


def _check_device(settings: RunSettings, folder: RunFolder) -> None:
    if settings.device == "cuda":
        import torch

        from resync_robot.core.rig import load_rig

        if not torch.cuda.is_available():
            raise ConfigError(
                "--device cuda: no CUDA device is visible", "use --device cpu, or see resync-robot doctor"
            )
        if folder.rig.hash != load_rig().hash:
            raise ConfigError(
                f"--device cuda: its scenes are built for the simulated rig, not for '{folder.rig.name}'",
                "use --device cpu",
            )
        if not any(folder.stages.glob("*/recovery.json")):
            from resync_robot.sim_training.physics.gpu import require_gpu_physics

            require_gpu_physics()


def _check_renderer() -> None:
    """What only the last stage needs is missed at once. Raises RenderError."""
    from resync_robot.core.errors import RenderError
    from resync_robot.sim_training.physics.scene import require_renderer

    try:
        require_renderer()
    except RenderError as error:
        raise RenderError(error.what, f"{error.fix}; or leave the camera policy out with --skills state") from None


def _quiet_threads() -> None:
    """One thread a process: the scenes are the parallelism."""
    import os

    import torch

    os.environ.setdefault("OMP_NUM_THREADS", "1")
    torch.set_num_threads(1)


def _run(settings: RunSettings, workers: int, domain: Domain, folder: RunFolder) -> None:
    from importlib.metadata import version

    from resync_robot import __version__
    from resync_robot.console import Stages, say
    from resync_robot.core.library import load_library
    from resync_robot.curriculum.learn_stages import Curriculum, chosen_stages, learn_stages
    from resync_robot.curriculum.report import report
    from resync_robot.curriculum.taken_over import check_taken_over

    known_at = Path(settings.library) if settings.library else None
    known = load_library(known_at) if known_at is not None else None
    elsewhere = known if known is not None and known.domain != domain.name else None
    known = None if elsewhere is not None else known
    stages = chosen_stages(domain, settings.stages, known)
    if elsewhere is not None:
        check_taken_over(stages, elsewhere, domain, settings.skills == "camera")
    arm = domain.embodiment is None
    origin = _origin(settings, folder, domain, known or elsewhere)
    packages = {p: version(p) for p in ("torch", "numpy", "pyperplan", *(("lerobot", "sapien") if arm else ()))}
    curriculum = Curriculum(
        domain=domain,
        stages=stages,
        preset=settings.preset,
        seed=settings.seed,
        workers=workers,
        concepts=settings.concepts,
        provenance={**origin, "version": __version__, "packages": packages},
        rig=folder.rig if arm else None,
        known=known,
        known_at=known_at,
        elsewhere=elsewhere,
        by_camera=settings.skills == "camera",
        device=settings.device,
    )
    first = len(known.stages) + 1 if known is not None else 1
    names = [f"{number}-{s.recovery}/{step}" for number, s in enumerate(stages, first) for step in curriculum.steps(s)]
    with Stages(tuple(names)) as bars:
        library = learn_stages(curriculum, folder, bars.stage)
    say("\n" + report(domain, library))
    say(f"Library: {folder.library}")
