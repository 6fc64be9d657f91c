"""Proposed poses are within reach and clear of everything, show the board, and differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from resync_robot.calibration.detect import project
from resync_robot.calibration.propose import Proposer, Reach, apart, board_in_hand, board_on_table, with_board
from resync_robot.core import spatial
from resync_robot.core.errors import CalibrationError
from resync_robot.core.rig import load_rig
from resync_robot.hardware.workspace import Workspace
from tests.calibration.synthetic import SPEC
from tests.emulators import RIG_FILE

RIG = load_rig()


def proposer(name: str, reach: Reach | None = None) -> Proposer:
    camera = RIG.camera(name)
    board = board_on_table(SPEC, (0.48, 0.0)) if camera.mount == "flange" else board_in_hand(SPEC, RIG)
    return Proposer(RIG, camera, SPEC, board, reach)


@pytest.mark.parametrize("name", ["wrist", "front"])
def test_proposed_poses_show_the_board_tilted_and_keep_clear(name: str) -> None:
    propose = proposer(name)
    poses = propose(12)
    assert len(poses) == 12
    assert propose.clear(np.array(poses)).all()
    camera, seen = RIG.camera(name), []
    for q in poses:
        assert (np.abs(q) <= RIG.arm.kinematics.joint_limit).all()
        flange = RIG.arm.world_T_base @ RIG.arm.kinematics.forward(q)
        world_T_cam = flange @ camera.pose if camera.mount == "flange" else camera.pose
        world_T_board = propose.board if camera.mount == "flange" else flange @ propose.board
        seen.append(spatial.inverse(world_T_cam) @ world_T_board)
        px = project(camera.intrinsics, seen[-1], SPEC.corners)
        assert ((px > 0) & (px < [camera.width, camera.height])).all(-1).mean() >= 0.7
        assert seen[-1][2, 2] > 0, "the printed side faces the camera"
    tilts = [np.degrees(np.arccos(pose[2, 2])) for pose in seen]
    assert max(tilts) > 35.0
    nearest = [np.sort(apart(np.array(seen), pose))[1] for pose in seen]
    assert min(nearest) > 0.08
    steps = np.linspace(0, 1, 7)[:, None]
    for begin, end in zip([RIG.arm.home, *poses], poses, strict=False):
        assert propose.clear((begin + steps * (end - begin))[1:]).all()


@pytest.mark.parametrize("name", ["wrist", "front"])
def test_the_safety_gate_of_a_real_arm_lets_the_whole_round_pass(name: str) -> None:
    rig = load_rig(RIG_FILE)
    camera = rig.camera(name)
    board = board_on_table(SPEC, (0.48, 0.0)) if camera.mount == "flange" else board_in_hand(SPEC, rig)
    workspace = Workspace(rig if camera.mount == "flange" else with_board(rig, SPEC))
    steps = np.linspace(0, 1, 40)[:, None]
    for seed in (0, 3):
        here = rig.arm.home
        for q in Proposer(rig, camera, SPEC, board)(24, seed):
            workspace.check(here + steps * (q - here))
            here = q


def test_the_same_seed_proposes_the_same() -> None:
    propose = proposer("wrist")
    np.testing.assert_array_equal(propose(5, seed=3), propose(5, seed=3))
    assert not np.array_equal(propose(5, seed=3), propose(5, seed=4))


def test_a_low_hand_and_a_folded_arm_are_not_clear() -> None:
    propose = proposer("wrist")
    down = spatial.transform(spatial.rotation_about("x", np.pi), np.array([0.5, 0.0, 0.25]))
    base_T_world = spatial.inverse(RIG.arm.world_T_base)
    low = RIG.arm.kinematics.inverse(base_T_world @ down, RIG.arm.home)
    folded = np.array([0.0, -1.5, 2.9, -1.4, -1.57, 0.0])
    assert propose.clear(np.array([RIG.arm.home, low, folded])).tolist() == [True, False, False]
    assert propose.clear(np.zeros((0, 6))).shape == (0,)


def test_a_camera_in_the_way_is_kept_clear_of() -> None:
    tip = RIG.tip_pose(RIG.arm.home)
    camera = replace(RIG.camera("front"), pose=spatial.transform(None, tip[:3, 3] + [0.05, 0, 0]))
    rig = replace(RIG, cameras=(RIG.camera("wrist"), camera))
    propose = Proposer(rig, rig.camera("wrist"), SPEC, board_on_table(SPEC, (0.48, 0.0)))
    assert not propose.clear(RIG.arm.home[None]).any()


def test_a_board_out_of_reach_is_refused() -> None:
    propose = Proposer(RIG, RIG.camera("wrist"), SPEC, board_on_table(SPEC, (1.6, 0.0)))
    with pytest.raises(CalibrationError, match="reaches 0 of 10"):
        propose(10)


def test_the_held_board_faces_along_the_closing_axis() -> None:
    board = board_in_hand(SPEC, RIG)
    np.testing.assert_allclose(-board[:3, 2], [0, 1, 0], atol=1e-12)
    middle = spatial.apply(board, SPEC.centre[None])[0]
    np.testing.assert_allclose(middle[:2], 0, atol=1e-12)
    assert middle[2] == pytest.approx(RIG.gripper.tip_offset - 0.02 + SPEC.size[1] / 2)
