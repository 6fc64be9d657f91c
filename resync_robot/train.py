"""Training in simulation: mine failures, learn the recovery, dream, discover concepts, save the library."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from resync_robot.core.errors import ResyncError


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Learn from failures in simulation and write a library."""

    domain: str = "cornered-insertion-s"
    """The domain to train in."""

    preset: Literal["quick", "full"] = "quick"
    """How much to train: quick fits two cores in half an hour, full is for a workstation."""

    seed: int = 0
    """Seed of every random draw. The same seed gives the same library on one machine."""

    out: Path | None = None
    """Folder of the run. Default: runs/DATE-DOMAIN."""

    resume: bool = False
    """Go on where the run in --out (default: the latest one of this domain) was cut off."""

    device: Literal["cpu", "cuda"] = "cpu"
    """Where the simulation and the networks run."""

    concepts: Literal["default", "paper"] = "default"
    """How predicates and operators are learned: this project's choices or the published formulation."""

    workers: int = 2
    """Simulation processes, for --device cpu."""

    verbose: bool = False
    """Log at debug level."""


def train(config: TrainConfig) -> None:
    """Run every phase of `config` and write the run folder.

    Raises:
        ResyncError: bad input, or a phase that cannot produce what the next one needs.
    """
    raise ResyncError("not built yet")
