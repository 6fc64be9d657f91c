"""Simulated scenes with a lid and a drawer, scanned with noise and extrinsic error, from pixels to atoms."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core.errors import RenderError
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.vocabulary import BLOCK
from resync_robot.deployment.uncertain_atoms import SampledAbstraction
from resync_robot.perception.belief import Belief
from resync_robot.perception.objects import SceneEstimator, catalogue_of
from resync_robot.planning.abstract import Abstraction
from resync_robot.sim_training.domains.cornered_insertion_l.domain import CORNERED_INSERTION_L
from resync_robot.sim_training.domains.cornered_insertion_l.layouts import THE_BOX, THE_DRAWER, THE_LID, R
from tests.benchmarks.cornered_insertion_l_perception import TOWER_IN_DRAWER, look, scene

ABSTRACTION = SampledAbstraction(Abstraction(CORNERED_INSERTION_L.predicates, CORNERED_INSERTION_L.classifiers))


def scanned(rig: Rig, index: int) -> tuple[Belief, State, State]:
    """The belief after one round of pictures of that scene, its state, and the truth."""
    task = scene(index)
    try:
        frames, scan, truth, _ = look(task, index)
    except RenderError as error:
        pytest.skip(f"no Vulkan device, so no rendered pictures: {error.what}")
    blocks = [o for o in task.objects if o.type == BLOCK]
    estimator = SceneEstimator(rig, catalogue_of(rig, furnished=True))
    belief = Belief(R, THE_BOX, blocks, rig, estimator, (THE_LID, THE_DRAWER))
    robot = rig.robot_features(scan.configurations[-1], rig.gripper.max_opening)
    return belief, belief.update_from_scan(frames, robot), truth


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, TOWER_IN_DRAWER, 18])
def test_lid_and_drawer_are_found_where_they_are(rig: Rig, index: int) -> None:
    """In scene 18 the lid hides all of the rim."""
    belief, state, truth = scanned(rig, index)
    for thing in (THE_LID, THE_DRAWER):
        assert np.linalg.norm(state[thing][:2] - truth[thing][:2]) < 0.004
    assert state.get(THE_DRAWER, "opening") == pytest.approx(truth.get(THE_DRAWER, "opening"), abs=0.003)
    lidded = truth.get(THE_LID, "z")[0] > 0.05
    assert ("b0" in belief.report.covered) == lidded
    sure = {str(a) for a in ABSTRACTION.true_atoms(state)}
    assert (sure >= {"LidOn(lid)"}) == lidded == (not sure >= {"LidOff()"})
    if index == TOWER_IN_DRAWER:
        assert sure >= {"On(b0, b1)", "In(b1, drawer)", "DrawerOpen(drawer)"}
