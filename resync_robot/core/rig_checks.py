"""What the fields of a rig must be together: names unique, bounds in order, and what its arm and gripper allow."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from resync_robot.core.errors import ConfigError
from resync_robot.core.joints import ARM_JOINTS
from resync_robot.core.ranges import RANGES, Range, require

if TYPE_CHECKING:
    from resync_robot.core.rig import CameraRig, ControllerRig, Rig

STROKE_SPARE = 1.1
"""Share of a gripper's stroke up to which an opening may be measured; no two units agree."""
FLANGE_REACH = 0.5
"""m from the flange within which something mounted on it is."""


def check_rig(rig: Rig, where: str) -> None:
    """Raises ConfigError where fields that are plausible by themselves do not fit together.

    Args:
        where: the file, for a message.
    """
    _check_arm(rig, where)
    _check_gripper(rig, where)
    _check_cameras(rig.cameras, rig.controller, where)
    if rig.controller is not None:
        _check_workspace(rig, rig.controller, where)


def _check_arm(rig: Rig, where: str) -> None:
    model = rig.arm.facts
    for joint, limit, speed in zip(range(6), model.kinematics.limit, model.speed, strict=True):
        of = f"of the {model.title}'s {ARM_JOINTS[joint]}"
        home, velocity = float(rig.arm.home[joint]), float(rig.arm.velocity_limit[joint])
        require(home, Range(-limit, limit, "rad"), f"{where}: [arm] home {of}")
        require(velocity, replace(RANGES["arm.velocity_limit"], high=speed), f"{where}: [arm] velocity_limit {of}")
    if rig.controller is not None:
        payload = replace(RANGES["controller.payload"], high=model.payload)
        require(rig.controller.payload, payload, f"{where}: [controller] payload of a {model.title}")


def _check_gripper(rig: Rig, where: str) -> None:
    model = rig.gripper.facts
    widest = STROKE_SPARE * model.stroke
    opening = replace(RANGES["gripper.max_opening"], high=widest)
    require(rig.gripper.max_opening, opening, f"{where}: [gripper] max_opening of a {model.title}")
    force = replace(RANGES["gripper.max_force"], high=model.force[1])
    require(rig.gripper.max_force, force, f"{where}: [gripper] max_force of a {model.title}")
    if rig.controller is not None:
        measured = replace(RANGES["controller.gripper_table"], high=widest)
        openings = rig.controller.gripper_table[:, 1]
        require(openings, measured, f"{where}: [controller] gripper_table of a {model.title}")


def _check_cameras(cameras: tuple[CameraRig, ...], controller: ControllerRig | None, where: str) -> None:
    _require_unique([c.name for c in cameras], f"{where}: [[cameras]] name")
    # Where nothing is looked up by it, a serial number may be left empty.
    _require_unique([c.serial for c in cameras if c.serial], f"{where}: [[cameras]] serial")
    real = controller is not None and not controller.emulated
    for i, camera in enumerate(cameras):
        title = f"{where}: [cameras.{i}]"
        if not camera.name:
            raise ConfigError(f"{title} name is empty", 'name it, such as name = "wrist"')
        if real and not camera.serial:
            raise ConfigError(
                f"{title} serial of '{camera.name}' is empty, and a real camera is found by it",
                "read it off the camera, or run: rs-enumerate-devices -s",
            )
        require(camera.cx, Range(0.0, camera.width, "px"), f"{title} cx of a picture {camera.width} px wide")
        require(camera.cy, Range(0.0, camera.height, "px"), f"{title} cy of a picture {camera.height} px high")
        if camera.mount == "flange":
            require(camera.pose[:3, 3], Range(-FLANGE_REACH, FLANGE_REACH, "m"), f"{title} pose on the flange")


def _check_workspace(rig: Rig, controller: ControllerRig, where: str) -> None:
    low, high = controller.workspace_low, controller.workspace_high
    for axis in range(3):
        if not low[axis] < high[axis]:
            raise ConfigError(
                f"{where}: [controller] workspace_low is {low[axis]:g} m along {'xyz'[axis]}, and workspace_high "
                f"{high[axis]:g} m; allowed: low below high",
                "exchange the two",
            )
    tip = rig.tip_pose(rig.arm.home)[:3, 3]
    if np.any(tip < low) or np.any(tip > high):
        x, y, z = tip
        raise ConfigError(
            f"{where}: at [arm] home the tip is at ({x:.3f}, {y:.3f}, {z:.3f}) m, outside of [controller] "
            "workspace_low and workspace_high",
            "set home (rad), world_T_base (m) and the workspace (m, in the world) so that the arm starts inside",
        )


def _require_unique(names: Iterable[str], where: str) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ConfigError(f"{where} '{name}' is given twice", "every camera needs one of its own")
        seen.add(name)
