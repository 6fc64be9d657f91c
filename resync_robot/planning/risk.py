"""How likely a step is to fail where its preconditions hold: what attempts like it came to.

Preconditions are sharp and experience is not. A tower can be lifted by its lower block, and now and then it falls. So
of all shortest plans the planner takes the one whose steps have failed least, and were practised most.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from resync_robot.core.symbols import Atom, GroundOperator, Predicate

Count = tuple[int, int]
"""(successes, attempts)."""


@dataclass(frozen=True)
class Tally:
    """How the attempts of a skill went whose preconditions held, by an atom about one of its arguments.

    Attributes:
        predicate: of one argument.
        argument: position of that argument among those of the skill.
        held: the attempts before which the atom held.
        otherwise: the rest.
    """

    predicate: Predicate
    argument: int
    held: Count
    otherwise: Count

    def atom(self, step: GroundOperator) -> Atom:
        return self.predicate(step.objects[self.argument])

    def risk(self, holds: bool) -> float:
        """-log of the chance that the next attempt succeeds, by Laplace's rule of succession."""
        successes, attempts = self.held if holds else self.otherwise
        return -math.log((successes + 1) / (attempts + 2))


class Risk:
    """Judges steps by tallies.

    Args:
        tallies: skill name -> its tallies. A skill without any bears no risk.
    """

    def __init__(self, tallies: Mapping[str, Sequence[Tally]]) -> None:
        self._tallies = tallies

    def __bool__(self) -> bool:
        return any(self._tallies.values())

    def atoms(self, step: GroundOperator) -> list[Atom]:
        """What its risk hangs on."""
        return [tally.atom(step) for tally in self._tallies.get(step.name, ())]

    def of(self, step: GroundOperator, atoms: Collection[Atom]) -> float:
        """The greatest risk that any tally sees in it where `atoms` hold; 0 or more."""
        return max((t.risk(t.atom(step) in atoms) for t in self._tallies.get(step.name, ())), default=0.0)
