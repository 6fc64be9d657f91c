"""The facts of one machine: arm, gripper, cameras, limits, and where the numbers came from."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.calibration_record import CalibrationLimits, CalibrationRecord, read_limits, read_record
from resync_robot.core.errors import ConfigError, UnknownNameError
from resync_robot.core.files import read_text
from resync_robot.core.kinematics import Kinematics
from resync_robot.core.machines import ARMS, GRIPPERS, ArmModel, GripperModel
from resync_robot.core.ranges import RANGES, read_number
from resync_robot.core.rig_checks import check_rig
from resync_robot.core.rig_fields import read_field
from resync_robot.core.sensor_noise import SensorNoise, read_noise
from resync_robot.core.tables import check_names, shown


@dataclass(frozen=True, kw_only=True)
class ArmRig:
    """Attributes: `world_T_base` (4, 4); `home`, limits (6,) in rad, rad/s, rad/s^2, rad/s^3."""

    model: str
    world_T_base: np.ndarray
    home: np.ndarray
    velocity_limit: np.ndarray
    acceleration_limit: np.ndarray
    jerk_limit: np.ndarray

    @cached_property
    def facts(self) -> ArmModel:
        """What its maker says of the model."""
        return ARMS[self.model]

    @cached_property
    def kinematics(self) -> Kinematics:
        return self.facts.kinematics


@dataclass(frozen=True, kw_only=True)
class GripperRig:
    """Lengths in m, force in N. The closing axis is y of the flange, the tips lie along its z."""

    model: str
    tip_offset: float
    max_opening: float
    max_force: float
    finger_thickness: float
    finger_width: float

    @cached_property
    def facts(self) -> GripperModel:
        """What its maker says of the model."""
        return GRIPPERS[self.model]

    @cached_property
    def flange_T_tip(self) -> np.ndarray:
        pose = spatial.transform(None, np.array([0.0, 0.0, self.tip_offset]))
        pose.flags.writeable = False
        return pose


@dataclass(frozen=True, kw_only=True)
class CameraRig:
    """Attributes: `pose` (4, 4) of the camera in its mount ('flange' or 'world'), OpenCV axes; pixels; sigmas.

    `calibration` is None where the pose is a design value. `noise` is how bad the camera is, which simulation imitates.
    """

    name: str
    mount: str
    serial: str
    pose: np.ndarray
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    position_sigma: float
    rotation_sigma: float
    calibration: CalibrationRecord | None = None
    noise: SensorNoise = SensorNoise()

    @property
    def intrinsics(self) -> np.ndarray:
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])


@dataclass(frozen=True, kw_only=True)
class ControllerRig:
    """How to talk to the arm's controller and its gripper; only a rig with a real or emulated machine has this.

    Attributes:
        address: IPv4 address of the controller; the gripper's socket is on the same one.
        payload: kg of gripper and cameras; `payload_centre` (3,) m in the frame of the flange.
        lead: s of setpoints that are queued ahead; more bears a busier computer, and adds as much delay.
        freshness: s after which a state of the robot is too old to move by.
        watchdog: Hz at which the controller must hear from us, or it stops by itself.
        gripper_table: (n, 2) position counts, rising, and openings in m, falling.
        gripper_force: 0 to 1 of what the gripper can do.
        force_limit: N at the tip above which no motion is sent.
        workspace_low, workspace_high: (3,) m in the world; where the tip may be.
        full_speed: a person has watched a whole slow run at this machine; before, the tip keeps to 250 mm/s.
        emulated: an emulator stands behind the address, which also lays out scenes and gives pictures.
    """

    address: str
    payload: float
    payload_centre: np.ndarray
    lead: float
    freshness: float
    watchdog: float
    gripper_table: np.ndarray
    gripper_force: float
    force_limit: float
    workspace_low: np.ndarray
    workspace_high: np.ndarray
    full_speed: bool
    emulated: bool


@dataclass(frozen=True, kw_only=True)
class Sam3Rig:
    """The `[sam3]` table: where its weights and vocabulary lie, and what to ask for, by the name of a block."""

    checkpoint: Path
    vocabulary: Path
    prompts: Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class Rig:
    """Everything above, read from one TOML file; `hash` names that content in libraries and recordings.

    `hues`: colours of the lab's own blocks by name, in [0, 1); empty where they are those of the catalogue.
    `where`: the file as a message names it.
    """

    name: str
    provenance: str
    arm: ArmRig
    gripper: GripperRig
    cameras: tuple[CameraRig, ...]
    hash: str
    calibration_limits: CalibrationLimits = CalibrationLimits()
    controller: ControllerRig | None = None
    hues: Mapping[str, float] = field(default_factory=dict)
    sam3: Sam3Rig | None = None
    where: str = field(default="the rig", compare=False)

    def tip_pose(self, q: Float[np.ndarray, "*b 6"]) -> Float[np.ndarray, "*b 4 4"]:
        """world_T_tip at (..., 6) joint positions in rad."""
        return self.arm.world_T_base @ self.arm.kinematics.forward(q) @ self.gripper.flange_T_tip

    def tip_jacobian(self, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6 6"]:
        """Linear over angular velocity of the tip in the world (m/s, rad/s), per rad/s of each joint."""
        base, tip = self.arm.world_T_base, self.tip_pose(q)[:3, 3]
        axes, points = self.arm.kinematics.joint_axes(q)
        (ax, ay, az), (x, y, z) = base[:3, :3] @ axes.T, (tip - base[:3, 3])[:, None] - base[:3, :3] @ points.T
        # Written out: `np.cross` takes a tenth of a millisecond for six products.
        return np.array([ay * z - az * y, az * x - ax * z, ax * y - ay * x, ax, ay, az], order="F")

    def robot_features(self, q: Float[np.ndarray, "6"], opening: float) -> Float[np.ndarray, "8"]:
        """The robot's features in a state: pose of the tip in the world, and the opening in m."""
        return np.concatenate([spatial.features_from_pose(self.tip_pose(q)), [opening]])

    def camera_pose(self, camera: CameraRig, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "4 4"]:
        """world_T_cam of a camera of this rig, on the flange or in the world, at (6,) joint positions in rad."""
        if camera.mount == "world":
            return camera.pose
        return self.arm.world_T_base @ self.arm.kinematics.forward(q) @ camera.pose

    def camera(self, name: str) -> CameraRig:
        for camera in self.cameras:
            if camera.name == name:
                return camera
        raise UnknownNameError("camera", name, [c.name for c in self.cameras], self.where)


def load_rig(path: Path | None = None) -> Rig:
    """Read a rig file; without a path, the rig that the simulation assumes.

    It is UTF-8, with or without a byte order mark. Neither that nor another system's line ends change its hash.

    Raises:
        ConfigError: the file is missing, is no TOML, or has a missing, extra, mistyped or implausible field.
    """
    if path is None:
        text, where = files("resync_robot.core").joinpath("simulated_rig.toml").read_text("utf-8"), "the built-in rig"
    else:
        where = str(path)
        try:
            text = read_text(path)
        except OSError as error:
            raise ConfigError(f"cannot read the rig file {path}: {error}", "give --rig FILE.toml") from None
        except UnicodeDecodeError as error:
            raise ConfigError(f"cannot read the rig file {path}: {error}", "save it as UTF-8") from None
    try:
        data = tomllib.loads(text)
    except ValueError as error:
        # Also an integer of thousands of digits, which the parser does not take for its own error.
        raise ConfigError(f"{where} is no valid TOML: {error}") from None

    def section(table: Any, kind: type, title: str, besides: tuple[str, ...] = (), name: str = "") -> dict[str, Any]:
        """The fields of the dataclass `kind`, but for those that are read elsewhere; `name` of one that is a list."""
        if table is None:
            raise ConfigError(f"{where}: [{title}] is missing")
        check_names(table, kind, f"{where}: [{title}]", whole=True, besides=besides)
        return {
            f.name: read_field(table[f.name], f"{name or title}.{f.name}", f"{where}: [{title}] {f.name}")
            for f in fields(kind)
            if f.name in table
        }

    def camera(table: Any, title: str) -> CameraRig:
        record, noise = None, SensorNoise()
        if isinstance(table, Mapping):
            if "calibration" in table:
                record = read_record(table["calibration"], f"{where}: [{title}.calibration]")
            noise = read_noise(table.get("noise", {}), f"{where}: [{title}.noise]")
            table = {k: v for k, v in table.items() if k not in ("calibration", "noise")}
        own = section(table, CameraRig, title, ("calibration", "noise"), "cameras")
        return CameraRig(**own, calibration=record, noise=noise)

    def sam3(table: Any) -> Sam3Rig:
        prompts = table.get("prompts") if isinstance(table, Mapping) else None
        if not isinstance(prompts, Mapping) or not prompts or not all(isinstance(p, str) for p in prompts.values()):
            raise ConfigError(f"{where}: [sam3.prompts] must name what to ask for", 'write it as: b0 = "red block"')
        paths = section({k: v for k, v in table.items() if k != "prompts"}, Sam3Rig, "sam3", ("prompts",))
        return Sam3Rig(prompts=dict(prompts), **{name: Path(value) for name, value in paths.items()})

    def hues(table: Any) -> Mapping[str, float]:
        if not isinstance(table, Mapping):
            raise ConfigError(f"{where}: [hues] must be a table, not {shown(table)}", "write it as: b0 = 0.0")
        for name, value in table.items():
            if read_number(value, RANGES["hues"], f"{where}: [hues] {name}") == 1:
                raise ConfigError(f"{where}: [hues] {name} is 1", "a hue is from 0 up to, not including, 1")
        return {name: float(value) for name, value in table.items()}

    tables = ("arm", "gripper", "cameras", "calibration_limits", "controller", "hues", "sam3")
    top = section({k: v for k, v in data.items() if k not in tables}, Rig, "", (*tables, "hash", "where"))
    cameras = data.get("cameras")
    if not isinstance(cameras, list) or not cameras:
        raise ConfigError(f"{where}: no [[cameras]]")
    rig = Rig(
        name=top["name"],
        provenance=top["provenance"],
        arm=ArmRig(**section(data.get("arm"), ArmRig, "arm")),
        gripper=GripperRig(**section(data.get("gripper"), GripperRig, "gripper")),
        cameras=tuple(camera(table, f"cameras.{i}") for i, table in enumerate(cameras)),
        hash=hashlib.sha256(text.encode()).hexdigest()[:16],
        calibration_limits=read_limits(data.get("calibration_limits", {}), f"{where}: [calibration_limits]"),
        controller=(
            ControllerRig(**section(data["controller"], ControllerRig, "controller")) if "controller" in data else None
        ),
        hues=hues(data.get("hues", {})),
        sam3=sam3(data["sam3"]) if "sam3" in data else None,
        where=where if path is None else f"the rig file {path}",
    )
    check_rig(rig, where)
    return rig
