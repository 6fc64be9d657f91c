"""Evaluation: methods x scenarios x seeds, as a table with confidence intervals."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from resync_robot.commands.evaluated_episode import METHODS, Job, methods_context, run_job
from resync_robot.core.damage import check_shape
from resync_robot.core.errors import ConfigError, RenderError, UnknownNameError
from resync_robot.core.options import DEFAULT_DOMAIN, MOST_EPISODES, MOST_STEPS, MOST_WORKERS, check_range, check_seeds
from resync_robot.evaluation.report import EPISODE, EpisodeRow, count_once, report, table
from resync_robot.given import Given, Several

if TYPE_CHECKING:
    from resync_robot.core.task import Domain

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig:
    """Measure success rates in simulated worlds that no training has seen."""

    domain: str = DEFAULT_DOMAIN
    """The domain to evaluate in: a name, a file (path.py or path.py:NAME), or package.module:NAME."""

    library: Several[Path] = ()
    """Library folders, one for each training seed. Default: the shipped one."""

    methods: tuple[str, ...] = ("resync",)
    """Methods to compare, separated by spaces or commas: resync, rc, initial, human (the right sequence given)."""

    scenarios: tuple[str, ...] = ("all",)
    """Scenarios, separated by spaces or commas: all, train, test, or names such as s0 s1."""

    seeds: tuple[int, ...] = (0,)
    """Seeds of the worlds: a world is a pure function of domain, scenario, seed and episode."""

    episodes: int = 10
    """Episodes for each library, method, scenario and seed."""

    perception: Literal["auto", "camera", "oracle"] = "auto"
    """Where poses come from: RGB-D pictures, or the simulator's own state, which is several times faster. auto:
    pictures, where every library holds a camera policy that recovered in at least half of its trials."""

    skills: Literal["auto", "camera", "state"] = "auto"
    """What the learned skills see while they run: pictures, joints and the scan, or the simulator's state. auto:
    pictures, where poses come from the camera too and every library holds such a camera policy."""

    worlds: Literal["usual", "unseen", "hard", "reference"] = "usual"
    """unseen: friction, masses, sizes up to a tenth beyond the edges of training; surfaces and lights it never had.
    hard: usual ones under a single lamp that casts dark shadows. reference: usual ones with --physics reference."""

    physics: Literal["shipped", "reference"] = "shipped"
    """reference: contacts solved much more finely, at over ten times the price: the yardstick of the shipped ones."""

    horizon: Given[int] = None
    """Control steps after which an episode is given up. Default: no such limit."""

    rig: Given[Path] = None
    """The robot and cameras to simulate, a TOML file. Default: the rig that the simulation assumes."""

    perception_only: bool = False
    """Move nothing: only scan random scenes and compare what was seen with what is there."""

    scenes: int = 300
    """Scenes for each seed, with --perception-only."""

    workers: int = 2
    """Simulation processes."""

    resume: bool = False
    """Go on with the unfinished evaluation in the --json file: episodes that it holds are not run again."""

    json: Given[Path] = None
    """File for the counts by library and seed, the success rates, every episode, and the provenance. With
    --perception-only: for the errors, and a picture of how honest their covariance is beside it."""


def evaluate(config: EvaluateConfig) -> None:
    """Run every episode of `config`, write the JSON file where one is named, and print the table. With
    `perception_only`, scan scenes instead.

    The file holds three lists and a record, whose names and fields stay as they are:

    - `rows`, one for each scenario, method, library and seed: `domain`, `scenario`, `split` ("train" or "test"),
      `method`, `library` (its index), `library_hash`, `seed`, `episodes`, `successes`, `failure_reasons` (end and cause
      without arguments and numbers -> how many episodes; they and the successes add up to the episodes),
      `recoveries_per_episode` (mean number of runs of the skills that stages learn, needless ones included).
    - `summary`, first one for each split and method, then one for each scenario and method, over all libraries and
      seeds: `domain`, `split`, `scenario` (null where the whole split is meant), `method`, `success_rate`, `ci95`
      ([low, high], Wilson), `n` (episodes), `recoveries_per_episode`.
    - `episodes`, one for each episode that was run: the fields of `EpisodeRow`.
    - `provenance`: `version` and `git` of the program, `domain`, `libraries` (content hashes, by index), `perception`,
      `skills`, `worlds`, `physics`, `rig` (its hash), `seeds`, `episodes`, the number for each row, and `planned`, the
      number of all: an evaluation that was interrupted holds fewer, and goes on with `resume`.

    Raises:
        ResyncError: bad input, or a library that cannot be used.
    """
    from resync_robot import __version__
    from resync_robot.commands.own_robot import check_own_robot
    from resync_robot.commands.sources import evaluated_sources, in_words
    from resync_robot.console import Stages, say
    from resync_robot.core.library import load_library
    from resync_robot.core.rig import load_rig
    from resync_robot.core.runs import git_hash
    from resync_robot.evaluation.result_file import ResultFile
    from resync_robot.library_models import shipped_library
    from resync_robot.sim_training.domains import find_domain
    from resync_robot.sim_training.parallel import parallel_map

    check_seeds(config.seeds)
    check_range("--workers", config.workers, 1, MOST_WORKERS)
    if config.perception_only:
        from resync_robot.evaluation.perception import evaluate_perception

        usual = EvaluateConfig()
        used = ("perception_only", "scenes", "worlds", "seeds", "workers", "json", "resume", "rig")
        given = [
            f.name for f in fields(config) if f.name not in used and getattr(config, f.name) != getattr(usual, f.name)
        ]
        if given:
            raise ConfigError(f"--{given[0]} has no meaning with --perception-only", "leave it out")
        return evaluate_perception(
            config.scenes, config.seeds, config.workers, config.json, config.rig, config.resume, config.worlds
        )
    check_range("--episodes", config.episodes, 1, MOST_EPISODES)
    if config.horizon is not None:
        check_range("--horizon", config.horizon, 1, MOST_STEPS)
    domain = find_domain(config.domain)
    if domain.embodiment is not None:
        check_own_robot(
            {
                "--rig": config.rig is not None,
                "--perception camera": config.perception == "camera",
                "--skills camera": config.skills == "camera",
                f"--worlds {config.worlds}": config.worlds not in ("usual", "unseen"),
                f"--physics {config.physics}": config.physics != "shipped",
            }
        )
    rig = load_rig(config.rig) if domain.embodiment is None else None
    methods, scenarios = _methods(config.methods), _scenarios(config.scenarios, domain)
    seeds = count_once("seed", config.seeds)
    # By content: the same library under two names is one.
    found = {path: load_library(path) for path in config.library or (shipped_library(domain.name),)}
    by_hash = {library.content_hash: path for path, library in reversed(found.items())}
    hashes = count_once(
        "the library",
        [found[path].content_hash for path in config.library or found],
        lambda content: str(by_hash[content]),
    )
    paths = [by_hash[content] for content in hashes]
    libraries = [found[path] for path in paths]
    perception, skills, note = "oracle", "state", ""
    if domain.embodiment is None:
        perception, skills, note = evaluated_sources(
            config.perception, config.skills, domain, dict(zip(paths, libraries, strict=True))
        )
    if not methods or not scenarios:
        raise ConfigError(f"--{'scenarios' if methods else 'methods'} names none", "name one, or leave it out")
    jobs = [
        Job(library, method, scenario, seed, episode)
        for scenario in scenarios
        for method in methods
        for library in range(len(paths))
        for seed in seeds
        for episode in range(config.episodes)
    ]
    physics = "reference" if config.worlds == "reference" else config.physics
    file = ResultFile(
        path=config.json,
        jobs=jobs,
        rows="episodes",
        settings={
            "version": __version__,
            "git": git_hash(),
            "domain": domain.name,
            "libraries": list(hashes),
            "perception": perception,
            "skills": skills,
            "worlds": config.worlds,
            "physics": physics,
            "rig": rig.hash if rig is not None else "",
            **({"horizon": config.horizon} if config.horizon is not None else {}),
        },
        more={"seeds": list(seeds), "episodes": config.episodes},
        inputs=[config.rig],
        report=lambda rows: report(rows, domain, hashes),
        parse=_parse,
    )
    drawn = (config.worlds, physics == "reference", config.horizon)
    context = partial(methods_context, domain.spec, tuple(map(str, paths)), perception, skills, *drawn, rig)
    # Written before the table, so that it is kept where nobody reads that.
    with file.open(config.resume), _naming_the_way_without_pictures():
        if note:
            _log.info(note)
        with Stages(("evaluate",)) as bars, bars.stage("evaluate") as progress:
            todo = file.todo
            for job, row in zip(todo, parallel_map(run_job, todo, context, config.workers), strict=True):
                file.add(job, row)
                if not row.success:
                    _log.info(
                        "%s on %s, episode %d: %s, %s", row.method, row.scenario, row.episode, row.end, row.reason
                    )
                wins, count = sum(r.success for r in file.done.values()), len(file.done)
                progress(count / len(jobs), f"{wins} of {count} episodes reached their goal")
    sources = in_words(domain, perception, skills) if domain.embodiment is None else "exact state"
    say(table(file.found, methods, scenarios, sources))


@contextmanager
def _naming_the_way_without_pictures() -> Iterator[None]:
    """Where no device can render, the error says how to go on without. Raises RenderError."""
    try:
        yield
    except RenderError as error:
        raise RenderError(error.what, f"{error.fix}; or do without pictures: --perception oracle") from None


def _methods(given: Sequence[str]) -> tuple[str, ...]:
    names = [n for g in given for n in g.split(",") if n]
    for name in names:
        if name not in METHODS:
            raise UnknownNameError("method", name, METHODS)
    return count_once("method", names)


def _scenarios(given: Sequence[str], domain: Domain) -> tuple[str, ...]:
    names: list[str] = []
    for name in (n for g in given for n in g.split(",") if n):
        wanted = {"all": (True, False), "train": (True,), "test": (False,)}.get(name)
        if wanted is None:
            names.append(domain.scenario(name).name)
        else:
            names += [s.name for s in domain.scenarios.values() if s.training in wanted]
    return count_once("scenario", names)


def _parse(entry: Any) -> tuple[Job, EpisodeRow]:
    """A row of a file that an earlier evaluation left. Raises KeyError, TypeError or ValueError."""
    check_shape(entry, EPISODE)
    if not isinstance(entry.get("steps"), int | None):
        raise ValueError(f"'steps' is {entry['steps']!r}, and should be a number")
    row = EpisodeRow(**{**entry, "skills_run": tuple(entry["skills_run"])})
    return Job(row.library, row.method, row.scenario, row.seed, row.episode), row
