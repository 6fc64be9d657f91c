"""Blocked Stacking whose failures come in another order: first the crate, then the slab beside it.

    resync-robot train-sim --domain tests/benchmarks/reversed_blocked_stacking.py
    resync-robot evaluate --domain tests/benchmarks/reversed_blocked_stacking.py --library LIBRARY

The paper's test of the order of a curriculum. In the training scenario of the usual second stage a slab is in the way
as well, which nobody gets past who has not learned to punch. So the crate stands alone here at first.
"""

from __future__ import annotations

from dataclasses import replace

from resync_robot.core.embodiment import Stage
from resync_robot.sim_training.domains.blocked_stacking import BLOCKED_STACKING

ALONE, BOTH = ("6", "7"), ("0", "1", "2", "3", "4", "5")
"""Scenarios with a crate alone, and those with a slab as well or alone."""
REVERSED = replace(
    BLOCKED_STACKING,
    name="reversed-blocked-stacking",
    scenarios={
        name: replace(BLOCKED_STACKING.scenario(name), training=name in ("6", "2"), after_stage=after)
        for after, names in ((1, ALONE), (2, BOTH))
        for name in names
    },
    stages=(Stage(recovery="Wiggle", scenario="6", horizon=10), Stage(recovery="Punch", scenario="2", horizon=10)),
)
