"""A rig as ROS 2 describes a robot: one tree of links with the names of UR's own description, from `world` on.

`base` and `tool0` are the frames that the rig file calls base and flange. Behind `tool0` come the gripper with two
fingers that slide, the `tip` between them, and the cameras on the flange; the others stand in the world.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.joints import ARM_JOINTS
from resync_robot.core.machines import ARMS, GRIPPERS, ArmModel

WORLD = "world"
FINGER_JOINTS = ("left_finger_joint", "right_finger_joint")
JOINTS = (*ARM_JOINTS, *FINGER_JOINTS)
"""All that move."""
ARM_LINKS = ("shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link")
PALM = (0.075, 0.12, 0.1)
"""m; the gripper's body, from the flange on."""
CAMERA = (0.09, 0.025, 0.025)
"""m; the body of a camera, behind its lens."""
_HALF, _QUARTER = np.pi, np.pi / 2

Part = tuple[Sequence[float], str, Sequence[float], str]
"""Of what a link looks like: middle in m, axis of a cylinder or '' for a box, its radius and length or its extents, in
m, and the name of a colour."""
Pose = tuple[str, str, np.ndarray]
"""Parent, child, (4, 4) pose of child in parent."""


def camera_frame(name: str) -> str:
    """The link that a camera's pictures are seen from: x right, y down, z forward."""
    return f"camera_{name}_optical_frame"


@dataclass(frozen=True)
class Joint:
    """Attributes: `origin` (4, 4) pose of the child in the parent at 0; `axis` in the child, None where it is fixed.

    `least`, `most` in rad or m; `effort` in N m or N; `speed` in rad/s or m/s.
    """

    name: str
    parent: str
    child: str
    origin: Float[np.ndarray, "4 4"]
    axis: tuple[float, float, float] | None = None
    least: float = 0.0
    most: float = 0.0
    effort: float = 0.0
    speed: float = 0.0

    @property
    def kind(self) -> str:
        return "fixed" if self.axis is None else "prismatic" if self.name in FINGER_JOINTS else "revolute"

    def at(self, position: float) -> Float[np.ndarray, "4 4"]:
        """Pose of the child in the parent, at a position in rad or m."""
        if self.kind == "revolute":
            return self.origin @ spatial.transform(spatial.rotation_about("z", position))
        return self.origin @ spatial.transform(None, np.array(self.axis or np.zeros(3)) * position)


class RobotDescription:
    """The links and joints of one rig.

    Args:
        rig: its content as plain JSON, as a recording has it.

    Raises:
        KeyError, TypeError, ValueError: it is no such content.
    """

    def __init__(self, rig: Mapping[str, Any]) -> None:
        arm, self._gripper = rig["arm"], rig["gripper"]
        self._arm = ARMS[arm["model"]]
        self._name = f"{arm['model']}_{self._gripper['model']}"
        self._cameras = [(c["name"], c["mount"], np.array(c["pose"], dtype=float)) for c in rig["cameras"]]
        joints = (*_arm_joints(self._arm, np.array(arm["world_T_base"], dtype=float)), *self._hand_joints())
        self.joints: tuple[Joint, ...] = joints
        """From the world on; each link's own before those that hang on it."""
        self._moving = {joint.name: joint for joint in self.joints if joint.kind != "fixed"}

    @property
    def fixed(self) -> list[Pose]:
        return [(j.parent, j.child, j.origin) for j in self.joints if j.kind == "fixed"]

    def moving(self, positions: Float[np.ndarray, "8"]) -> list[Pose]:
        """Where the links are that move; one whose joint's position nobody knows is left out."""
        placed = [(self._moving[name], p) for name, p in zip(JOINTS, positions, strict=True) if np.isfinite(p)]
        return [(joint.parent, joint.child, joint.at(p)) for joint, p in placed]

    @property
    def urdf(self) -> str:
        """The whole of it, drawn with boxes and cylinders."""
        looks = self._looks()
        links = (WORLD, *(joint.child for joint in self.joints))
        lines = [
            '<?xml version="1.0"?>', f"<robot name={quoteattr(self._name)}>",
            *(f'  <material name="{n}"><color rgba="{rgba}"/></material>' for n, rgba in _COLOURS.items()),
            *(_link_text(link, looks.get(link, ())) for link in links), *map(_joint_text, self.joints), "</robot>", "",
        ]  # fmt: skip
        return "\n".join(lines)

    def _hand_joints(self) -> list[Joint]:
        tip = spatial.transform(None, np.array([0.0, 0.0, float(self._gripper["tip_offset"])]))
        most, force = float(self._gripper["max_opening"]) / 2, float(self._gripper["max_force"])
        speed = GRIPPERS[self._gripper["model"]].speed[1] / 2
        fingers = [
            Joint(name, "gripper_base_link", name.removesuffix("_joint"), tip, (0, side, 0), 0.0, most, force, speed)
            for name, side in zip(FINGER_JOINTS, (1.0, -1.0), strict=True)
        ]
        return [
            Joint("gripper_base_joint", "tool0", "gripper_base_link", np.eye(4)),
            Joint("tip_joint", "gripper_base_link", "tip", tip),
            *fingers,
            *(
                Joint(f"camera_{name}_joint", "tool0" if mount == "flange" else WORLD, camera_frame(name), pose)
                for name, mount, pose in self._cameras
            ),
        ]

    def _looks(self) -> dict[str, list[Part]]:
        """What each link looks like. The cylinders are as thick as `Shape` says; it measures from the joints' axes."""
        (d1, _, _, d4, d5, d6), (_, a2, a3, _, _, _) = self._arm.kinematics.d, self._arm.kinematics.a
        base, shoulder, upper, elbow, fore, wrist_1, wrist_2, wrist_3 = self._arm.shape.radii
        out, along = self._arm.shape.shoulder, self._arm.shape.elbow
        thick, wide = float(self._gripper["finger_thickness"]), float(self._gripper["finger_width"])
        length = max(float(self._gripper["tip_offset"]) - PALM[2], 0.01)
        return {
            "base_link_inertia": [((0, 0, d1 / 4), "z", (base, d1 / 2), "steel")],
            "shoulder_link": [((0, 0, -d1 / 8), "z", (shoulder, d1 * 0.75), "steel")],
            "upper_arm_link": [
                ((0, 0, out / 2), "z", (upper, out + upper), "cap"),
                ((a2 / 2, 0, out), "x", (upper * 0.8, -a2), "steel"),
                ((a2, 0, (out + along) / 2), "z", (elbow, out - along + elbow), "cap"),
            ],
            "forearm_link": [
                ((a3 / 2, 0, along), "x", (fore, -a3), "steel"),
                ((a3, 0, (along + d4) / 2), "z", (wrist_1, d4 - along), "steel"),
            ],
            "wrist_1_link": [((0, 0, 0), "z", (wrist_1, 2 * wrist_1), "cap")],
            "wrist_2_link": [((0, 0, -d5 / 2), "z", (wrist_2, d5), "steel"), ((0, 0, 0), "z", (wrist_2, 0.09), "cap")],
            "wrist_3_link": [((0, 0, -d6 / 2), "z", (wrist_3, d6), "steel")],
            "gripper_base_link": [((0, 0, PALM[2] / 2), "", PALM, "dark")],
            "left_finger": [((0, thick / 2, -length / 2), "", (wide, thick, length), "dark")],
            "right_finger": [((0, -thick / 2, -length / 2), "", (wide, thick, length), "dark")],
            **{camera_frame(name): [((0, 0, -CAMERA[2] / 2), "", CAMERA, "dark")] for name, _, _ in self._cameras},
        }


_COLOURS = {"steel": "0.72 0.74 0.76 1", "cap": "0.25 0.45 0.65 1", "dark": "0.15 0.15 0.17 1"}


def _arm_joints(arm: ArmModel, world_T_base: np.ndarray) -> list[Joint]:
    """As UR's description has them. It sets the base link the other way round than the controller does."""
    (d1, _, _, d4, d5, d6), (_, a2, a3, _, _, _) = arm.kinematics.d, arm.kinematics.a
    turned = _origin(yaw=_HALF)
    origins = (
        _origin(0, 0, d1), _origin(roll=_QUARTER), _origin(a2), _origin(a3, 0, d4), _origin(0, -d5, 0, _QUARTER),
        _origin(0, d6, 0, _QUARTER, _HALF, _HALF),
    )  # fmt: skip
    rows = zip(ARM_JOINTS, ARM_LINKS, origins, arm.kinematics.limit, arm.torque, arm.speed, strict=True)
    moving, parent = [], "base_link_inertia"
    for name, link, origin, limit, torque, speed in rows:
        moving.append(Joint(name, parent, link, origin, (0.0, 0.0, 1.0), -limit, limit, torque, speed))
        parent = link
    return [
        Joint("base_link_joint", WORLD, "base_link", world_T_base @ turned),
        Joint("base_link-base_fixed_joint", "base_link", "base", turned),
        Joint("base_link-base_link_inertia", "base_link", "base_link_inertia", turned),
        *moving,
        Joint("wrist_3-flange", "wrist_3_link", "flange", _origin(pitch=-_QUARTER, yaw=-_QUARTER)),
        Joint("flange-tool0", "flange", "tool0", _origin(roll=_QUARTER, yaw=_QUARTER)),
    ]


def _origin(
    x: float = 0.0, y: float = 0.0, z: float = 0.0, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0
) -> Float[np.ndarray, "4 4"]:
    turns = zip("zyx", (yaw, pitch, roll), strict=True)
    about_z, about_y, about_x = (spatial.rotation_about(axis, angle) for axis, angle in turns)
    return spatial.transform(about_z @ about_y @ about_x, np.array([x, y, z]))


def _angles(rotation: np.ndarray) -> tuple[float, float, float]:
    """Roll, pitch and yaw, rad, of a (3, 3) rotation."""
    flat = float(np.hypot(rotation[0, 0], rotation[1, 0]))
    pitch = float(np.arctan2(-rotation[2, 0], flat))
    if flat < 1e-9:
        # Straight up or down, only roll and yaw together can be told.
        return 0.0, pitch, float(np.arctan2(-rotation[0, 1], rotation[1, 1]))
    return (
        float(np.arctan2(rotation[2, 1], rotation[2, 2])),
        pitch,
        float(np.arctan2(rotation[1, 0], rotation[0, 0])),
    )


def _numbers(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{value + 0.0:.12g}" for value in values)


def _joint_text(joint: Joint) -> str:
    place = f'<origin xyz="{_numbers(joint.origin[:3, 3])}" rpy="{_numbers(_angles(joint.origin[:3, :3]))}"/>'
    ends = f"<parent link={quoteattr(joint.parent)}/><child link={quoteattr(joint.child)}/>"
    move = ""
    if joint.axis is not None:
        bounds = {"lower": joint.least, "upper": joint.most, "effort": joint.effort, "velocity": joint.speed}
        limit = " ".join(f'{name}="{_numbers([value])}"' for name, value in bounds.items())
        move = f'<axis xyz="{_numbers(joint.axis)}"/><limit {limit}/>'
    return f'  <joint name={quoteattr(joint.name)} type="{joint.kind}">{ends}{place}{move}</joint>'


def _link_text(name: str, parts: Sequence[Part]) -> str:
    visuals = []
    for middle, axis, sizes, colour in parts:
        turn = (0, _QUARTER, 0) if axis == "x" else (0, 0, 0)
        if axis:
            form = f'<cylinder radius="{_numbers(sizes[:1])}" length="{_numbers(sizes[1:])}"/>'
        else:
            form = f'<box size="{_numbers(sizes)}"/>'
        visuals.append(
            f'<visual><origin xyz="{_numbers(middle)}" rpy="{_numbers(turn)}"/><geometry>{form}</geometry>'
            f'<material name="{colour}"/></visual>'
        )
    return f"  <link name={quoteattr(name)}>{''.join(visuals)}</link>"
