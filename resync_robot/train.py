"""Training in simulation, stage by stage: mine failures, learn the recovery, dream, discover concepts, distil, save."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from resync_robot.core.errors import ConfigError, TrainingError

if TYPE_CHECKING:
    from resync_robot.core.library import Record
    from resync_robot.core.task import Domain
    from resync_robot.learning.failures import PairGaussian
    from resync_robot.learning.model import Concepts
    from resync_robot.run_folder import RunFolder
    from resync_robot.stages import Mined


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Learn from failures in simulation and write a library."""

    domain: str = "cornered-insertion-s"
    """The domain to train in."""

    preset: Literal["smoke", "quick", "full"] = "quick"
    """How much to train: quick fits two cores in half an hour, full is for a workstation, smoke only tests the way."""

    seed: int = 0
    """Seed of every random draw. The same seed gives the same library on one machine."""

    out: Path | None = None
    """Folder of the run. Default: runs/DATE-DOMAIN."""

    resume: bool = False
    """Go on where the run in --out (default: the latest one of this domain) was cut off."""

    rig: Path | None = None
    """The robot and cameras to train for, a TOML file. Default: the rig that the simulation assumes."""

    device: Literal["cpu", "cuda"] = "cpu"
    """Where the recovery is learned; cuda: thousands of scenes in ManiSkill. The other stages run on the CPU."""

    concepts: Literal["default", "paper"] = "default"
    """How predicates and operators are learned: this project's choices or the published formulation."""

    skills: Literal["camera", "state"] = "camera"
    """camera: teach the recovery to see by camera as well, at the end. state: leave it at the simulator's state."""

    workers: int = 2
    """Simulation processes, for --device cpu."""


def train(config: TrainConfig) -> None:
    """Run every stage of `config` that its run folder does not hold yet, and save the library.

    Raises:
        ResyncError: bad input, or a stage that cannot produce what the next one needs.
    """
    from resync_robot import run_folder
    from resync_robot.progress import say
    from sim_training.domains import find_domain

    domain = find_domain(config.domain)
    if config.seed < 0:
        raise ConfigError(f"--seed is {config.seed}", "give a whole number from 0 on")
    if config.resume:
        path = config.out or run_folder.latest_folder(config.domain)
        config = _resumed(path, config)
    else:
        path = config.out or run_folder.default_folder(config.domain)
        if (path / "config.json").exists():
            raise ConfigError(f"{path} already holds a run", "add --resume to go on with it, or give another --out")
    folder = run_folder.RunFolder(path)
    folder.keep_rig(config.rig)
    _check_device(config, folder)
    if config.skills == "camera":
        _check_renderer()
    run_folder.write_json(path / "config.json", _settings(config))
    _quiet_threads()
    try:
        _run(config, domain, folder)
    except KeyboardInterrupt:
        say(f"What is done is kept. Go on with:  resync-robot train-sim --resume --out {path}")
        raise


SHAPING = ("domain", "preset", "seed", "concepts", "device", "skills")
"""Settings that decide the outcome; a resumed run keeps those it began with."""


def _settings(config: TrainConfig) -> dict[str, Any]:
    from resync_robot.run_folder import git_hash

    return {name: getattr(config, name) for name in SHAPING} | {"git": git_hash()}


def _resumed(path: Path, config: TrainConfig) -> TrainConfig:
    from dataclasses import replace

    from resync_robot.run_folder import read_json

    saved = read_json(path / "config.json")
    if saved is None:
        raise ConfigError(f"{path} holds no run to resume", "start one without --resume")
    if not isinstance(saved, dict) or not set(SHAPING) <= set(saved):
        raise ConfigError(f"{path / 'config.json'} is not the config of a run", "start a new run without --resume")
    return replace(config, **{name: saved[name] for name in SHAPING}, out=path)


def _check_device(config: TrainConfig, folder: RunFolder) -> None:
    if config.device == "cuda":
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


def _check_renderer() -> None:
    """What only the last stage needs is missed at once. Raises RenderError."""
    from resync_robot.core.errors import RenderError
    from sim_training.scene import require_renderer

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


def _run(config: TrainConfig, domain: Domain, folder: RunFolder) -> None:
    from resync_robot import stages
    from resync_robot.distil import PLANS, distil
    from resync_robot.learning.concepts import learn_concepts
    from resync_robot.progress import Stages

    preset = stages.PRESETS[config.preset]
    w, seed = config.workers, config.seed
    names = [
        "mine",
        "recover",
        "check",
        "dream",
        "concepts",
        *(["distil"] if config.skills == "camera" else []),
        "save",
    ]
    with Stages(tuple(names)) as bars:
        with folder.timed("mine"), bars.stage("mine") as progress:
            mined = stages.mine(domain, folder, preset, seed, w, progress)
        with folder.timed("recovery"), bars.stage("recover") as progress:
            record, after = stages.learn_recovery(domain, folder, preset, mined, seed, w, progress, config.device)
        with folder.timed("check"), bars.stage("check") as progress:
            if "worlds" not in folder.metrics.get("check", {}):
                first = seed * stages.TRAINING_SEEDS + 400_000
                folder.record(
                    "check",
                    stages.check_recovery(domain, folder.rig, mined, record, first, preset.proxy_checks, w, progress),
                )
        gaussians = {"before": mined.before, "after": after}
        with folder.timed("dream"), bars.stage("dream") as progress:
            trajectories = stages.dream_all(domain, folder, preset, record, gaussians, seed, w, progress)
        with folder.timed("concepts"), bars.stage("concepts") as progress:
            types = (domain.operators[0].parameters[0].type, mined.relevant.type, mined.culprit.failure_object.type)
            concepts = learn_concepts(
                trajectories,
                domain,
                domain.recovery,
                types,
                mined.culprit.skill,
                config.concepts,
                seed,
                lambda what, share: progress(share, what),
            )
            if not any(o.name == domain.recovery for o in concepts.operators):
                raise TrainingError(
                    f"no operator was learned for {domain.recovery}", "train with more dreams: --preset full"
                )
        policy = None
        if config.skills == "camera":
            with folder.timed("distil"), bars.stage("distil") as progress:
                plan = PLANS[config.preset]
                policy = distil(domain, folder, plan, record, gaussians, seed, w, config.device, progress)
        with folder.timed("save"), bars.stage("save"):
            _save(config, domain, folder, mined, record, gaussians, concepts, policy)
    _report(domain, folder, concepts)


def _save(
    config: TrainConfig,
    domain: Domain,
    folder: RunFolder,
    mined: Mined,
    record: Record,
    gaussians: dict[str, PairGaussian],
    concepts: Concepts,
    policy: dict[str, bytes] | None,
) -> None:
    from importlib.metadata import version

    from resync_robot import __version__
    from resync_robot.core.library import save_library
    from resync_robot.knowledge import make_library
    from resync_robot.plots import draw_learning_curve

    metrics = folder.metrics
    folder.record("concepts", {"report": concepts.report})
    culprit = mined.culprit
    provenance = {
        **_settings(config),
        "version": __version__,
        "packages": {p: version(p) for p in ("torch", "lerobot", "sapien", "numpy", "pyperplan")},
        "failure": {
            "skill": culprit.skill,
            "object": culprit.failure_object.name,
            "relevant": mined.relevant.name,
        },
        "figures": {s: {k: v for k, v in f.items() if k not in ("curve", "report")} for s, f in metrics.items()},
    }
    library = make_library(domain, folder.rig, record, gaussians, concepts, provenance, policy)
    save_library(library, folder.library)
    folder.record("save", {"content_hash": library.content_hash})
    draw_learning_curve(metrics["recovery"]["curve"], folder.path / "recovery.png")


def _report(domain: Domain, folder: RunFolder, concepts: Concepts) -> None:
    from resync_robot.planning.pddl import operator_to_pddl
    from resync_robot.progress import say

    m = folder.metrics
    given = {o.name: o for o in domain.operators}
    say(f"\nFailure: {m['mine']['failed']} of {m['mine']['tasks']} tasks failed; mined {m['mine']['kept']} more.")
    check = m["check"]
    say(
        f"Recovery: learned in {m['recovery']['steps'] / 1000:.0f} k control steps; followed by a real pick in "
        f"{check['picked']} of {check['worlds']} fresh worlds."
    )
    if "distil" in m:
        chosen = next(p for p in m["distil"]["points"] if p["step"] == m["distil"]["chosen"])
        say(f"By camera: recovered in {chosen['success']} of {chosen['worlds']} worlds of its own.")
    learned = [p for p in concepts.predicates if p.name not in {q.name for q in domain.predicates}]
    say(
        "Discovered predicates: "
        + (", ".join(f"{p.name}({', '.join(t.name for t in p.types)})" for p in learned) or "none")
    )
    say("Operators (those marked * are new or differ from the given model):")
    for operator in concepts.operators:
        mark = "  " if given.get(operator.name) == operator else "* "
        say("\n".join(mark + line for line in operator_to_pddl(operator).splitlines()))
    total = sum(v.get("seconds", 0.0) for v in m.values() if isinstance(v, dict))
    say(f"Library: {folder.library} ({total / 60:.1f} min)")
