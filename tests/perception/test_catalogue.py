"""The catalogue is written by hand, as for a real set of blocks; the simulation must keep to it."""

from __future__ import annotations

import numpy as np

from resync_robot.core.solids import BOX_FLOOR
from resync_robot.perception.catalogue import Catalogue
from resync_robot.sim_training.domains.cornered_insertion_s.layouts import sample_block_sizes, sample_box
from resync_robot.sim_training.physics import parts
from resync_robot.sim_training.physics.randomise import BLOCK_HUES, UNSEEN, USUAL

WORST = 0.002
"""m by which a size may be measured wrong, beneath bright lights."""


def test_the_simulated_things_are_those_of_the_catalogue() -> None:
    catalogue, rng = Catalogue(), np.random.default_rng(0)
    assert dict(catalogue.hues) == BLOCK_HUES
    assert (catalogue.stud_width, catalogue.stud_height) == (parts.STUD_WIDTH, parts.STUD_HEIGHT)
    assert (catalogue.floor_thickness, catalogue.table_z) == (BOX_FLOOR, parts.TABLE_TOP)
    for _ in range(100):
        box = sample_box(rng)
        assert catalogue.box_inner[0] < min(box[7:9])
        assert max(box[7:9]) < catalogue.box_inner[1]
        assert catalogue.rim_height[0] < box[2] + box[9] < catalogue.rim_height[1]
        assert box[10] == catalogue.wall_thickness
        for size in (s for r in (USUAL, UNSEEN) for s in sample_block_sizes(rng, ("b0", "b1"), r).values()):
            for (low, high), true in ((catalogue.block_width, size[0]), (catalogue.block_height, size[2])):
                assert low + WORST < true < high - WORST


def test_hues_are_further_apart_than_their_tolerance() -> None:
    catalogue = Catalogue()
    hues = sorted(catalogue.hues.values())
    gaps = np.diff([*hues, hues[0] + 1.0])
    assert gaps.min() > 2 * catalogue.hue_tolerance
