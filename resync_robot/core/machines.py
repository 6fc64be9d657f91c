"""What the makers say of the arms and grippers that a rig may have: facts, not settings.

Lengths, masses and torques are those of the manufacturer's own tables (DH parameters, maximal joint torques, data
sheets). The UR7e is a UR5e and the UR12e a UR10e that may carry more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from resync_robot.core.kinematics import Kinematics

SLOW, FAST, FASTEST = (float(np.radians(degrees)) for degrees in (120, 180, 360))
"""rad/s of a joint, by its size."""


@dataclass(frozen=True, kw_only=True)
class Shape:
    """How thick the arm is, for distances between its parts.

    Attributes:
        shoulder, elbow: m along the axes of these joints from the arm's plane to the middle of upper arm and forearm.
        radii: (8,) m of base, shoulder, upper arm, elbow, forearm and the three wrists; a little more than the real
            ones. Those of the UR5e are measured; the others follow from footprints and from the sizes of the joints.
    """

    shoulder: float
    elbow: float
    radii: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class ArmModel:
    """Attributes: `title` as its maker writes it, `polyscope` as its controller does; SI units.

    `speed` (6,) rad/s and `torque` (6,) N m of each joint; `payload` kg; `reach` m from the base to the wrist;
    `links` (6,) kg of shoulder, upper arm, forearm and the three wrists.
    """

    title: str
    polyscope: str
    kinematics: Kinematics
    speed: tuple[float, ...]
    torque: tuple[float, ...]
    payload: float
    reach: float
    links: tuple[float, ...]
    shape: Shape


@dataclass(frozen=True, kw_only=True)
class GripperModel:
    """Attributes: `stroke` m between the pads; `force` N and `speed` m/s of opening, least and most."""

    title: str
    stroke: float
    force: tuple[float, float]
    speed: tuple[float, float]


_UR3E = Kinematics(d=(0.15185, 0.0, 0.0, 0.13105, 0.08535, 0.0921), a=(0.0, -0.24355, -0.2132, 0.0, 0.0, 0.0))
_UR5E = Kinematics(d=(0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996), a=(0.0, -0.425, -0.3922, 0.0, 0.0, 0.0))
_UR10E = Kinematics(d=(0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655), a=(0.0, -0.6127, -0.57155, 0.0, 0.0, 0.0))
_UR16E = Kinematics(d=_UR10E.d, a=(0.0, -0.4784, -0.36, 0.0, 0.0, 0.0))

_SMALL = Shape(shoulder=0.120, elbow=0.027, radii=(0.065, 0.060, 0.055, 0.055, 0.045, 0.042, 0.042, 0.040))
_MIDDLE = Shape(shoulder=0.138, elbow=0.007, radii=(0.075, 0.065, 0.060, 0.060, 0.050, 0.047, 0.047, 0.045))
_LARGE = Shape(shoulder=0.1762, elbow=0.0393, radii=(0.095, 0.085, 0.080, 0.075, 0.060, 0.055, 0.055, 0.050))

_UR5E_LINKS = (3.761, 8.058, 2.846, 1.37, 1.3, 0.365)
_UR10E_LINKS = (7.369, 13.051, 3.989, 2.1, 1.98, 0.615)
_UR5E_TORQUE = (150.0, 150.0, 150.0, 28.0, 28.0, 28.0)
_UR10E_TORQUE = (330.0, 330.0, 150.0, 54.0, 54.0, 54.0)
_UR10E_SPEED = (SLOW, SLOW, FAST, FAST, FAST, FAST)

ARMS: Mapping[str, ArmModel] = {
    "ur3e": ArmModel(
        title="UR3e", polyscope="UR3", kinematics=_UR3E, speed=(FAST, FAST, FAST, FASTEST, FASTEST, FASTEST),
        torque=(56.0, 56.0, 28.0, 12.0, 12.0, 12.0), payload=3.0, reach=0.5,
        links=(1.98, 3.4445, 1.437, 0.871, 0.805, 0.261), shape=_SMALL,
    ),
    "ur5e": ArmModel(
        title="UR5e", polyscope="UR5", kinematics=_UR5E, speed=(FAST,) * 6, torque=_UR5E_TORQUE, payload=5.0,
        reach=0.85, links=_UR5E_LINKS, shape=_MIDDLE,
    ),
    "ur7e": ArmModel(
        title="UR7e", polyscope="UR7", kinematics=_UR5E, speed=(FAST,) * 6, torque=_UR5E_TORQUE, payload=7.5,
        reach=0.85, links=_UR5E_LINKS, shape=_MIDDLE,
    ),
    "ur10e": ArmModel(
        title="UR10e", polyscope="UR10", kinematics=_UR10E, speed=_UR10E_SPEED, torque=_UR10E_TORQUE, payload=12.5,
        reach=1.3, links=_UR10E_LINKS, shape=_LARGE,
    ),
    "ur12e": ArmModel(
        title="UR12e", polyscope="UR12", kinematics=_UR10E, speed=_UR10E_SPEED, torque=_UR10E_TORQUE, payload=12.5,
        reach=1.3, links=_UR10E_LINKS, shape=_LARGE,
    ),
    "ur16e": ArmModel(
        title="UR16e", polyscope="UR16", kinematics=_UR16E, speed=_UR10E_SPEED, torque=_UR10E_TORQUE, payload=16.0,
        reach=0.9, links=(7.369, 10.45, 4.321, 2.18, 2.033, 0.907), shape=_LARGE,
    ),
}  # fmt: skip
GRIPPERS: Mapping[str, GripperModel] = {
    "2f-85": GripperModel(title="2F-85", stroke=0.085, force=(20.0, 235.0), speed=(0.020, 0.150)),
    "2f-140": GripperModel(title="2F-140", stroke=0.140, force=(10.0, 125.0), speed=(0.030, 0.250)),
}
