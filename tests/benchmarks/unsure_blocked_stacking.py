"""Blocked Stacking whose given predicates are unsure of their limits: what they see is off by 16 or 38 % of them.

    resync-robot train-sim --domain tests/benchmarks/unsure_blocked_stacking.py:OFF_16 --stages 1
    resync-robot evaluate --domain tests/benchmarks/unsure_blocked_stacking.py:OFF_16 --library LIBRARY

The paper's test of imperfect given knowledge: perceptual noise with respect to the decision boundary. A quantity that
is noisy by a share of its limit is compared as one whose limit is noisy by that share. Each look draws it anew, at the
same state too. The goal is told by such predicates, too.
"""

from __future__ import annotations

import zlib
from collections import Counter
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.sim_training.domains.blocked_stacking import BLOCKED_STACKING
from resync_robot.sim_training.domains.blocked_stacking.vocabulary import CLASSIFIERS, LIMITS, Limits


@dataclass(frozen=True)
class Unsure:
    """A given classifier with noisy limits.

    Attributes:
        off: standard deviation of the noise, as a share of each limit.
        looks: how often it has looked at a state, by its checksum: episodes are the same again in any order.
    """

    name: str
    off: float
    looks: Counter[int] = field(default_factory=Counter, compare=False)

    def __call__(self, state: State, objects: tuple[Object, ...]) -> float:
        seen = zlib.crc32(b"".join(state[o].tobytes() for o in state.objects) + f"{self.name}{objects}".encode())
        self.looks[seen] += 1
        rng = np.random.default_rng([seen, self.looks[seen]])
        limits = Limits(**{k: v * (1 + self.off * rng.standard_normal()) for k, v in asdict(LIMITS).items()})
        return CLASSIFIERS[self.name](state, objects, limits)


def _unsure(off: float) -> dict[str, Unsure]:
    return {name: Unsure(name, off) for name in CLASSIFIERS}


OFF_16 = replace(BLOCKED_STACKING, name="unsure-16", classifiers=_unsure(0.16))
OFF_38 = replace(BLOCKED_STACKING, name="unsure-38", classifiers=_unsure(0.38))
