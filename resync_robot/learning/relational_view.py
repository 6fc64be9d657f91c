"""What a recovery sees: how the objects that it is about lie beside each other, and nothing else of the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from jaxtyping import Float

from resync_robot.core.relations import DEFAULTS, Relations, blank, features
from resync_robot.core.state import State
from resync_robot.core.symbols import Object, Type


@dataclass(frozen=True)
class RelationalView:
    """proj(x) as a vector: the relational features of every pair of these objects, in their order.

    Attributes:
        objects: the robot, o^R, and every o^F.
        relations: those that the domain declares.
    """

    objects: tuple[Object, ...]
    relations: Relations = field(default_factory=lambda: DEFAULTS)

    def __call__(self, state: State) -> Float[np.ndarray, " d"]:
        return self.each([state])[0]

    def each(self, states: Sequence[State]) -> Float[np.ndarray, "n d"]:
        """Of several states at once, which takes hardly longer than one."""
        rows = {o: np.stack([state[o] for state in states]) for o in self.objects}
        pairs = combinations(self.objects, 2)
        return np.concatenate([features(a.type, rows[a], b.type, rows[b], self.relations) for a, b in pairs], -1)

    @property
    def size(self) -> int:
        """Length of the vector."""
        return view_size(tuple(o.type for o in self.objects), self.relations)


def view_size(types: tuple[Type, ...], relations: Relations = DEFAULTS) -> int:
    """Of a view of objects of these types."""
    pairs = combinations(types, 2)
    return sum(features(a, blank(a), b, blank(b), relations).shape[1] for a, b in pairs)
