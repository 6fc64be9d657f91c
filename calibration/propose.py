"""Poses of the arm from which a calibration learns most: the board large in the picture and tilted far, every way.

Candidates are drawn at random, those that the arm does not reach or that come near anything are dropped, and of the
rest those are taken that are least alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from resync_robot.calibration.board import BoardSpec
from resync_robot.calibration.detect import project
from resync_robot.core import spatial
from resync_robot.core.errors import CalibrationError
from resync_robot.core.kinematics import BRANCHES
from resync_robot.core.rig import CameraRig, Rig
from resync_robot.hardware.base import SafetyError
from resync_robot.hardware.workspace import Workspace, heights

CANDIDATES = 1200
PATH_STEP = 0.05
"""rad between the points at which a way is checked."""
TILT_WEIGHT = 0.4
"""m a rad: how much a turn counts against a shift where views are compared."""


@dataclass(frozen=True, kw_only=True)
class Reach:
    """Where the arm may go with the board."""

    most_tilt_deg: float = 45.0
    """Between the board's normal and the direction from which it is seen."""
    near: float = 0.32
    """m from the camera to the board's centre."""
    far: float = 0.48
    least_height: float = 0.04
    """m of the tips and of the held board above the table."""
    least_link_height: float = 0.10
    """m of the elbow, wrist and flange above the table."""
    least_distance: float = 0.12
    """m of hand and held board from upper arm, forearm and base column, and of all from cameras that stand about."""
    least_in_picture: float = 0.75
    """Share of the board's corners."""


def board_on_table(spec: BoardSpec, xy: tuple[float, float], yaw: float = 0.0) -> Float[np.ndarray, "4 4"]:
    """world_T_board of a board that lies face up with its centre at (x, y) m."""
    rotation = spatial.rotation_about("z", yaw) @ np.array([[0, 1.0, 0], [1, 0, 0], [0, 0, -1]])
    return spatial.transform(rotation, np.array([*xy, 0.0]) - rotation @ spec.centre)


def board_in_hand(spec: BoardSpec, rig: Rig, depth: float = 0.02) -> Float[np.ndarray, "4 4"]:
    """flange_T_board of a board whose upper edge the pads hold, `depth` m deep; it faces along y of the flange."""
    rotation = spatial.rotation_about("x", np.pi / 2)
    return spatial.transform(rotation, np.array([-spec.size[0] / 2, 0.0, rig.gripper.tip_offset - depth]))


def with_board(rig: Rig, spec: BoardSpec) -> Rig:
    """The rig with a longer hand, so that the safety gate keeps the held board off the table too."""
    return replace(rig, gripper=replace(rig.gripper, tip_offset=rig.gripper.tip_offset + spec.size[1]))


class Proposer:
    """Poses for one camera.

    Args:
        rig: the arm, and roughly where the camera is.
        camera: which; on the flange, or standing in the world while the flange holds the board.
        other_T_board: (4, 4) roughly where the board is: in the world, or in the flange.
        reach: limits.
    """

    def __init__(
        self,
        rig: Rig,
        camera: CameraRig,
        spec: BoardSpec,
        other_T_board: Float[np.ndarray, "4 4"],
        reach: Reach | None = None,
    ) -> None:
        self.rig, self.camera, self.spec, self.board = rig, camera, spec, other_T_board
        self.reach = reach or Reach()
        self.held = camera.mount == "world"
        width, height = spec.size
        corners = np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]])
        tips = spatial.apply(rig.gripper.flange_T_tip, np.array([[0, y, 0] for y in (-0.08, 0.0, 0.08)]))
        # What the flange carries, in its frame.
        self._carried = np.concatenate([tips, spatial.apply(other_T_board, corners)]) if self.held else tips
        self._workspace = Workspace(with_board(rig, spec) if self.held else rig)
        self._keep_off = np.array([c.pose[:3, 3] for c in rig.cameras if c.mount == "world"]).reshape(-1, 3)

    def __call__(self, count: int, seed: int = 0) -> list[Float[np.ndarray, "6"]]:
        """`count` configurations in rad, ordered so that each way from the one before (home first) is free.

        Raises:
            CalibrationError: the arm does not reach so many.
        """
        rng = np.random.default_rng(seed)
        seen, branch = self._draw(rng), self.rig.arm.kinematics.branch_of(self.rig.arm.home)
        q, seen = self._reachable(seen, branch)
        if self.held:
            # Nobody knows beforehand how an arm holds a board best: the branch that reaches most.
            options = [self._reachable(self._draw(rng), b) for b in BRANCHES]
            q, seen = max(options, key=lambda option: len(option[0]))
        chosen = self._spread(seen, min(len(q), 3 * count))
        path = self._order(q[chosen])[:count]
        if len(path) < count:
            raise CalibrationError(
                f"the arm reaches {len(path)} of {count} poses with the board before camera '{self.camera.name}'",
                "ask for fewer --poses, move the board (--board-at X Y) into the middle of the arm's reach, or mend "
                "the camera's rough pose in the rig file",
            )
        return path

    def _draw(self, rng: np.random.Generator) -> Float[np.ndarray, "n 4 4"]:
        """cam_T_board of candidates that have enough of the board in the picture."""
        reach, n = self.reach, CANDIDATES
        most = np.radians(reach.most_tilt_deg)
        tilt, around = rng.uniform(0.25 * most, most, n), rng.uniform(-np.pi, np.pi, n)
        axis = np.stack([np.cos(around), np.sin(around), np.zeros(n)], -1)
        roll = rng.uniform(-np.pi, np.pi, n)
        turn = np.stack([spatial.rotation_from_vector(a * t) for a, t in zip(axis, tilt, strict=True)])
        turn = turn @ spatial.rotation_about("z", roll)
        depth = rng.uniform(reach.near, reach.far, n)
        camera = self.camera
        span = np.array([camera.width / camera.fx, camera.height / camera.fy])
        place = np.column_stack([rng.uniform(-0.2, 0.2, (n, 2)) * span, np.ones(n)]) * depth[:, None]
        seen = spatial.transform(turn, place - turn @ self.spec.centre)
        px = project(camera.intrinsics, seen, np.broadcast_to(self.spec.corners, (n, *self.spec.corners.shape)))
        inside = ((px > 2) & (px < np.array([camera.width, camera.height]) - 3)).all(-1)
        return seen[inside.mean(-1) >= reach.least_in_picture]

    def _reachable(
        self, seen: Float[np.ndarray, "n 4 4"], branch: tuple[int, int, int]
    ) -> tuple[Float[np.ndarray, "k 6"], Float[np.ndarray, "k 4 4"]]:
        other = self.camera.pose @ seen @ spatial.inverse(self.board)
        world_T_flange = other if self.held else spatial.inverse(other)
        arm = self.rig.arm
        with np.errstate(invalid="ignore"):
            q = arm.kinematics.inverse_branch(spatial.inverse(arm.world_T_base) @ world_T_flange, branch)
        home = arm.home
        q = q + 2 * np.pi * np.round((home - q) / (2 * np.pi))
        good = np.isfinite(q).all(-1) & (np.abs(q) <= arm.kinematics.joint_limit).all(-1)
        good[good] = self.clear(q[good])
        return q[good], seen[good]

    def clear(self, q: Float[np.ndarray, "n 6"]) -> Bool[np.ndarray, " n"]:
        """Whether nothing is too near to the table, to the arm itself, or to a camera that stands in the world."""
        reach, arm = self.reach, self.rig.arm
        if not len(q):
            return np.zeros(0, dtype=bool)
        _, tip = heights(arm.kinematics, q, arm.world_T_base[2], self.rig.gripper.tip_offset)
        found = tip > reach.least_height
        for i in np.flatnonzero(found):
            frames = arm.world_T_base @ arm.kinematics.link_frames(q[i])
            joints, carried = frames[:, :3, 3], spatial.apply(frames[-1], self._carried)
            shoulder, elbow, wrist = joints[0], joints[1], joints[2]
            near = min(
                _distance(carried, arm.world_T_base[:3, 3], shoulder),
                _distance(carried, shoulder, elbow),
                _distance(carried, elbow, wrist),
                *(_distance(np.concatenate([carried, joints[1:]]), c, c) for c in self._keep_off),
            )
            found[i] = (
                carried[:, 2].min() > reach.least_height
                and joints[1:, 2].min() > reach.least_link_height
                and near > reach.least_distance
                and self._is_allowed(q[i : i + 1])
            )
        return found

    def _is_allowed(self, q: Float[np.ndarray, "1 6"]) -> bool:
        """Would the safety gate let it pass? It ends the round otherwise."""
        try:
            self._workspace.check(q)
        except SafetyError:
            return False
        return True

    def _spread(self, seen: Float[np.ndarray, "n 4 4"], count: int) -> list[int]:
        """Indices of views that are least alike, the most different first."""
        if not len(seen):
            return []
        chosen = [0]
        nearest = apart(seen, seen[0])
        while len(chosen) < count:
            chosen.append(int(nearest.argmax()))
            nearest = np.minimum(nearest, apart(seen, seen[chosen[-1]]))
        return chosen

    def _order(self, q: Float[np.ndarray, "n 6"]) -> list[Float[np.ndarray, "6"]]:
        """From home always to the nearest in joint space to which the way is free; those without one are dropped."""
        here, rest, path = self.rig.arm.home, list(q), []
        while rest:
            rest.sort(key=lambda other: float(np.abs(other - here).max()))
            following = next((i for i, other in enumerate(rest) if self.way_is_clear(here, other)), None)
            if following is None:
                break
            here = rest.pop(following)
            path.append(here)
        return path

    def way_is_clear(self, begin: Float[np.ndarray, "6"], end: Float[np.ndarray, "6"]) -> bool:
        """Whether the straight way in joint space keeps clear."""
        steps = int(np.ceil(np.abs(end - begin).max() / PATH_STEP)) + 1
        return bool(self.clear(begin + np.linspace(0, 1, steps + 1)[1:, None] * (end - begin)).all())


def apart(seen: Float[np.ndarray, "n 4 4"], other: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, " n"]:
    """How different views are, m: shift, and turn by TILT_WEIGHT."""
    cosine = (np.einsum("nij,ij->n", seen[:, :3, :3], other[:3, :3]) - 1) / 2
    turn = np.arccos(np.clip(cosine, -1, 1))
    return np.linalg.norm(seen[:, :3, 3] - other[:3, 3], axis=-1) + TILT_WEIGHT * turn


def _distance(points: np.ndarray, begin: np.ndarray, end: np.ndarray) -> float:
    """Least distance of (n, 3) points from a segment, m."""
    along = end - begin
    share = np.clip((points - begin) @ along / max(float(along @ along), 1e-12), 0, 1)
    return float(np.linalg.norm(points - begin - share[:, None] * along, axis=-1).min())
