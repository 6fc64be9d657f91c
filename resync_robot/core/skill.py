"""Skills: a signature, a policy, a terminal function. A ground skill binds one to objects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Generic, Protocol, TypeVar

from resync_robot.core.errors import PlanningError
from resync_robot.core.symbols import Object, Type
from resync_robot.core.world import Observation


class SkillEnd(Enum):
    """Why a skill stopped."""

    DONE = "done"
    """Its terminal function beta fired."""
    BLOCKED = "blocked"
    """A guard saw the tip stray or an unexpected force."""
    DROPPED = "dropped"
    """What the hand held has left it on the way."""
    UNREACHABLE = "unreachable"
    """No arm configuration reaches what it wanted."""
    REFUSED = "refused"
    """The state makes no sense for it (an object is missing, the hand is full)."""
    NEEDLESS = "needless"
    """What it mends does not fail here: it began with that, which is done."""
    TIMEOUT = "timeout"


@dataclass(frozen=True, slots=True)
class SkillOutcome:
    """How a skill ended, and in which words to report it."""

    ending: SkillEnd
    reason: str = ""

    @property
    def done(self) -> bool:
        return self.ending is SkillEnd.DONE


ObservationT_contra = TypeVar("ObservationT_contra", bound=Observation, contravariant=True)
ActionT_co = TypeVar("ActionT_co", covariant=True)
ObservationT = TypeVar("ObservationT", bound=Observation)
ActionT = TypeVar("ActionT")


class Policy(Protocol[ObservationT_contra, ActionT_co]):
    """One run of a ground skill. A new object for each run, so that no state leaks from one to the next."""

    def step(self, observation: ObservationT_contra, /) -> ActionT_co | SkillOutcome:
        """The next action, or how the skill ended."""
        ...


@dataclass(frozen=True)
class Skill(Generic[ObservationT, ActionT]):
    """A lifted skill C: signature, policy pi (with its beta inside), control rate.

    Attributes:
        start: called with the ground objects and the first observation, returns a fresh policy.
        rate_hz: how often `step` wants to be called.
        time_limit_s: after so many s of control steps, at full speed, the executive stops it with TIMEOUT.
        live_state: the skill follows the objects while it runs, and so needs their poses at every step.
        effort_limit: (6,) N m that the arm may use while it runs, or None for its own. Only an arm has one.
        begins_with: of a learned recovery: its objects -> the skill that it mends, which it runs first.
    """

    name: str
    types: tuple[Type, ...]
    start: Callable[[tuple[Object, ...], ObservationT], Policy[ObservationT, ActionT]] = field(
        repr=False, compare=False
    )
    rate_hz: float
    time_limit_s: float
    live_state: bool = False
    effort_limit: tuple[float, ...] | None = None
    begins_with: Callable[[tuple[Object, ...]], GroundSkill] | None = field(default=None, repr=False, compare=False)

    def ground(self, objects: tuple[Object, ...]) -> GroundSkill:
        if tuple(o.type for o in objects) != self.types:
            raise PlanningError(f"{self.name} takes ({', '.join(t.name for t in self.types)}), got {objects}")
        return GroundSkill(self, objects)


@dataclass(frozen=True)
class GroundSkill:
    """A skill with its objects."""

    skill: Skill
    objects: tuple[Object, ...]

    @property
    def name(self) -> str:
        return self.skill.name

    @property
    def first(self) -> GroundSkill:
        """What runs first: itself, or, of a learned recovery, the skill that it mends."""
        return self if self.skill.begins_with is None else self.skill.begins_with(self.objects).first

    def __str__(self) -> str:
        return f"{self.skill.name}({', '.join(map(str, self.objects))})"
