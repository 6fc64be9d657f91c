"""Where the hand was low enough to touch something since the last scan: nothing else can have changed."""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np
from jaxtyping import Float

from resync_robot.core import fittings
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, DRAWER, LID
from resync_robot.policies.fittings import Footprint, footprints, ways_open

LOW = 0.20
"""m above the table, of the tips; what hangs under them in the hand reaches down to a tower of two no more."""
REACH = 0.12
"""m, seen from above, from the tips to the middle of a block that fingers, or what they hold, can move."""
HALF_A_BLOCK = 0.05
"""m of that are the block itself: so much nearer the outline of a lid or a drawer has to be."""
WITH_A_LID = max(fittings.LID.size[:2]) / 2 + HALF_A_BLOCK
"""m, as far as the plate of a lid reaches that hangs from the hand."""
APART = 0.01
"""m between two places that are kept."""


class HandTrace:
    """Follows the tips, and says what they may have moved.

    Attributes:
        carried: what was in the hand at any time since the last scan.
    """

    def __init__(self) -> None:
        self._places: list[Float[np.ndarray, "2"]] = []
        self._reach: list[float] = []
        self.carried: set[Object] = set()

    def follow(self, tip: Float[np.ndarray, "3"], in_hand: Collection[Object] = ()) -> None:
        """The tips are sent to this position, m, with these things in the hand, as believed."""
        self.carried.update(in_hand)
        reach = WITH_A_LID if any(o.type == LID for o in in_hand) else REACH
        if tip[2] >= LOW:
            return
        if not self._places or np.linalg.norm(tip[:2] - self._places[-1]) > APART or reach > self._reach[-1]:
            self._places.append(tip[:2].copy())
            self._reach.append(reach)

    def clear(self) -> None:
        """Everything has been looked at."""
        self._places.clear()
        self._reach.clear()
        self.carried.clear()

    @property
    def last(self) -> Float[np.ndarray, "2"] | None:
        """Where the hand was low last: what it has moved it left there."""
        return self._places[-1] if self._places else None

    def touched(self, state: State) -> tuple[Object, ...]:
        """The blocks, lids and drawers that may have moved from where `state` has them, or to there."""
        if not self._places:
            return ()
        places, reach = np.array(self._places), np.array(self._reach)
        blocks = [b for b in state.of_type(BLOCK) if (np.hypot(*(places - state.get(b, "x", "y")).T) < reach).any()]
        wide = [o for kind in (LID, DRAWER) for o in state.of_type(kind)]
        beside = reach - HALF_A_BLOCK
        return (*blocks, *(o for o in wide if any((f.away(places) < beside).any() for f in takes_up(state, o))))


def takes_up(state: State, fitting: Object) -> Iterator[Footprint]:
    """The rectangles on the table that a lid or a drawer is within, however wide the drawer is open."""
    alone = state.project([fitting])
    yield from footprints(alone)
    yield from ways_open(alone)
