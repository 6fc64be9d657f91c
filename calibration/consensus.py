"""Views of a board under an arm that moves, the closed form, and which of them agree with each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from resync_robot.calibration.board import BoardSpec
from resync_robot.calibration.detect import Corners
from resync_robot.core import spatial


@dataclass(frozen=True)
class View:
    """One picture of the board.

    Attributes:
        name: for people, such as the name of its file.
        mount_T_other: (4, 4) what the arm measured: flange_T_world for a camera on the flange, world_T_flange for one
            that stands in the world.
        corners: what the camera saw.
        cam_T_board: (4, 4) from this picture alone.
    """

    name: str
    mount_T_other: Float[np.ndarray, "4 4"]
    corners: Corners
    cam_T_board: Float[np.ndarray, "4 4"]


def consensus(spec: BoardSpec, views: Sequence[View], rng: np.random.Generator) -> Bool[np.ndarray, " n"]:
    """(n,) which views agree with the best of many calibrations from a handful each, at any scale."""
    handful, trials = 5, 150
    best, best_score = np.zeros(len(views), dtype=bool), -np.inf
    for _ in range(trials):
        chosen = [views[i] for i in rng.choice(len(views), min(handful, len(views)), replace=False)]
        solution = _linear(chosen)
        if solution is None:
            continue
        errors = _rough_errors(spec, views, *solution)
        # The cap makes it a vote, not an average.
        score = -np.minimum(errors, 1.0).sum()
        if score > best_score:
            best, best_score = errors < 1.0, score
    for _ in range(3):
        if np.sum(best) < 4:
            break
        solution = _linear([v for v, k in zip(views, best, strict=True) if k])
        if solution is None:
            break
        best = _rough_errors(spec, views, *solution) < 1.0
    return best


def _linear(views: Sequence[View]) -> tuple[np.ndarray, float] | None:
    """mount_T_cam and the board's scale from a few views; None where they do not determine it."""
    try:
        rotation = park(views)[:3, :3]
    except cv2.error:
        return None
    if not np.isfinite(rotation).all():
        return None
    # A X = X B with B's translation scaled: (R_A - 1) t - R_X t_B s = -t_A, over neighbouring pairs.
    rows, right = [], []
    for first, second in zip(views, [*views[1:], views[0]], strict=True):
        a = first.mount_T_other @ spatial.inverse(second.mount_T_other)
        b = first.cam_T_board @ spatial.inverse(second.cam_T_board)
        rows.append(np.column_stack([a[:3, :3] - np.eye(3), -rotation @ b[:3, 3]]))
        right.append(-a[:3, 3])
    solution, _, rank, _ = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=1e-6)
    if rank < 4 or not 0.2 < solution[3] < 5.0:
        return None
    return spatial.transform(rotation, solution[:3]), float(solution[3])


def _rough_errors(spec: BoardSpec, views: Sequence[View], mount_T_cam: np.ndarray, scale: float) -> np.ndarray:
    """(n,) how far each view puts the board from where most put it; 1 is the most that noise explains."""
    scaled = np.stack([v.cam_T_board for v in views])
    scaled[:, :3, 3] *= scale
    placed = np.stack([spatial.inverse(v.mount_T_other) for v in views]) @ mount_T_cam @ scaled
    centres = spatial.apply(placed, (scale * spec.centre)[None])[:, 0]
    shift = np.linalg.norm(centres - np.median(centres, axis=0), axis=1)
    turn = np.linalg.norm(placed[:, :3, :3] - np.median(placed[:, :3, :3], axis=0), axis=(1, 2)) / np.sqrt(2)
    # A handful of views determines it to some 3 mm; the exact test comes after the refinement.
    return np.maximum(shift / 0.012, turn / np.radians(3.0))


def park(views: Sequence[View]) -> Float[np.ndarray, "4 4"]:
    """mount_T_cam by PARK's closed form. Raises cv2.error where OpenCV finds none."""
    arm = [spatial.inverse(v.mount_T_other) for v in views]
    rotation, position = cv2.calibrateHandEye(
        [p[:3, :3] for p in arm], [p[:3, 3] for p in arm],
        [v.cam_T_board[:3, :3] for v in views], [v.cam_T_board[:3, 3] for v in views],
        method=cv2.CALIB_HAND_EYE_PARK,
    )  # fmt: skip
    return spatial.transform(np.asarray(rotation), np.ravel(position))


def second_tilt_deg(views: Sequence[View]) -> float:
    """Root mean square turn of camera against board about the second strongest of its axes, degrees."""
    rotations = np.stack([v.mount_T_other[:3, :3] for v in views])
    u, _, vt = np.linalg.svd(rotations.sum(axis=0))
    mean = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    turns = np.stack([spatial.rotation_vector(mean.T @ r) for r in rotations])
    return float(np.degrees(np.linalg.svd(turns, compute_uv=False)[1] / np.sqrt(len(views))))


def difference(first: Float[np.ndarray, "4 4"], second: Float[np.ndarray, "4 4"]) -> tuple[float, float]:
    """How far two poses are apart: mm between their origins, degrees between their axes."""
    turn = np.linalg.norm(spatial.rotation_vector(first[:3, :3].T @ second[:3, :3]))
    return float(1000 * np.linalg.norm(first[:3, 3] - second[:3, 3])), float(np.degrees(turn))
