"""Random simulated scenes, scanned with noise and extrinsic error: the whole way from pixels to a state."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.errors import RenderError
from resync_robot.core.rig import Rig
from resync_robot.core.vocabulary import BLOCK
from resync_robot.perception.belief import Belief
from resync_robot.perception.scan import Scan
from resync_robot.sim_training.domains.cornered_insertion_s.domain import CORNERED_INSERTION_S
from resync_robot.sim_training.domains.cornered_insertion_s.layouts import THE_BOX, R
from resync_robot.sim_training.physics.camera_noise import NoisySensor
from resync_robot.sim_training.physics.world import SimWorld

SCENES = 10


@pytest.fixture(scope="module")
def errors(rig: Rig) -> dict[str, list[np.ndarray]]:
    """'block' and 'box' -> rows of [position m, yaw rad, largest error of a size m]."""
    rows: dict[str, list[np.ndarray]] = {"block": [], "box": []}
    scan = Scan(rig)
    for seed in range(SCENES):
        scenario = CORNERED_INSERTION_S.scenario(f"s{seed % 5}")
        task = scenario.sample(np.random.default_rng(seed), seed)
        try:
            world = SimWorld(task, rig, rendered=True)
        except RenderError as error:
            pytest.skip(f"no Vulkan device, so no rendered pictures: {error.what}")
        for _ in range(30):
            world.step()
        sensor = NoisySensor(seed, rig.camera("wrist"))
        frames = scan(
            lambda q, world=world: world.built.set_configuration(q, 0.14),
            lambda world=world, sensor=sensor: sensor.apply(world.render("wrist")),
        )
        belief = Belief(R, THE_BOX, [o for o in task.objects if o.type == BLOCK], rig)
        state = belief.update_from_scan(frames, rig.robot_features(scan.configurations[-1], 0.14))
        true = world.perceive()
        for obj in (o for o in task.objects if o != R):
            error = state[obj] - true[obj]
            yaw = spatial.wrap(float(spatial.yaw_of(state[obj][3:7]) - spatial.yaw_of(true[obj][3:7])), np.pi / 2)
            rows["box" if obj == THE_BOX else "block"].append(
                np.array([np.linalg.norm(error[:3]), abs(yaw), np.abs(error[7:]).max()])
            )
    return rows


def test_blocks_are_found_where_they_are(errors: dict[str, list[np.ndarray]]) -> None:
    position, yaw, size = np.array(errors["block"]).T
    assert np.median(position) < 0.0015
    assert position.max() < 0.005
    assert np.median(yaw) < np.radians(0.6)
    assert np.median(size) < 0.0015


def test_the_box_is_found_where_it_is(errors: dict[str, list[np.ndarray]]) -> None:
    position, yaw, size = np.array(errors["box"]).T
    assert np.median(position) < 0.0015
    assert position.max() < 0.003
    assert np.median(yaw) < np.radians(0.3)
    assert np.median(size) < 0.003
