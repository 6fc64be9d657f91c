"""The facts of one machine: arm, gripper, cameras, limits, and where the numbers came from."""

from __future__ import annotations

import hashlib
import ipaddress
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from resync_robot.core import kinematics, spatial
from resync_robot.core.calibration_record import CalibrationLimits, CalibrationRecord, read_limits, read_record
from resync_robot.core.errors import ConfigError, UnknownNameError
from resync_robot.core.files import read_text
from resync_robot.core.sensor_noise import SensorNoise, read_noise
from resync_robot.core.tables import check_names, check_number, finite, shown


@dataclass(frozen=True, kw_only=True)
class ArmRig:
    """Attributes: `world_T_base` (4, 4); `home`, limits (6,) in rad, rad/s, rad/s^2, rad/s^3."""

    model: str
    world_T_base: np.ndarray
    home: np.ndarray
    velocity_limit: np.ndarray
    acceleration_limit: np.ndarray
    jerk_limit: np.ndarray


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

    def tip_pose(self, q: Float[np.ndarray, "*b 6"]) -> Float[np.ndarray, "*b 4 4"]:
        """world_T_tip at (..., 6) joint positions in rad."""
        return self.arm.world_T_base @ kinematics.forward(q) @ self.gripper.flange_T_tip

    def tip_jacobian(self, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6 6"]:
        """Linear over angular velocity of the tip in the world (m/s, rad/s), per rad/s of each joint."""
        frames = self.arm.world_T_base @ kinematics.link_frames(q)
        tip = (frames[-1] @ self.gripper.flange_T_tip)[:3, 3]
        before = np.concatenate([self.arm.world_T_base[None], frames[:-1]])
        (ax, ay, az), (x, y, z) = before[:, :3, 2].T, (tip - before[:, :3, 3]).T
        # Written out: `np.cross` takes a tenth of a millisecond for six products.
        return np.array([ay * z - az * y, az * x - ax * z, ax * y - ay * x, ax, ay, az], order="F")

    def robot_features(self, q: Float[np.ndarray, "6"], opening: float) -> Float[np.ndarray, "8"]:
        """The robot's features in a state: pose of the tip in the world, and the opening in m."""
        return np.concatenate([spatial.features_from_pose(self.tip_pose(q)), [opening]])

    def camera_pose(self, camera: CameraRig, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "4 4"]:
        """world_T_cam of a camera of this rig, on the flange or in the world, at (6,) joint positions in rad."""
        if camera.mount == "world":
            return camera.pose
        return self.arm.world_T_base @ kinematics.forward(q) @ camera.pose

    def camera(self, name: str) -> CameraRig:
        for camera in self.cameras:
            if camera.name == name:
                return camera
        raise UnknownNameError("camera", name, [c.name for c in self.cameras])


_VECTORS = {
    "payload_centre": 3,
    "workspace_low": 3,
    "workspace_high": 3,
    "world_T_base": 7,
    "pose": 7,
    "home": 6,
    "velocity_limit": 6,
    "acceleration_limit": 6,
    "jerk_limit": 6,
}
_TEXT = ("address", "checkpoint", "vocabulary", "model", "name", "mount", "serial", "provenance")


# What the UR7e's data sheet and the driver allow: kg, s, s, Hz, N.
_RANGES = {
    "payload": (0.0, 7.5),
    "lead": (0.004, 0.2),
    "freshness": (0.02, 0.5),
    "watchdog": (2.0, 100.0),
    "gripper_force": (0.0, 1.0),
    "force_limit": (10.0, 500.0),
}


def load_rig(path: Path | None = None) -> Rig:
    """Read a rig file; without a path, the rig that the simulation assumes.

    It is UTF-8, with or without a byte order mark. Neither that nor another system's line ends change its hash.

    Raises:
        ConfigError: the file is missing, is no TOML, or has a missing, extra or mistyped field.
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

    def section(table: Any, kind: type, title: str, besides: tuple[str, ...] = ()) -> dict[str, Any]:
        """The fields of the dataclass `kind`, but for those that are read elsewhere."""
        if table is None:
            raise ConfigError(f"{where}: [{title}] is missing")
        check_names(table, kind, f"{where}: [{title}]", whole=True, besides=besides)
        return {
            f.name: _field(table[f.name], f.name, f"{where}: [{title}] {f.name}")
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
        return CameraRig(**section(table, CameraRig, title, ("calibration", "noise")), calibration=record, noise=noise)

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
            check_number(value, f"{where}: [hues] {name}")
            if value >= 1:
                raise ConfigError(f"{where}: [hues] {name} is {value:g}", "a hue is from 0 up to, not including, 1")
        return {name: float(value) for name, value in table.items()}

    tables = ("arm", "gripper", "cameras", "calibration_limits", "controller", "hues", "sam3")
    top = section({k: v for k, v in data.items() if k not in tables}, Rig, "", (*tables, "hash"))
    cameras = data.get("cameras")
    if not isinstance(cameras, list) or not cameras:
        raise ConfigError(f"{where}: no [[cameras]]")
    return Rig(
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
    )


def _field(value: Any, name: str, where: str) -> Any:
    if name in _TEXT:
        if not isinstance(value, str):
            raise ConfigError(f"{where} must be text, not {shown(value)}")
        if name == "address":
            try:
                return str(ipaddress.IPv4Address(value))
            except ValueError:
                raise ConfigError(f"{where} is '{value}'", "give an IPv4 address such as 192.168.1.10") from None
        if name == "mount" and value not in ("flange", "world"):
            raise ConfigError(f"{where} is '{value}'", "allowed: flange, world")
        return value
    if name in _VECTORS:
        numbers = isinstance(value, list) and all(finite(v) is not None for v in value)
        if not numbers or len(value) != _VECTORS[name]:
            raise ConfigError(f"{where} must be {_VECTORS[name]} numbers, not {shown(value)}")
        vector = np.asarray(value, dtype=np.float64)
        if _VECTORS[name] == 7:
            norm = float(np.linalg.norm(vector[3:]))
            if abs(norm - 1.0) > 1e-3:
                raise ConfigError(f"{where}: the quaternion has norm {norm:.3f}, it must be 1 (w x y z)")
            return spatial.pose_from_features(vector)
        if name.endswith("_limit") and np.any(vector <= 0):
            raise ConfigError(f"{where} must be positive")
        return vector
    if name == "gripper_table":
        return _gripper_table(value, where)
    if name in ("full_speed", "emulated"):
        if not isinstance(value, bool):
            raise ConfigError(f"{where} must be true or false, not {shown(value)}")
        return value
    number = finite(value)
    if number is None:
        raise ConfigError(f"{where} must be a number, not {shown(value)}")
    if name in ("width", "height"):
        if not number.is_integer() or number <= 0:
            raise ConfigError(f"{where} must be a positive number of pixels, not {value!r}")
        return int(number)
    if number < 0:
        raise ConfigError(f"{where} must not be negative")
    if name in _RANGES and not _RANGES[name][0] <= number <= _RANGES[name][1]:
        raise ConfigError(f"{where} is {value}", f"allowed: {_RANGES[name][0]} to {_RANGES[name][1]}")
    return number


def _gripper_table(value: Any, where: str) -> Float[np.ndarray, "n 2"]:
    try:
        table = np.array(value, dtype=np.float64).reshape(-1, 2)
    except (OverflowError, TypeError, ValueError):
        table = np.empty((0, 2))
    counts, openings = table[:, 0], table[:, 1]
    rising, falling = bool(np.all(np.diff(counts) > 0)), bool(np.all(np.diff(openings) < 0))
    if len(table) < 2 or not (rising and falling and counts[0] >= 0 and counts[-1] <= 255 and openings[-1] >= 0):
        raise ConfigError(
            f"{where} must be pairs of counts that rise to 255 at most and openings in m that fall, not {shown(value)}",
            "measure them: gripper_table = [[3, 0.14], [230, 0.0]]",
        )
    return table
