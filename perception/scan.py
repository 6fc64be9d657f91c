"""Where to hold the wrist camera so that a few pictures show the whole box and the table on both sides of it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.errors import MotionError, PerceptionError
from resync_robot.core.kinematics import BRANCHES
from resync_robot.core.rig import Rig
from resync_robot.core.symbols import Type
from resync_robot.core.vocabulary import DRAWER, LID
from resync_robot.core.world import CameraFrame

LEAST_TIP_HEIGHT = 0.27
"""m above the table: clears the box's walls and a tower of three with a block in the hand."""


CLOSE_TIP_HEIGHT = 0.28
"""m, for a second look at one place."""


@dataclass(frozen=True)
class Viewpoint:
    """A place of the wrist camera, tool down.

    Attributes:
        camera_xy: (x, y) of the camera in the world, m.
        tip_height: of the finger tips above the table, m.
        yaw: direction from the tips to the camera about the world's z, rad. The camera looks back over the tips, so
            the picture covers the far side more than its own.
    """

    camera_xy: tuple[float, float]
    tip_height: float
    yaw: float


BOX_AND_SIDES = (
    Viewpoint((0.46, -0.36), 0.30, -np.pi / 2),
    Viewpoint((0.46, -0.14), 0.33, -np.pi / 2),
    Viewpoint((0.60, 0.00), 0.35, 0.0),
    Viewpoint((0.46, 0.36), 0.30, np.pi / 2),
    Viewpoint((0.46, 0.14), 0.33, np.pi / 2),
    Viewpoint((0.34, 0.00), 0.35, np.pi),
)
"""The box from all four sides (each camera stands inside the walls' outline, or they would hide a corner), the table
on either side; in an order that turns the wrist one way only."""
FURNISHED = (
    Viewpoint((0.40, -0.45), 0.40, -np.pi),
    *BOX_AND_SIDES[:2],
    Viewpoint((0.45, -0.45), 0.40, 0.0),
    *BOX_AND_SIDES[2:4],
    Viewpoint((0.50, 0.43), 0.40, np.pi / 2),
    BOX_AND_SIDES[5],
    Viewpoint((0.50, 0.43), 0.35, 3 * np.pi / 2),
)
"""The same where a lid lies to the right of the box, blocks to the right of the robot, and a cabinet stands to the left
of the box: all edges of its top are seen, from higher up, by one view or the other."""


def viewpoints_for(types: Collection[Type]) -> tuple[Viewpoint, ...]:
    """A round that shows whatever a task with objects of these types has on the table."""
    return FURNISHED if {LID, DRAWER} & set(types) else BOX_AND_SIDES


class Scan:
    """A planned round of pictures.

    Args:
        rig: arm, gripper, and a camera called `camera` on the flange.
        viewpoints: where to look from.

    Raises:
        PerceptionError: a viewpoint is too low, or the camera is not on the flange.
        MotionError: the arm does not reach a viewpoint.
    """

    def __init__(self, rig: Rig, viewpoints: Sequence[Viewpoint] = BOX_AND_SIDES, camera: str = "wrist") -> None:
        self._rig = rig
        self.camera = rig.camera(camera)
        if self.camera.mount != "flange":
            raise PerceptionError(
                f"camera '{camera}' is mounted on the {self.camera.mount}; a scan moves one on the flange",
                "name the wrist camera, or set its mount in the rig file",
            )
        low = [v for v in viewpoints if v.tip_height < LEAST_TIP_HEIGHT]
        if low:
            raise PerceptionError(
                f"a viewpoint holds the tips {low[0].tip_height:.3f} m above the table, at least "
                f"{LEAST_TIP_HEIGHT} m is allowed"
            )
        self.middle: Float[np.ndarray, "2"] = np.mean([v.camera_xy for v in viewpoints], axis=0)
        """Of the round, seen from above: where the box stands, m."""
        self.configurations = self._plan(viewpoints)

    def __call__(
        self,
        move: Callable[[Float[np.ndarray, "6"]], None],
        capture: Callable[[], CameraFrame],
        configurations: Sequence[Float[np.ndarray, "6"]] | None = None,
    ) -> list[CameraFrame]:
        """Take every picture.

        Args:
            move: brings the arm to (6,) joint positions in rad and returns when it stands still there.
            capture: a picture exposed after the call.
            configurations: where from, such as those of `towards`; default: the whole round.
        """
        frames = []
        for q in self.configurations if configurations is None else configurations:
            move(q)
            frames.append(capture())
        return frames

    def towards(self, place: Sequence[float] | Float[np.ndarray, "2"], count: int = 2) -> list[Float[np.ndarray, "6"]]:
        """Configurations that put a place of the table into the middle of the picture, from up to `count` sides.

        The first side is that of the middle of the round: from there no wall of the box hides its corner. Fewer than
        `count`, or none, where the arm does not reach.
        """
        place = np.asarray(place, dtype=np.float64)
        first = float(np.arctan2(*(self.middle - place)[::-1]))
        found = (self.close_by(place, first + turn) for turn in (0.0, np.pi / 2, -np.pi / 2, np.pi / 4, -np.pi / 4))
        return list(islice((q for q in found if q is not None), count))

    def close_by(
        self, place: Float[np.ndarray, "2"], yaw: float, tip_height: float = CLOSE_TIP_HEIGHT, above: float = 0.0
    ) -> Float[np.ndarray, "6"] | None:
        """The configuration that puts a place `above` the table (m) into the middle of the picture, from the side at
        `yaw` rad about the world's z; None where the arm does not reach."""
        x, y = place + self._ahead(tip_height - above) * np.array([np.cos(yaw), np.sin(yaw)])
        try:
            return self._plan([Viewpoint((float(x), float(y)), tip_height, yaw)])[0]
        except MotionError:
            return None

    def _ahead(self, tip_height: float) -> float:
        """How far in front of the camera its optical axis meets what the tips are so high above, m seen from above."""
        flange_T_cam = self.camera.pose
        down, forth = flange_T_cam[2, 2], -flange_T_cam[0, 2]
        height = tip_height + self._rig.gripper.tip_offset - flange_T_cam[2, 3]
        return float(height * forth / down)

    def tip_pose(self, viewpoint: Viewpoint) -> Float[np.ndarray, "4 4"]:
        """world_T_tip that puts the camera at a viewpoint."""
        rotation = spatial.rotation_about("z", viewpoint.yaw) @ spatial.rotation_about("x", np.pi)
        offset = rotation @ self.camera.pose[:3, 3]
        position = np.array([*viewpoint.camera_xy, viewpoint.tip_height])
        position[:2] -= offset[:2]
        return spatial.transform(rotation, position)

    def _plan(self, viewpoints: Sequence[Viewpoint]) -> list[Float[np.ndarray, "6"]]:
        """Configurations on the arm's branch at home: another branch would fold the forearm into the picture."""
        arm, kinematics = self._rig.arm, self._rig.arm.kinematics
        branch = min(BRANCHES, key=lambda b: self._distance_from_home(b))
        base_T_world, tip_T_flange = spatial.inverse(arm.world_T_base), spatial.inverse(self._rig.gripper.flange_T_tip)
        configurations, last = [], arm.home
        for view in viewpoints:
            with np.errstate(invalid="ignore"):
                q = kinematics.inverse_branch(base_T_world @ self.tip_pose(view) @ tip_T_flange, branch)
            q = q + 2 * np.pi * np.round((last - q) / (2 * np.pi))
            limit = kinematics.joint_limit
            q = np.where(q > limit, q - 2 * np.pi, np.where(q < -limit, q + 2 * np.pi, q))
            if not np.all(np.abs(q) <= limit):
                raise MotionError(f"the arm cannot hold the wrist camera at {view}", "move the viewpoint nearer")
            configurations.append(q)
            last = q
        return configurations

    def _distance_from_home(self, branch: tuple[int, int, int]) -> float:
        home, kinematics = self._rig.arm.home, self._rig.arm.kinematics
        with np.errstate(invalid="ignore"):
            q = kinematics.inverse_branch(kinematics.forward(home), branch)
        away = np.abs(spatial.wrap(q - home)).max()
        return float(away) if np.isfinite(away) else np.inf
