"""What an evaluation found, as a table and as JSON: success rates, their intervals, why episodes failed."""

from __future__ import annotations

import logging
import re
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from resync_robot.core.damage import Shape
from resync_robot.core.intervals import wilson

if TYPE_CHECKING:
    from resync_robot.core.task import Domain

_log = logging.getLogger(__name__)

Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class EpisodeRow:
    """How one episode went.

    Attributes:
        library: index of the library among those evaluated.
        success: the goal held in the end; in truth, whatever was perceived.
        end, reason: an `End`'s value, and in which words it was reported.
        skills: how many skills were started.
        planning_s: the slowest planning of the episode, s.
        seconds: the whole episode's wall time, s.
        skills_run: every skill that was started, in order, such as "Pick(r, b1)".
        steps: control steps that it took; None where an earlier version did not count them.
    """

    library: int
    method: str
    scenario: str
    seed: int
    episode: int
    success: bool
    end: str
    reason: str
    skills: int
    planning_s: float
    seconds: float
    skills_run: tuple[str, ...]
    steps: int | None = None


EPISODE: Shape = {
    "library": int,
    "method": str,
    "scenario": str,
    "seed": int,
    "episode": int,
    "success": bool,
    "end": str,
    "reason": str,
    "skills": int,
    "planning_s": float,
    "seconds": float,
    "skills_run": [str],
}
"""An `EpisodeRow` in a file."""


def count_once(what: str, values: Sequence[Key], named: Callable[[Key], str] = str) -> tuple[Key, ...]:
    """The values, each once, in the order in which they first appear; those given more often are told.

    A world that is counted twice makes intervals narrower than what was measured.
    """
    once = tuple(dict.fromkeys(values))
    for value in once:
        times = values.count(value)
        if times > 1:
            _log.warning("%s %s was given %d times and counts once", what, named(value), times)
    return once


def report(episodes: Sequence[EpisodeRow], domain: Domain, library_hashes: Sequence[str]) -> dict[str, Any]:
    """The episodes as plain data, counted; `resync_robot.commands.evaluate.evaluate` describes the fields.

    Args:
        library_hashes: content hash of each library that `EpisodeRow.library` counts.
    """
    splits = {s.name: "train" if s.training else "test" for s in domain.scenarios.values()}

    def split(episode: EpisodeRow) -> str:
        return splits[episode.scenario]

    rows = [
        {
            "domain": domain.name,
            "scenario": scenario,
            "split": splits[scenario],
            "method": method,
            "library": library,
            "library_hash": library_hashes[library],
            "seed": seed,
            "episodes": len(group),
            "successes": sum(e.success for e in group),
            "failure_reasons": dict(Counter(failure_reason(e.end, e.reason) for e in group if not e.success)),
            "recoveries_per_episode": _recoveries(group, domain),
        }
        for (scenario, method, library, seed), group in _grouped(
            episodes, lambda e: (e.scenario, e.method, e.library, e.seed)
        )
    ]
    by_split = [(*key, None, group) for key, group in _grouped(episodes, lambda e: (split(e), e.method))]
    by_scenario = [
        (splits[scenario], method, scenario, group)
        for (scenario, method), group in _grouped(episodes, lambda e: (e.scenario, e.method))
    ]
    summary = [
        {
            "domain": domain.name,
            "split": of,
            "scenario": scenario,
            "method": method,
            "success_rate": sum(e.success for e in group) / len(group),
            "ci95": list(wilson(sum(e.success for e in group), len(group))),
            "n": len(group),
            "recoveries_per_episode": _recoveries(group, domain),
        }
        for of, method, scenario, group in (*by_split, *by_scenario)
    ]
    return {"rows": rows, "summary": summary, "episodes": [asdict(e) for e in episodes]}


def failure_reason(end: str, reason: str) -> str:
    """The end and its cause without arguments and numbers, so that failures of one kind count together.

    An example: "stuck: Insert: blocked: over b#: # N against the hand".
    """
    if end == "goal":
        return "goal: believed to be reached, in truth it is not"
    cause = re.sub(r"([A-Za-z][\w-]*)\([^()]*\)", r"\1", reason)
    cause = re.sub(r" did not do what it should \((.*)\)$", r": \1", cause)
    cause = re.sub(r"(?<![\w.])-?\d+(\.\d+)?(e[+-]?\d+)?|\d+", "#", cause)
    # However many of a kind there are: "b#, b#" is "b#".
    cause = re.sub(r"(?<![\w#-])([\w#-]+)(, \1)+(?![\w#-])", r"\1", cause)
    return f"{end}: {cause}" if cause else end


def table(episodes: Sequence[EpisodeRow], methods: Sequence[str], scenarios: Sequence[str], sources: str) -> str:
    """Success by method and scenario with 95 % intervals, as markdown.

    Args:
        sources: where poses come from and what skills see, in words.
    """
    lines = [f"| method ({sources}) | " + " | ".join(scenarios) + " |", "|---" * (len(scenarios) + 1) + "|"]
    for method in methods:
        cells = []
        for scenario in scenarios:
            mine = [e.success for e in episodes if (e.method, e.scenario) == (method, scenario)]
            low, high = wilson(sum(mine), len(mine))
            cells.append(f"{sum(mine) / len(mine):.2f} [{low:.2f}, {high:.2f}] of {len(mine)}")
        lines.append(f"| {method} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _grouped(episodes: Sequence[EpisodeRow], key: Callable[[EpisodeRow], Key]) -> list[tuple[Key, list[EpisodeRow]]]:
    """The episodes by `key`, keys in the order in which they first appear."""
    groups: dict[Key, list[EpisodeRow]] = {}
    for episode in episodes:
        groups.setdefault(key(episode), []).append(episode)
    return list(groups.items())


def _recoveries(episodes: Sequence[EpisodeRow], domain: Domain) -> float:
    """Mean number of runs of the skills that stages learn."""
    recoveries = {stage.recovery for stage in domain.stages}
    return sum(s.split("(")[0] in recoveries for e in episodes for s in e.skills_run) / len(episodes)
