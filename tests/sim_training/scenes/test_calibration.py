"""The board is rendered where it is said to be, and held by the hand where it is held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from resync_robot.calibration.detect import BoardDetector, Sighting, project
from resync_robot.calibration.propose import Proposer, board_in_hand, board_on_table
from resync_robot.core import spatial
from resync_robot.core.errors import RenderError
from resync_robot.core.rig import load_rig
from resync_robot.sim_training.scenes.calibration import CalibrationWorld, Poster, displaced, empty_task
from tests.calibration.synthetic import SPEC

RIG = load_rig()


def world(rig, poster: Poster | None) -> CalibrationWorld:
    task = empty_task(rig, 0)
    # Nothing casts a shadow, so what changes in a picture is what moved.
    task = replace(task, physics={**task.physics, "light": {**task.physics["light"], "texels": 0}})
    try:
        return CalibrationWorld(task, rig, poster)
    except RenderError as error:
        pytest.skip(f"no Vulkan device: {error.what}")


@pytest.mark.parametrize("name", ["wrist", "front"])
def test_corners_are_rendered_where_the_geometry_puts_them(name: str) -> None:
    camera = RIG.camera(name)
    held = camera.mount == "world"
    board = board_in_hand(SPEC, RIG) if held else board_on_table(SPEC, (0.48, 0.0))
    board[2, 3] += 0.0 if held else 0.001
    scene = world(RIG, Poster(SPEC.image(60), SPEC.size, "flange" if held else "world", board))
    for q in Proposer(RIG, camera, SPEC, board)(2):
        scene.built.set_configuration(q, 0.004)
        found = BoardDetector(SPEC, camera.intrinsics)(scene.render(name).colour)
        assert isinstance(found, Sighting)
        flange = RIG.arm.world_T_base @ RIG.arm.kinematics.forward(q)
        world_T_cam = camera.pose if held else flange @ camera.pose
        cam_T_board = spatial.inverse(world_T_cam) @ (flange @ board if held else board)
        misses = found.corners.px - project(camera.intrinsics, cam_T_board, SPEC.corners[found.corners.ids])
        assert np.abs(misses.mean(0)).max() < 0.1
        assert np.sqrt((misses**2).mean()) < 0.2


def test_the_mask_shows_the_robot_and_nothing_else() -> None:
    scene = world(RIG, None)
    pictures, masks = [], []
    for turn in (0.0, 0.5):
        scene.built.set_configuration(RIG.arm.home + [turn, 0, 0, 0, 0, 0], 0.1)
        pictures.append(scene.render("front").colour.astype(int))
        masks.append(scene.robot_mask("front"))
    changed = np.abs(pictures[0] - pictures[1]).max(-1) > 8
    here_or_there = masks[0] | masks[1]
    assert changed.sum() > 500
    assert (changed & ~here_or_there).sum() < 0.02 * changed.sum()
    only_once = masks[0] ^ masks[1]
    assert (only_once & changed).sum() > 0.9 * only_once.sum()


def test_the_truth_is_off_by_a_little_and_the_same_for_a_seed() -> None:
    first, again, other = displaced(RIG, 1), displaced(RIG, 1), displaced(RIG, 2)
    for a, b, c, nominal in zip(first.cameras, again.cameras, other.cameras, RIG.cameras, strict=True):
        np.testing.assert_array_equal(a.pose, b.pose)
        assert not np.allclose(a.pose, c.pose)
        assert 0 < np.linalg.norm(a.pose[:3, 3] - nominal.pose[:3, 3]) < 0.05
