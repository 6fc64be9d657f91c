"""Views of a board made by projection: a known truth, with the noise of pixels and of an arm."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration.board import BoardSpec
from calibration.detect import Corners, project
from calibration.hand_eye import Calibrator, View
from resync_robot.core import spatial

INTRINSICS = np.array([[308.6, 0, 212.0], [0, 308.6, 120.0], [0, 0, 1.0]])
SPEC = BoardSpec()


@dataclass(frozen=True, kw_only=True)
class Setup:
    """A camera and a board to be found; noise per axis."""

    mount_T_cam: np.ndarray
    other_T_board: np.ndarray
    arm_moves_board: bool
    pixel_px: float = 0.25
    arm_position: float = 0.3e-3
    arm_rotation: float = 0.0


def draw_setup(rng: np.random.Generator, arm_moves_board: bool, **noise: float) -> Setup:
    if arm_moves_board:
        board = spatial.transform(spatial.rotation_about("x", np.pi / 2), np.array([-0.095, 0.0, 0.23]))
        camera = spatial.pose_from_features(np.array([1.0, 0.0, 0.8, 0.208981, -0.67552, -0.67552, 0.208981]))
    else:
        down = np.array([[0, 1.0, 0], [1, 0, 0], [0, 0, -1]])
        board = spatial.transform(down, np.array([0.48, 0, 0]) - down @ SPEC.centre)
        camera = spatial.pose_from_features(np.array([0.11, 0.0, 0.05, 0.701057, -0.092296, -0.092296, 0.701057]))
    return Setup(
        mount_T_cam=camera @ jolt(rng, 0.03, 0.01),
        other_T_board=board @ jolt(rng, 0.1, 0.02),
        arm_moves_board=arm_moves_board,
        **noise,
    )


def jolt(rng: np.random.Generator, turn: float, shift: float) -> np.ndarray:
    """A random small motion, sigmas per axis in rad and m."""
    return spatial.transform(spatial.rotation_from_vector(rng.normal(0, turn, 3)), rng.normal(0, shift, 3))


def draw_views(rng: np.random.Generator, setup: Setup, count: int, most_tilt_deg: float = 40.0) -> list[View]:
    """Views that have the whole board in the picture, tilted by up to `most_tilt_deg` each way."""
    calibrator = Calibrator(SPEC, INTRINSICS, setup.arm_moves_board)
    views: list[View] = []
    while len(views) < count:
        tilt, around = np.radians(rng.uniform(0, most_tilt_deg)), rng.uniform(-np.pi, np.pi)
        axis = np.array([np.cos(around), np.sin(around), 0.0])
        turn = spatial.rotation_from_vector(axis * tilt) @ spatial.rotation_about("z", rng.uniform(-1.0, 1.0))
        place = np.array([rng.uniform(-0.08, 0.08), rng.uniform(-0.04, 0.04), rng.uniform(0.34, 0.5)])
        cam_T_board = spatial.transform(turn, place - turn @ SPEC.centre)
        px = project(INTRINSICS, cam_T_board, SPEC.corners)
        if (px.min(0) < 3).any() or (px.max(0) > [421, 237]).any():
            continue
        # The arm is where it must be for this picture; what it reports is a little off.
        mount_T_other = setup.mount_T_cam @ cam_T_board @ spatial.inverse(setup.other_T_board)
        arm = mount_T_other if setup.arm_moves_board else spatial.inverse(mount_T_other)
        reported = arm @ jolt(rng, setup.arm_rotation, setup.arm_position)
        corners = Corners(np.arange(len(px)), px + rng.normal(0, setup.pixel_px, px.shape))
        views.append(calibrator.view(f"{len(views):03d}", reported, corners))
    return views


def with_corners(view: View, corners: Corners, setup: Setup) -> View:
    """The same arm, another picture."""
    calibrator = Calibrator(SPEC, INTRINSICS, setup.arm_moves_board)
    arm = view.mount_T_other if setup.arm_moves_board else spatial.inverse(view.mount_T_other)
    return replace(calibrator.view(view.name, arm, corners), mount_T_other=view.mount_T_other)


def moved(rng: np.random.Generator, setup: Setup, shift: float) -> Setup:
    """The board somewhere else, `shift` m away."""
    direction = rng.normal(0, 1, 3)
    step = spatial.transform(None, shift * direction / np.linalg.norm(direction))
    return replace(setup, other_T_board=setup.other_T_board @ step)
