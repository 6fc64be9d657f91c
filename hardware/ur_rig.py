"""What the link's process has to know of a rig, as JSON: numbers for limits and workspace, nothing of cameras."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from resync_robot.core.rig import ArmRig, CameraRig, ControllerRig, GripperRig, Rig
from resync_robot.hardware.clearance import Obstacle
from resync_robot.hardware.workspace import Workspace

T = TypeVar("T")


def rig_to_json(rig: Rig) -> dict[str, Any]:
    """See `rig_from_json`."""
    return {
        "name": rig.name, "arm": _table(rig.arm), "gripper": _table(rig.gripper),
        "controller": None if rig.controller is None else _table(rig.controller),
        "cameras": [_table(camera) for camera in rig.cameras],
    }  # fmt: skip


def rig_from_json(data: dict[str, Any]) -> Rig:
    """A rig without what a camera's calibration and noise say."""
    return Rig(
        name=data["name"],
        provenance="",
        arm=_made(ArmRig, data["arm"]),
        gripper=_made(GripperRig, data["gripper"]),
        cameras=tuple(_made(CameraRig, table) for table in data["cameras"]),
        controller=None if data["controller"] is None else _made(ControllerRig, data["controller"]),
        hash="",
    )


def workspace_to_json(workspace: Workspace) -> dict[str, Any]:
    """See `workspace_from_json`."""
    return {
        "table_z": workspace.table_z,
        "margin": workspace.margin,
        "obstacles": [_table(o) for o in workspace.obstacles],
    }


def workspace_from_json(rig: Rig, data: dict[str, Any]) -> Workspace:
    """A workspace of that rig's arm like the one that `workspace_to_json` was given."""
    workspace = Workspace(rig, data["table_z"], data["margin"])
    workspace.keep_out(*(_made(Obstacle, table) for table in data["obstacles"]))
    return workspace


def _table(part: Any) -> dict[str, Any]:
    values = {f.name: getattr(part, f.name) for f in fields(part)}
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in values.items()
        if isinstance(value, np.ndarray | str | float | int)
    }


def _made(kind: type[T], table: dict[str, Any]) -> T:
    return kind(**{name: np.array(value) if isinstance(value, list) else value for name, value in table.items()})
