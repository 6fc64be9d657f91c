"""Evaluation: methods x scenarios x seeds, as a table with confidence intervals."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from resync_robot.core.errors import ResyncError


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig:
    """Measure success rates in simulated worlds that no training has seen."""

    domain: str = "cornered-insertion-s"
    """The domain to evaluate in."""

    library: tuple[Path, ...] = ()
    """Library folders, one for each training seed. Default: the shipped one."""

    methods: tuple[str, ...] = ("resync",)
    """Methods to compare, separated by spaces or commas: resync, initial, rc, human."""

    scenarios: tuple[str, ...] = ("all",)
    """Scenarios, separated by spaces or commas: all, train, test, or names such as s0 s1."""

    seeds: tuple[int, ...] = (0,)
    """Seeds of the worlds: a world is a pure function of domain, scenario, seed and episode."""

    episodes: int = 10
    """Episodes for each library, method, scenario and seed."""

    perception: Literal["camera", "oracle"] = "oracle"
    """Where poses come from: RGB-D pictures, or the simulator's own state."""

    skills: Literal["state", "camera"] = "state"
    """What the learned skills see: estimated or simulated poses, or pictures."""

    workers: int = 2
    """Simulation processes."""

    json: Path | None = None
    """File for the rows, the summary and the provenance."""

    out: Path | None = None
    """Folder for the recordings of every episode. Default: none are kept."""

    verbose: bool = False
    """Log at debug level."""


def evaluate(config: EvaluateConfig) -> None:
    """Run every episode of `config`, print the table, and write the JSON file where one is named.

    Raises:
        ResyncError: bad input, or a library that cannot be used.
    """
    raise ResyncError("not built yet")
