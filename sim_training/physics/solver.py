"""How finely physics is solved: one set of figures for training, demonstrations, evaluation and the emulated lab.

Pressing a block along the floor puts 100 g between an arm of 20 kg and a floor that does not move. An iterative solver
passes forces through such a sandwich slowly, the more so the lighter the block: with too few iterations it follows the
hand too far or not at all. PGS (projected Gauss-Seidel) comes to one answer as step and iterations are refined. TGS,
PhysX's default, does not: beyond some 50 iterations its substeps are so short that the pressing hand chatters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from resync_robot.core.task import Task

GRAVITY = 9.81
MOST_ITERATIONS = 255
"""PhysX counts them in a byte."""


@dataclass(frozen=True, kw_only=True)
class Solver:
    """What the physics engine is told.

    Attributes:
        period: s of one physics step.
        iterations: of the solver in a step, for blocks and for all that touches one.
        arm_iterations: the same for the arm while it touches none: floor and walls weigh on it alone, and need fewer.
        inertia: factor on the inertia of blocks, whose weight stays what it is. Everything slow, which is held or
            pushed, obeys the same forces; what falls or slides freely does so that much more slowly.
        contact_offset: m between surfaces from which on a contact is solved.
        restitution: of every contact.
    """

    period: float = 0.01
    iterations: int = 80
    arm_iterations: int = 25
    inertia: float = 4.0
    contact_offset: float = 0.01
    restitution: float = 0.0

    @property
    def gravity(self) -> tuple[float, float, float]:
        """m/s^2, such that a block with that inertia has its own weight."""
        return 0.0, 0.0, -GRAVITY / self.inertia

    def steps(self, duration: float) -> int:
        """Physics steps in `duration` s, at least one."""
        return max(1, round(duration / self.period))


SHIPPED = Solver()
REFERENCE = Solver(period=0.002, iterations=200, arm_iterations=200, inertia=1.0)
"""The yardstick, at over ten times the price."""


def solver_of(physics: Mapping[str, Any]) -> Solver:
    """Of what was drawn for a task (`Task.physics`)."""
    found = physics.get("solver", SHIPPED)
    if not isinstance(found, Solver):
        raise TypeError(f"a task's solver is a Solver, not a {type(found).__name__}")
    return found


def with_solver(task: Task, solver: Solver) -> Task:
    """The same task in physics that is solved otherwise."""
    return replace(task, physics={**task.physics, "solver": solver})
