"""What a domain says of its robot, and the stages in which it learns: the part of the contract that acts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from jaxtyping import UInt8

from resync_robot.core.skill import Skill
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.world import ActionT_contra, ObservationT_co, Simulator

if TYPE_CHECKING:
    # A task is of a domain, which has an embodiment, which simulates tasks.
    from resync_robot.core.task import Task


class TrainingSimulator(Simulator[ObservationT_co, ActionT_contra], Protocol[ObservationT_co, ActionT_contra]):
    """A simulator that failures are mined in: its state can be set, and it tells what the robot runs into."""

    def reset(self, state: State) -> bool:
        """Put everything where `state` has it, and let it settle. Returns whether it all stays there."""
        ...

    def contacts(self) -> Mapping[Object, float]:
        """What the robot, or what it holds, runs into at this moment: N, or 1 where geometry alone tells."""
        ...

    def picture(self) -> UInt8[np.ndarray, "h w 3"]:
        """The scene, for people."""
        ...


@dataclass(frozen=True, kw_only=True)
class Embodiment:
    """How the robot of a domain acts.

    Attributes:
        actions: the components of an action vector, each with its least and greatest value; a recovery is learned in
            this space.
        rate_hz: actions a second.
        simulate: a task -> a simulator in which it stands, for one process.
        skills: the given skills, made anew in each process.
    """

    actions: Mapping[str, tuple[float, float]]
    rate_hz: float
    simulate: Callable[[Task], TrainingSimulator[Any, Any]]
    skills: Callable[[], tuple[Skill[Any, Any], ...]]


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One failure to learn from.

    Attributes:
        recovery: name of the skill to be learned.
        scenario: whose tasks fail.
        horizon: actions after which an attempt to recover is given up.
    """

    recovery: str
    scenario: str
    horizon: int
