"""The scenarios of Cornered Insertion-S in the terms of Cornered Insertion-L: no lid, no drawer.

    resync-robot evaluate --domain tests/benchmarks/small_scenes.py:SMALL --library LIBRARY_OF_L --scenarios s0 s1

What a robot learned among lids and drawers, it should be able to do where there are none.
"""

from __future__ import annotations

from dataclasses import replace

from resync_robot.sim_training.domains.cornered_insertion_l.domain import CORNERED_INSERTION_L
from resync_robot.sim_training.domains.cornered_insertion_s.domain import CORNERED_INSERTION_S

SMALL = replace(CORNERED_INSERTION_L, scenarios={**CORNERED_INSERTION_L.scenarios, **CORNERED_INSERTION_S.scenarios})
