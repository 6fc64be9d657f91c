"""How far a hand can have taken a block since a scan saw it.

A scan knows a block to a millimetre, and nothing but the hand moves it: as long as no finger has pressed on it, the
scan is as good as new, and from then on the block went along with the hand at most.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

TOUCHES = 0.004
"""m over the stud's top up to which the tips count as pressing on it."""


@dataclass
class Carried:
    """Follows the tips, once a control step.

    Attributes:
        top: of the block's stud, as the scan saw it, m.
        away: (2,) how far the tips have gone while they pressed, m, world frame. Of a step in which they came off the
            block nobody knows how far it went along; it does not count.
    """

    top: float
    away: Float[np.ndarray, "2"] = field(default_factory=lambda: np.zeros(2))
    _pressing_at: Float[np.ndarray, "2"] | None = None

    def follow(self, tip: Float[np.ndarray, "3"]) -> None:
        """The tips are at (3,) now, m."""
        pressing = bool(tip[2] < self.top + TOUCHES)
        if pressing and self._pressing_at is not None:
            self.away = self.away + tip[:2] - self._pressing_at
        self._pressing_at = np.array(tip[:2]) if pressing else None

    def fell_back(self, stood_at: Float[np.ndarray, "3"] | None) -> None:
        """What was pressed on has given way and was let go: it came along as far as where the tips were at (3,), m,
        when it began to lean, and fell back on its feet; None where they did not press."""
        if self._pressing_at is not None and stood_at is not None:
            self.away = self.away + stood_at[:2] - self._pressing_at
        self._pressing_at = None
