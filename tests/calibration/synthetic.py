"""Views of a board made by projection: a known truth, with the noise of pixels and of an arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from resync_robot.calibration.board import BoardSpec
from resync_robot.calibration.detect import Corners, project
from resync_robot.calibration.hand_eye import Calibrator, View
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


def draw_pose(rng: np.random.Generator, most_tilt_deg: float = 45.0) -> np.ndarray:
    """cam_T_board with most of the board in the picture, tilted by up to `most_tilt_deg`."""
    while True:
        tilt, around = np.radians(rng.uniform(0.25, 1.0) * most_tilt_deg), rng.uniform(-np.pi, np.pi)
        axis = np.array([np.cos(around), np.sin(around), 0.0])
        turn = spatial.rotation_from_vector(axis * tilt) @ spatial.rotation_about("z", rng.uniform(-np.pi, np.pi))
        place = np.array([rng.uniform(-0.08, 0.08), rng.uniform(-0.04, 0.04), rng.uniform(0.34, 0.48)])
        pose = spatial.transform(turn, place - turn @ SPEC.centre)
        if visible(pose).mean() >= 0.75:
            return pose


def visible(cam_T_board: np.ndarray) -> np.ndarray:
    """(n,) which corners are in the picture."""
    px = project(INTRINSICS, cam_T_board, SPEC.corners)
    return ((px > 3) & (px < [420, 236])).all(-1)


def draw_views(rng: np.random.Generator, setup: Setup, count: int, most_tilt_deg: float = 45.0) -> list[View]:
    """Views from anywhere, whether an arm gets there or not."""
    poses = []
    for _ in range(count):
        mount_T_other = setup.mount_T_cam @ draw_pose(rng, most_tilt_deg) @ spatial.inverse(setup.other_T_board)
        poses.append(mount_T_other if setup.arm_moves_board else spatial.inverse(mount_T_other))
    return views_from(rng, setup, poses)


def views_from(rng: np.random.Generator, setup: Setup, poses: Sequence[np.ndarray]) -> list[View]:
    """What the camera sees with the flange at each of the poses, and what the arm says about them."""
    calibrator = Calibrator(SPEC, INTRINSICS, setup.arm_moves_board)
    views: list[View] = []
    for i, world_T_flange in enumerate(poses):
        mount_T_other = world_T_flange if setup.arm_moves_board else spatial.inverse(world_T_flange)
        cam_T_board = spatial.inverse(setup.mount_T_cam) @ mount_T_other @ setup.other_T_board
        ids = np.flatnonzero(visible(cam_T_board))
        if len(ids) < 12:
            continue
        px = project(INTRINSICS, cam_T_board, SPEC.corners[ids])
        # The arm is where it must be for this picture; what it reports is a little off.
        reported = world_T_flange @ jolt(rng, setup.arm_rotation, setup.arm_position)
        views.append(calibrator.view(f"{i:03d}", reported, Corners(ids, px + rng.normal(0, setup.pixel_px, px.shape))))
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


def spoil(rng: np.random.Generator, setup: Setup, views: list[View]) -> list[View]:
    """The first five views gone bad: the board moved in two, two blurred, wrong marker numbers in one."""
    kinds = ("moved", "moved", "blurred", "blurred", "ids")
    bad = [_spoilt(rng, setup, view, kind) for view, kind in zip(views, kinds, strict=False)]
    return [*bad, *views[len(bad) :]]


def _spoilt(rng: np.random.Generator, setup: Setup, view: View, kind: str) -> View:
    corners = view.corners
    if kind == "moved":
        elsewhere = moved(rng, setup, rng.uniform(0.005, 0.03))
        pose = spatial.inverse(setup.mount_T_cam) @ view.mount_T_other @ elsewhere.other_T_board
        px = project(INTRINSICS, pose, SPEC.corners[corners.ids]) + rng.normal(0, setup.pixel_px, corners.px.shape)
        return with_corners(view, Corners(corners.ids, px), setup)
    if kind == "blurred":
        # The picture was taken while the arm moved: corners smeared, and seen from some way further on.
        px = corners.px + rng.normal(0, 1.0, corners.px.shape) + rng.uniform(2, 4, 2) * rng.choice([-1, 1], 2)
        return with_corners(view, Corners(corners.ids, px), setup)
    # Every marker taken for that of the next row.
    below = corners.ids + SPEC.columns - 1
    fits = below < len(SPEC.corners)
    return with_corners(view, Corners(below[fits], corners.px[fits]), setup)


def photograph(cam_T_board: np.ndarray, spec: BoardSpec = SPEC, size: tuple[int, int] = (424, 240)) -> np.ndarray:
    """(h, w, 3) RGB picture of the board, every pixel the mean of 64 samples."""
    cell, fine = 60, 8
    width, height = spec.size
    outline = np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]])
    there = ((project(INTRINSICS, cam_T_board, outline) + 0.5) * fine - 0.5).astype(np.float32)
    w, h = spec.columns * cell, spec.rows * cell
    here = np.array([[0, 0], [w, 0], [w, h], [0, h]], dtype=np.float32) - 0.5
    warp = cv2.getPerspectiveTransform(here, there)
    large = cv2.warpPerspective(spec.image(cell), warp, (size[0] * fine, size[1] * fine), borderValue=200)
    return np.dstack([cv2.resize(large, size, interpolation=cv2.INTER_AREA)] * 3)
