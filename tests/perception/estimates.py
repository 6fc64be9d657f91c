"""Estimates such as a scan gives, made by hand: a box, blocks of one size, and the hand that grips them."""

from __future__ import annotations

import numpy as np

from resync_robot.core import spatial
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.perception.belief import Belief
from resync_robot.perception.blocks import SIZE_SIGMA, STOREY_SIGMA, BlockEstimate, Glimpse
from resync_robot.perception.objects import SceneEstimate
from resync_robot.perception.pose import HEIGHT_SIGMA, BoxEstimate, tie_height, upright_covariance

R, THE_BOX, B0, B1 = ROBOT("r"), BOX("box"), BLOCK("b0"), BLOCK("b1")
FLOOR = 0.005
WIDTH, HEIGHT = 0.060, 0.045


def box() -> BoxEstimate:
    features = np.array([0.48, 0, FLOOR, 1, 0, 0, 0, 0.30, 0.30, 0.105, 0.03])
    return BoxEstimate(features, np.eye(11) * 1e-6)


def block(
    name: str, x: float, y: float, bottom: float = FLOOR, yaw: float = 0.0, stacked: bool = False, upright: bool = True
) -> BlockEstimate:
    quat = spatial.quat_from_yaw(yaw)
    features = np.array([x, y, bottom + HEIGHT / 2, *quat, WIDTH, WIDTH, HEIGHT])
    covariance = np.eye(10) * 1e-6
    covariance[:7, :7] = upright_covariance(np.full(3, 1e-6), 1e-5, quat)
    tie_height(covariance, STOREY_SIGMA / np.sqrt(2) if stacked else SIZE_SIGMA, HEIGHT_SIGMA)
    return BlockEstimate(name, features, covariance, bottom + HEIGHT, upright, stacked, 4)


def scene(*blocks: BlockEstimate, glimpses: tuple[Glimpse, ...] = ()) -> SceneEstimate:
    return SceneEstimate(box(), {b.name: b for b in blocks}, {g.name: g for g in glimpses})


def robot(x: float = 0.45, y: float = 0.0, z: float = 0.30, opening: float = 0.14, yaw: float = 0.0) -> np.ndarray:
    rotation = spatial.rotation_about("z", yaw) @ spatial.rotation_about("x", np.pi)
    return np.concatenate([spatial.features_from_pose(spatial.transform(rotation, np.array([x, y, z]))), [opening]])


def grasp(belief: Belief, x: float, y: float, yaw: float = 0.0) -> None:
    for opening in (0.14, 0.10, WIDTH + 0.004, WIDTH + 0.001):
        belief.state(robot(x, y, FLOOR + HEIGHT / 2, opening, yaw))
