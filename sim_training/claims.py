"""How far a model of success can be believed: what it claims, and how many of its claims runs of the skill confirm."""

from __future__ import annotations

from collections import deque

import numpy as np

LATELY = 40
"""Verdicts on claims of the model that tell how far it can be believed."""
STRICTER, STRICTEST = 0.3, 2.0
"""By how much a refuted claim raises the log-odds that the next one needs, and by how much all of them may."""


class Claims:
    """What counts as a claim, and what came of those that were put to the test.

    Attributes:
        reliability: share of the claims that would be confirmed if all were right: a skill may fail for nothing.

    Args:
        worth_a_try: probability of success from which on a state counts as a claim, before any was refuted.
        confirmed: share of claims that are to hold in the long run.
        believed: share of the latest that has to hold for more of them to be believed without a run.
    """

    def __init__(self, worth_a_try: float, confirmed: float, believed: float) -> None:
        self._worth, self._confirmed, self._believed = worth_a_try, confirmed, believed
        self._lately: deque[bool] = deque(maxlen=LATELY)
        self._demand = 0.0
        self.reliability = 1.0

    @property
    def claimed_from(self) -> float:
        """The probability of success that is a claim now."""
        return self._worth / (self._worth + (1 - self._worth) * float(np.exp(-self._demand)))

    @property
    def believed(self) -> bool:
        """Whether enough of the latest held."""
        return len(self._lately) == LATELY and sum(self._lately) >= self._believed * self.reliability * LATELY

    def heard(self, held: bool) -> None:
        """A verdict on a claim: what counts as one is raised and lowered so that in the long run the wanted share
        holds."""
        share = self._confirmed * self.reliability
        self._lately.append(held)
        self._demand += -STRICTER * (1 - share) / share if held else STRICTER
        self._demand = float(np.clip(self._demand, 0.0, STRICTEST))
