"""Which failures count as the same one again: those that left the objects of the skill where they were.

An attempt that breaks off may have moved its block half the way. The next one begins from there, and is no repetition.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from resync_robot.core.state import State
from resync_robot.core.symbols import GroundOperator, Object

LEAST_MOVE, SIGMAS = 0.002, 3.0
"""m, and standard deviations beside, from which on an object has moved."""


@dataclass
class Failures:
    """How often ground skills failed with their objects where they were. Small changes add up: each is compared with
    where things were at the first of these failures."""

    _counted: dict[str, tuple[int, State]] = field(default_factory=dict)

    def count(self, step: GroundOperator, before: State, after: State) -> int:
        """One more failure of a step; so many there are now since its objects were last moved."""
        times, first = self._counted.get(str(step), (0, before))
        if has_moved(first, after, step.objects):
            times, first = 0, after
        self._counted[str(step)] = times + 1, first
        return times + 1


def has_moved(before: State, after: State, objects: Sequence[Object]) -> bool:
    """Has one of the objects that can stand elsewhere moved by more than is told by the errors of its two positions?"""
    for obj in objects:
        n = obj.type.dimensions
        if obj.type.exact or n == 0 or obj not in before or obj not in after:
            continue
        variance = sum(
            np.zeros(n) if c is None else np.diag(c)[:n] for c in (before.covariance(obj), after.covariance(obj))
        )
        if (np.abs(after[obj][:n] - before[obj][:n]) > LEAST_MOVE + SIGMAS * np.sqrt(variance)).any():
            return True
    return False
