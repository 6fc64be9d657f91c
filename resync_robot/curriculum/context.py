"""What the steps of a stage try things out with: the domain, its robot, and all that is known so far."""

from __future__ import annotations

from dataclasses import dataclass, replace

from resync_robot.core.embodiment import Embodiment, Stage
from resync_robot.core.errors import UnknownNameError
from resync_robot.core.library import Library, Record
from resync_robot.core.rig import Rig
from resync_robot.core.task import Domain
from resync_robot.library_models import embodiment_of, initial_model, learned_model, recovery_of
from resync_robot.planning.execute import Model
from resync_robot.sim_training.domains import find_domain


@dataclass(frozen=True)
class Context:
    """The domain, its robot, and a model to plan with."""

    domain: Domain
    embodiment: Embodiment
    model: Model
    rig: Rig | None = None

    def stage(self, recovery: str) -> Stage:
        """The stage that learns this recovery, as the robot learns it. Raises UnknownNameError."""
        for stage in self.domain.stages:
            if stage.recovery != recovery:
                continue
            if self.domain.embodiment is not None or self.rig is None:
                return stage
            from resync_robot.arm_embodiment import arm_stage  # its simulator takes seconds to import

            return arm_stage(stage, self.rig)
        raise UnknownNameError(f"stage of {self.domain.name}", recovery, [s.recovery for s in self.domain.stages])


@dataclass(frozen=True, kw_only=True)
class Known:
    """What is known at some point of a stage, as data that travels to other processes.

    Attributes:
        domain: what `find_domain` finds it by.
        rig: of an arm; None for a domain with a robot of its own.
        library: of the stages before.
        recoveries: name -> record of skills that no operator speaks of yet.
    """

    domain: str
    rig: Rig | None
    library: Library | None = None
    recoveries: tuple[tuple[str, Record], ...] = ()

    def with_recovery(self, name: str, record: Record) -> Known:
        """The same, and a new skill."""
        return replace(self, recoveries=(*self.recoveries, (name, record)))

    def open(self) -> Context:
        """The live objects. Raises LibraryError where the library does not fit the domain."""
        domain = find_domain(self.domain)
        rig, library = self.rig, self.library
        model = initial_model(domain, rig) if library is None else learned_model(domain, rig, library)
        skills = dict(model.skills)
        for name, record in self.recoveries:
            skills[name] = recovery_of(domain, rig, name, record, skills)
        return Context(domain, embodiment_of(domain, rig), replace(model, skills=skills), rig)
