"""Where the arm may be: within its joints' reach, over the table, in the workspace, clear of itself and obstacles."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from resync_robot.core.joints import ARM_JOINTS
from resync_robot.core.kinematics import Kinematics
from resync_robot.core.rig import Rig
from resync_robot.hardware.base import SafetyError
from resync_robot.hardware.clearance import Clearance, Obstacle

MARGIN = 0.015
"""m that must stay free between parts of the arm, and between them and what stands around."""


class Workspace:
    """The workspace of one rig's arm.

    Args:
        rig: limits, mounting and gripper.
        table_z: height of the table in the world, m.
        margin: how far below the table the tip may be put, m; pressing on things needs a little.

    Attributes:
        table_z, margin: as given.
        floor: m in the world below which neither tip nor flange goes.
    """

    def __init__(self, rig: Rig, table_z: float = 0.0, margin: float = 0.01) -> None:
        self.table_z, self.margin = table_z, margin
        self.floor = table_z - margin
        self._kinematics = rig.arm.kinematics
        self._tip_offset = rig.gripper.tip_offset
        self._base_up = rig.arm.world_T_base[2]
        self._controller = rig.controller
        self._clearance = Clearance(rig, table_z)

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        return self._clearance.obstacles

    def keep_out(self, *obstacles: Obstacle) -> None:
        """Let nothing but the hand come near these, from now on."""
        self._clearance.obstacles = obstacles

    def frames(self, q: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, "n 7 4 4"]:
        """See `Clearance.frames`."""
        return self._clearance.frames(q)

    def tips(self, frames: Float[np.ndarray, "n 7 4 4"]) -> Float[np.ndarray, "n 3"]:
        """Where the tip is in the world, m."""
        return frames[:, -1, :3, 3] + self._tip_offset * frames[:, -1, :3, 2]

    def check(self, q: Float[np.ndarray, "n 6"]) -> None:
        """Refuse configurations (rad) in which the arm must not be. Raises SafetyError."""
        self.check_joints(q)
        self.check_frames(self.frames(q))

    def check_joints(self, q: Float[np.ndarray, "n 6"]) -> None:
        """What costs little: numbers, the joints' own limits, and the floor. Raises SafetyError."""
        wrong = ~(np.abs(q) <= self._kinematics.joint_limit)
        if wrong.any():
            row, joint = (int(i) for i in np.argwhere(wrong)[0])
            value, allowed = float(q[row, joint]), self._kinematics.limit[joint]
            if not np.isfinite(value):
                raise SafetyError(
                    "finite", ARM_JOINTS[joint], value, np.inf, f"{ARM_JOINTS[joint]} is asked to go to {value}"
                )
            raise SafetyError(
                "position", ARM_JOINTS[joint], value, allowed,
                f"{ARM_JOINTS[joint]} would have position {value:.4g} rad, setpoint {row + 1} of {len(q)}; "
                f"allowed: +-{allowed:.4g} rad",
            )  # fmt: skip
        flange, tip = heights(self._kinematics, q, self._base_up, self._tip_offset)
        for name, height in (("tip", tip), ("flange", flange)):
            lowest = float(height.min())
            if lowest < self.floor:
                raise SafetyError(
                    "floor", name, lowest, self.floor,
                    f"the {name} would be at height {lowest:.4f} m; the lowest allowed is {self.floor:.4f} m",
                    "raise the target, or check the table's height and world_T_base in the rig file",
                )  # fmt: skip

    def check_frames(self, frames: Float[np.ndarray, "n 7 4 4"]) -> None:
        """Refuse what lies outside the workspace, or brings parts of the arm too near to each other or to others.

        Raises SafetyError.
        """
        if not len(frames):
            return
        if self._controller is not None:
            tips, low, high = self.tips(frames), self._controller.workspace_low, self._controller.workspace_high
            beyond = np.maximum(low - tips, tips - high)
            row, axis = (int(i) for i in np.unravel_index(int(beyond.argmax()), beyond.shape))
            if beyond[row, axis] > 0:
                value, bounds = float(tips[row, axis]), f"{low[axis]:.3f} to {high[axis]:.3f} m"
                raise SafetyError(
                    "workspace", "tip", value, float((low if value < low[axis] else high)[axis]),
                    f"the tip would be at {'xyz'[axis]} = {value:.3f} m; allowed: {bounds}",
                    "[controller] workspace_low and workspace_high in the rig file set the limits",
                )  # fmt: skip
        gap = self._clearance.below(frames, MARGIN)
        if gap is not None:
            raise SafetyError(
                "clearance", gap.one, gap.distance, MARGIN,
                f"{gap.one} would be {1000 * gap.distance:.0f} mm from {gap.other}; allowed: {1000 * MARGIN:.0f} mm",
                "choose another way there, or another branch of the arm",
            )  # fmt: skip


def heights(
    kinematics: Kinematics, q: Float[np.ndarray, "n 6"], base_up: Float[np.ndarray, "4"], tip_offset: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Heights of flange and tip in the world, m; `base_up` is the third row of world_T_base.

    The closed form of `Kinematics.forward`, with the world's up axis seen from the frame of joint 1, for that is all
    a height needs: a fraction of the time of whole matrices, which counts at 500 Hz.
    """
    angles = q[:, :5].T.copy()
    angles[2] += angles[1]
    angles[3] += angles[2]
    (c1, c2, c23, c234, c5), (s1, s2, s23, s234, s5) = np.cos(angles), np.sin(angles)
    (d1, _, _, d4, d5, d6), (_, a2, a3, _, _, _) = kinematics.d, kinematics.a
    up_x, up_y, up_z, base = base_up.tolist()
    up_along, up_across = up_x * c1 + up_y * s1, up_x * s1 - up_y * c1
    # The flange's z axis and the middle of the wrist's last joint; across the arm they are c5 and d4.
    axis_x, axis_y = -c234 * s5, -s234 * s5
    x, y = a2 * c2 + a3 * c23 + d5 * s234, a2 * s2 + a3 * s23 - d5 * c234 + d1
    lift = up_along * axis_x + up_z * axis_y + up_across * c5
    height = base + up_along * x + up_z * y + up_across * d4 + d6 * lift
    return height, height + tip_offset * lift
