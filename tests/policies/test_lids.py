"""RemoveLid: the lid ends on the table, whole and clear of everything, and where it cannot the skill says why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from resync_robot.core.fittings import LID
from resync_robot.core.joints import JointTarget
from resync_robot.core.skill import SkillEnd
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK
from resync_robot.core.world import ArmObservation
from resync_robot.policies.fittings import footprints, in_a_way
from resync_robot.sim_training.domains.cornered_insertion_l.vocabulary import hand_empty, lid_off, lid_on
from resync_robot.sim_training.physics.world import SimWorld
from tests import furnished_scenes as furnished
from tests import scenes
from tests.furnished_scenes import THE_LID
from tests.policies.followers import Follower
from tests.policies.furnished_worlds import build, run
from tests.scenes import B0, B1, THE_BOX, R

BLOCKS = {"b0": (scenes.CORNER, scenes.CORNER), "b1": (-0.24, -0.32, 0.5, 0.0)}
"""One in a corner of the box, one on the table where the lid could go."""
MET = 0.07
"""m above the table."""


def test_a_lid_is_lifted_and_put_down_where_nothing_stands() -> None:
    world = build(furnished.furnished(BLOCKS, lid=furnished.lid_features(yaw=0.2)))
    before = world.perceive()
    assert lid_on(before, (THE_LID,)) and not lid_off(before, ())
    assert run(world, "RemoveLid", THE_LID).done
    after = world.perceive()
    assert lid_off(after, ()) and not lid_on(after, (THE_LID,)) and hand_empty(after, (R,))
    assert after.get(THE_LID, "z")[0] == pytest.approx(LID.size[2] / 2, abs=0.001), "flat on the table"
    for block in (B0, B1):
        np.testing.assert_allclose(after[block][:3], before[block][:3], atol=0.001)
    assert world.settles()
    plate = next(footprints(after))
    edge = plate.pose[:2, 3] + np.array([(x, y) for x in (-1, 1) for y in (-1, 1)]) * plate.half
    assert not in_a_way(after, edge, 0.0).any()


def test_a_lid_that_lies_elsewhere_than_seen_is_missed_and_told() -> None:
    class Misled(SimWorld):
        def observe(self, live: bool = False) -> ArmObservation:
            seen = super().observe(live)
            return replace(seen, state=seen.state.with_features(THE_LID, x=seen.state.get(THE_LID, "x")[0] + 0.06))

    world = build(furnished.furnished({"b0": (0.0, 0.0)}, lid=furnished.lid_features()), Misled)
    outcome = run(world, "RemoveLid", THE_LID)
    assert outcome.ending is SkillEnd.BLOCKED and "knob of lid" in outcome.reason
    assert lid_on(world.perceive(), (THE_LID,)) and hand_empty(world.perceive(), (R,))


def test_where_no_lid_fits_none_is_lifted() -> None:
    # Blocks all over the table, 0.2 m apart.
    spots = [(x, y, 0.0, 0.0) for x in (-0.25, -0.05, 0.15) for y in (-0.55, -0.35, 0.35, 0.55)]
    task = furnished.furnished({f"b{i}": spot for i, spot in enumerate(spots)}, lid=furnished.lid_features())
    world = Follower(task.initial, between=LID.knob[0])
    outcome = run(world, "RemoveLid", THE_LID)
    assert outcome.ending is SkillEnd.REFUSED and "no free place" in outcome.reason
    held: Object = BLOCK("b0")
    assert held in task.objects and world.opening > LID.knob[0], "the pads have let go"


def test_a_lid_is_laid_clear_of_a_box_that_reaches_further_than_was_seen_beneath_it() -> None:
    class Misled(SimWorld):
        def observe(self, live: bool = False) -> ArmObservation:
            seen = super().observe(live)
            y, size = seen.state.get(THE_BOX, "y")[0], seen.state.get(THE_BOX, "inner_y")[0]
            return replace(seen, state=seen.state.with_features(THE_BOX, y=y + 0.014, inner_y=size - 0.03))

    world = build(furnished.furnished({"b0": (0.0, 0.0)}, lid=furnished.lid_features()), Misled)
    assert run(world, "RemoveLid", THE_LID).done
    assert world.perceive().get(THE_LID, "z")[0] == pytest.approx(LID.size[2] / 2, abs=0.001), "flat on the table"


def test_a_lid_that_can_be_laid_nowhere_as_it_should_does_not_stay_in_the_hand() -> None:
    task = furnished.furnished({"b0": (0.0, 0.0)}, lid=furnished.lid_features())
    begin = task.initial.get(THE_LID, "x", "y")
    let_go: list[float] = []

    class Ground(Follower):
        """Wherever a lid could be laid, something is met 5 cm too early."""

        def act(self, target: JointTarget, duration: float) -> None:
            tip = self.rig.tip_pose(target.arm)[:3, 3]
            self.force = np.array([0.0, 0.0, 60.0 * (np.linalg.norm(tip[:2] - begin) > 0.2 and tip[2] < MET)])
            if target.opening > self.opening and self.opening == LID.knob[0]:
                let_go.append(tip[2])
            super().act(target, duration)

    world = Ground(task.initial, between=LID.knob[0])
    outcome = run(world, "RemoveLid", THE_LID)
    assert outcome.ending is SkillEnd.BLOCKED and "putting lid down: 60 N" in outcome.reason
    assert len(let_go) == 1 and let_go[0] == pytest.approx(MET, abs=0.01), "laid on what is met, not dropped"
    assert world.tips[-1][2] > MET + 0.1, "and away from it"
