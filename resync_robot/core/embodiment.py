"""What a domain says of its robot, and the stages in which it learns: the part of the contract that acts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from jaxtyping import Float, UInt8

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


class RecoveryInterface(Protocol):
    """How a recovery begins, sees and acts, where it does not just act in the embodiment's own actions from where the
    failed skill ended. A run is what it remembers from one action to the next.
    """

    @property
    def features(self) -> int:
        """Length of what the policy sees."""
        ...

    @property
    def actions(self) -> int:
        """Length of what it answers, each number in [-1, 1]."""
        ...

    @property
    def rate_hz(self) -> float:
        """Answers a second."""
        ...

    @property
    def approach(self) -> Skill[Any, Any] | None:
        """Over (the robot, o^R and every o^F): brings the robot to where the policy takes over."""
        ...

    @property
    def leave(self) -> Skill[Any, Any] | None:
        """Over the same: what the finished skill does once the policy is done. Verdicts are about what that leaves."""
        ...

    @property
    def effort_limit(self) -> tuple[float, ...] | None:
        """(6,) N m that an arm may use meanwhile, or None for its own."""
        ...

    def begin(self, objects: tuple[Object, ...], state: State, rng: np.random.Generator) -> Any:
        """A run from here on, with what is drawn for it in training, such as how late the robot is."""
        ...

    def see(self, runs: Sequence[Any], states: Sequence[State]) -> Float[np.ndarray, "n d"]:
        """What the policy sees of several scenes."""
        ...

    def act(self, runs: Sequence[Any], states: Sequence[State], actions: Float[np.ndarray, "n k"]) -> Sequence[Any]:
        """The embodiment's action in each scene."""
        ...


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One failure to learn from.

    Attributes:
        recovery: name of the skill to be learned.
        scenario: whose tasks fail.
        horizon: actions after which an attempt to recover is given up.
        interface: how the recovery begins, sees and acts; None: where the failed skill ended, all relations between
            what it is about, and the embodiment's own actions.
        on_device: (tasks, o^R, the arm's rig, how many, the device) -> a context that yields as many scenes there, to
            learn in thousands of them; None: in processes only.
    """

    recovery: str
    scenario: str
    horizon: int
    interface: RecoveryInterface | None = None
    on_device: Callable[[Sequence[Task], Object, Any, int, str], AbstractContextManager[Any]] | None = None
