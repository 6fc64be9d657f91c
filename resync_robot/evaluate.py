"""Evaluation: methods x scenarios x seeds, as a table with confidence intervals."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

from resync_robot.core.errors import ConfigError, UnknownNameError
from resync_robot.evaluation_report import EpisodeRow, report, table

if TYPE_CHECKING:
    from resync_robot.core.library import Library
    from resync_robot.core.rig import Rig
    from resync_robot.core.skill import GroundSkill
    from resync_robot.core.symbols import Atoms
    from resync_robot.core.task import Domain
    from resync_robot.core.world import World
    from resync_robot.doubt import DoubtingAbstraction
    from resync_robot.planning.abstract import Abstraction
    from resync_robot.planning.execute import Listener, Result
    from resync_robot.planning.search import Plan

_log = logging.getLogger(__name__)

METHODS = ("resync", "rc", "initial", "human")
"""This project's, Recovery Chaining, the given model alone, and the right sequence of skills given by a person."""


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig:
    """Measure success rates in simulated worlds that no training has seen."""

    domain: str = "cornered-insertion-s"
    """The domain to evaluate in."""

    library: tuple[Path, ...] = ()
    """Library folders, one for each training seed. Default: the shipped one."""

    methods: tuple[str, ...] = ("resync",)
    """Methods to compare, separated by spaces or commas: resync, rc, initial, human (the right sequence given)."""

    scenarios: tuple[str, ...] = ("all",)
    """Scenarios, separated by spaces or commas: all, train, test, or names such as s0 s1."""

    seeds: tuple[int, ...] = (0,)
    """Seeds of the worlds: a world is a pure function of domain, scenario, seed and episode."""

    episodes: int = 10
    """Episodes for each library, method, scenario and seed."""

    perception: Literal["camera", "oracle"] = "oracle"
    """Where poses come from: RGB-D pictures, or the simulator's own state."""

    skills: Literal["auto", "camera", "state"] = "auto"
    """What the learned skills see while they run: pictures, joints and the scan, or the simulator's state. auto:
    pictures, where poses come from the camera too and the library holds a camera policy."""

    worlds: Literal["usual", "unseen"] = "usual"
    """unseen: friction, masses, sizes up to a tenth beyond the edges of training; surfaces and lights it never had."""

    rig: Path | None = None
    """The robot and cameras to simulate, a TOML file. Default: the rig that the simulation assumes."""
    perception_only: bool = False
    """Move nothing: only scan random scenes and compare what was seen with what is there."""

    scenes: int = 300
    """Scenes for each seed, with --perception-only."""

    workers: int = 2
    """Simulation processes."""

    json: Path | None = None
    """File for the counts by library and seed, the success rates, every episode, and the provenance. With
    --perception-only: for the errors, and a picture of how honest their covariance is beside it."""


@dataclass(frozen=True)
class Job:
    """One episode to run."""

    library: int
    method: str
    scenario: str
    seed: int
    episode: int


def evaluate(config: EvaluateConfig) -> None:
    """Run every episode of `config`, write the JSON file where one is named, and print the table. With
    `perception_only`, scan scenes instead.

    The file holds three lists and a record, whose names and fields stay as they are:

    - `rows`, one for each scenario, method, library and seed: `domain`, `scenario`, `split` ("train" or "test"),
      `method`, `library` (its index), `library_hash`, `seed`, `episodes`, `successes`, `failure_reasons` (end and cause
      without arguments and numbers -> how many episodes; they and the successes add up to the episodes),
      `recoveries_per_episode` (mean number of runs of the domain's recovery skill, needless ones included).
    - `summary`, first one for each split and method, then one for each scenario and method, over all libraries and
      seeds: `domain`, `split`, `scenario` (null where the whole split is meant), `method`, `success_rate`, `ci95`
      ([low, high], Wilson), `n` (episodes), `recoveries_per_episode`.
    - `episodes`, one for each episode that was run: the fields of `EpisodeRow`.
    - `provenance`: `version` and `git` of the program, `libraries` (content hashes, by index), `perception`, `skills`,
      `worlds`, `rig` (its hash), `seeds`, and `episodes`, the number for each row.

    Raises:
        ResyncError: bad input, or a library that cannot be used.
    """
    from resync_robot import __version__
    from resync_robot.core.library import load_library
    from resync_robot.core.ranges import MOST_EPISODES, MOST_WORKERS, check_range, check_seeds
    from resync_robot.core.rig import load_rig
    from resync_robot.knowledge import shipped_library
    from resync_robot.progress import Stages, say
    from resync_robot.run_folder import check_writable, git_hash, write_json
    from sim_training.domains import find_domain
    from sim_training.parallel import parallel_map

    if config.perception_only:
        from resync_robot.evaluate_perception import evaluate_perception

        usual = EvaluateConfig()
        used = ("perception_only", "scenes", "seeds", "workers", "json", "rig")
        given = [
            f.name for f in fields(config) if f.name not in used and getattr(config, f.name) != getattr(usual, f.name)
        ]
        if given:
            raise ConfigError(f"--{given[0]} has no meaning with --perception-only", "leave it out")
        return evaluate_perception(config.scenes, config.seeds, config.workers, config.json, config.rig)
    check_range("--episodes", config.episodes, 1, MOST_EPISODES)
    check_seeds(config.seeds)
    check_range("--workers", config.workers, 1, MOST_WORKERS)
    domain, rig = find_domain(config.domain), load_rig(config.rig)
    methods, scenarios = _methods(config.methods), _scenarios(config.scenarios, domain)
    if config.json:
        check_writable(config.json)
    paths = config.library or (shipped_library(domain.name),)
    libraries = [load_library(path) for path in paths]
    hashes = [library.content_hash for library in libraries]
    skills = _skills(config, domain, libraries)
    jobs = [
        Job(library, method, scenario, seed, episode)
        for scenario in scenarios
        for method in methods
        for library in range(len(paths))
        for seed in config.seeds
        for episode in range(config.episodes)
    ]
    context = partial(_context, config.domain, tuple(map(str, paths)), config.perception, skills, config.worlds, rig)
    done: list[EpisodeRow] = []
    with Stages(("evaluate",)) as bars, bars.stage("evaluate") as progress:
        for row in parallel_map(_run, jobs, context, config.workers):
            done.append(row)
            if not row.success:
                _log.info("%s on %s, episode %d: %s, %s", row.method, row.scenario, row.episode, row.end, row.reason)
            wins = sum(r.success for r in done)
            progress(len(done) / len(jobs), f"{wins} of {len(done)} episodes reached their goal")
    if config.json:
        # Before the table, so that it is kept where nobody reads that.
        provenance = {
            "version": __version__,
            "git": git_hash(),
            "libraries": hashes,
            "perception": config.perception,
            "skills": skills,
            "worlds": config.worlds,
            "rig": rig.hash,
            "seeds": list(config.seeds),
            "episodes": config.episodes,
        }
        write_json(config.json, {"provenance": provenance, **report(done, domain, hashes)})
    say(table(done, methods, scenarios))


def _skills(config: EvaluateConfig, domain: Domain, libraries: Sequence[Library]) -> str:
    """ "camera" or "state", after a look at what there is. Raises ConfigError."""
    if config.skills == "camera" and config.perception == "oracle":
        raise ConfigError("--skills camera needs cameras", "add --perception camera")
    if config.skills != "auto":
        return config.skills
    from resync_robot.knowledge import sees_by_camera

    with_policy = all(sees_by_camera(domain, library) for library in libraries)
    return "camera" if config.perception == "camera" and with_policy else "state"


def _methods(given: Sequence[str]) -> tuple[str, ...]:
    names = tuple(n for g in given for n in g.split(",") if n)
    for name in names:
        if name not in METHODS:
            raise UnknownNameError("method", name, METHODS)
    return names


def _scenarios(given: Sequence[str], domain: Domain) -> tuple[str, ...]:
    names: list[str] = []
    for name in (n for g in given for n in g.split(",") if n):
        wanted = {"all": (True, False), "train": (True,), "test": (False,)}.get(name)
        if wanted is None:
            names.append(domain.scenario(name).name)
        else:
            names += [s.name for s in domain.scenarios.values() if s.training in wanted]
    return tuple(dict.fromkeys(names))


class _Method(Protocol):
    def __call__(self, world: World, *, goal: Atoms, listener: Listener) -> Result: ...


@dataclass(frozen=True)
class _Context:
    domain: Domain
    rig: Rig
    perception: str
    unseen: bool
    given: Abstraction
    methods: dict[tuple[int, str], tuple[DoubtingAbstraction, _Method]]


def _context(domain_name: str, paths: tuple[str, ...], perception: str, skills: str, worlds: str, rig: Rig) -> _Context:
    from resync_robot.baselines.human_sequence import run_human_sequence
    from resync_robot.baselines.recovery_chaining import RecoveryChaining
    from resync_robot.core.library import load_library
    from resync_robot.doubt import doubting
    from resync_robot.knowledge import camera_recovery, initial_model, learned_model, model_with_recovery
    from resync_robot.planning.execute import plan_f
    from sim_training.domains import find_domain

    domain = find_domain(domain_name)
    initial = doubting(initial_model(domain, rig))
    methods: dict[tuple[int, str], tuple[DoubtingAbstraction, _Method]] = {}
    for i, path in enumerate(paths):
        library = load_library(Path(path))
        # First, for it says what a library lacks.
        recovery = camera_recovery(domain, rig, library) if skills == "camera" else None
        learned = doubting(learned_model(domain, rig, library, recovery))
        methods[i, "resync"] = learned.abstraction, partial(plan_f, model=learned)
        record = library.skills[domain.recovery]
        with_skill = doubting(model_with_recovery(domain, rig, record, recovery))
        reaction = RecoveryChaining(with_skill.skill(domain.recovery), record)
        given = initial.abstraction
        methods[i, "rc"] = given, partial(plan_f, model=with_skill, reaction=reaction)
        methods[i, "initial"] = given, partial(plan_f, model=initial)
        methods[i, "human"] = given, partial(run_human_sequence, model=with_skill, expert=domain.expert)
    return _Context(domain, rig, perception, worlds == "unseen", initial.abstraction, methods)


def _run(context: _Context, job: Job) -> EpisodeRow:
    import time

    from resync_robot.planning.execute import End, Listener, Result
    from sim_training.domains import world_task
    from sim_training.mine import is_at_rest
    from sim_training.world import SimWorld

    class Notes(Listener):
        """Of an episode that ends in a fault it is all there is."""

        def __init__(self) -> None:
            self.skills: list[str] = []
            self.planning_s = 0.0

        def on_plan(self, plan: Plan, reason: str) -> None:
            self.planning_s = max(self.planning_s, plan.seconds)

        def on_skill_start(self, skill: GroundSkill) -> None:
            self.skills.append(str(skill))

    abstraction, method = context.methods[job.library, job.method]
    notes = Notes()
    begun = time.monotonic()
    # A scene that does not stand still is not a task; the next one takes its place.
    for attempt in range(20):
        task = world_task(context.domain, job.scenario, job.seed, job.episode + 1_000_000 * attempt, context.unseen)
        world = SimWorld(task, context.rig)
        if is_at_rest(world):
            break
    if context.perception == "oracle":
        result = method(world, goal=task.goal, listener=notes)
        reached = result.success
    else:
        from hardware.base import RobotError
        from resync_robot.backends import open_simulated
        from resync_robot.core.errors import MotionError, PerceptionError
        from resync_robot.deployed_world import DeployedWorld

        with open_simulated(task, context.rig) as devices:
            seen = DeployedWorld(
                devices.robot, devices.cameras, context.rig, task.objects, devices.truth, abstraction=abstraction
            )
            try:
                result = method(seen, goal=task.goal, listener=notes)
                # What the robot believes at the end does not count; what is true does.
                reached = task.goal <= context.given.true_atoms(devices.truth())
            except (PerceptionError, MotionError, RobotError) as error:
                result, reached = Result(End.FAULT, error.what, (), (), devices.truth()), False
    return EpisodeRow(
        **vars(job),
        success=reached,
        end=result.end.value,
        reason=result.reason,
        skills=len(notes.skills),
        planning_s=notes.planning_s,
        seconds=time.monotonic() - begun,
        skills_run=tuple(notes.skills),
    )
