"""Where the hand was low enough to touch something since the last scan: nothing else can have changed."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK

LOW = 0.20
"""m above the table, of the tips; what hangs under them in the hand reaches down to a tower of two no more."""
REACH = 0.12
"""m, seen from above, from the tips to the middle of a block that fingers, or what they hold, can move."""
APART = 0.01
"""m between two places that are kept."""


class HandTrace:
    """Follows the tips, and says which blocks they may have moved."""

    def __init__(self) -> None:
        self._places: list[Float[np.ndarray, "2"]] = []

    def follow(self, tip: Float[np.ndarray, "3"]) -> None:
        """The tips are sent to this position, m."""
        if tip[2] < LOW and (not self._places or np.linalg.norm(tip[:2] - self._places[-1]) > APART):
            self._places.append(tip[:2].copy())

    def clear(self) -> None:
        """Everything has been looked at."""
        self._places.clear()

    @property
    def last(self) -> Float[np.ndarray, "2"] | None:
        """Where the hand was low last: what it has moved it left there."""
        return self._places[-1] if self._places else None

    def touched(self, state: State) -> tuple[Object, ...]:
        """The blocks that may have moved from where `state` has them, or to there."""
        if not self._places:
            return ()
        places = np.array(self._places)
        return tuple(b for b in state.of_type(BLOCK) if np.hypot(*(places - state.get(b, "x", "y")).T).min() < REACH)
