"""What a recording of an episode consists of, each with its time in s from the beginning of the episode."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime, timedelta
from enum import Enum
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from resync_robot.core.joints import ARM_JOINTS, JointTarget
from resync_robot.core.rig import Rig

SCENE_VIEW = "scene"
"""The camera by whose name a simulator's own pictures are recorded."""
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
FRAMES = {
    "world": "z up, origin on the table; world_T_base in the rig places the arm",
    "base": "Denavit-Hartenberg base of the arm",
    "flange": "last DH frame, tool0 in ROS; the gripper closes along its y, the tips lie along its z",
    "cam": "OpenCV axes: x right, y down, z forward; camera_NAME_optical_frame in ROS",
    "quaternions": "w x y z",
    "joints": list(ARM_JOINTS),
}


class EventKind(Enum):
    """What may happen in an episode."""

    SCAN = "scan"
    DOUBT = "doubt"
    """Atoms that further looks did not decide, with the share of pose samples in which each holds."""
    SKILL_START = "skill start"
    SKILL_END = "skill end"
    REPLAN = "replan"
    GIVE_UP = "give up"
    GOAL = "goal"
    PLANNED = "planned"
    """The end of a dry run that found a plan."""
    STOP = "stop"
    """The robot stopped by itself, or somebody declined a step or ended the program."""
    HALTED = "halted"
    """Of a real robot at the end: its controller says that the program has ended."""
    MAY_MOVE = "may move"
    """In place of HALTED: nobody knows whether it has."""


class Ask(Enum):
    """What an executive asks of the world. The value says it for people."""

    MEASURE = "measures the arm"
    PICTURE = "takes a picture"
    PART = "looks at a part of a picture"
    TRUTH = "asks where everything really is"
    THOUGHT = "asks whether a policy has thought to its end"
    REST = "lets the arm come to rest"
    STOP = "is stopped by the robot"


@dataclass(frozen=True)
class Answer:
    """What an executive was told.

    Attributes:
        clock: s on the robot's clock, of what is told.
        target: what the arm was being sent to; with REST, where it rests.
        details: plain JSON. MEASURE: arm, velocity, force, opening; PICTURE and PART: camera; TRUTH: objects; THOUGHT:
            done; STOP: reason.
    """

    ask: Ask
    clock: float
    target: JointTarget
    details: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class EpisodeMeta:
    """What a recording needs to be understood on its own.

    Attributes:
        rig: the rig file's content as plain JSON, see `EpisodeMeta.of`; empty for a domain with a robot of its own.
        library_hash: content hash of the library used, '' without one.
        goal: text of the goal's atoms.
        versions: package or program -> version.
        frames: frame name -> its definition.
        began: date and time of the beginning in UTC, as ISO 8601 has it; the epoch where nobody told.
        objects: name -> type, in the order in which the task has them.
        types: name -> `Type.to_json`, of all types of the domain.
        settings: of the deployment, by the names of `DeployConfig`: those that change what is asked of the world.
        model: what was planned with: `pddl`, the text of a domain, and `learned`, the names of predicates and skills in
            it that were not given; empty where nobody told.
    """

    rig_hash: str
    rig: Mapping[str, Any]
    library_hash: str
    domain: str
    scenario: str
    goal: str
    seed: int
    backend: str
    versions: Mapping[str, str] = field(default_factory=dict)
    frames: Mapping[str, Any] = field(default_factory=lambda: dict(FRAMES))
    began: str = EPOCH.isoformat()
    objects: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    types: Mapping[str, Any] = field(default_factory=dict)
    model: Mapping[str, Any] = field(default_factory=dict)

    @property
    def began_ns(self) -> int:
        """ns since the epoch. Raises ValueError or TypeError where `began` is no date with its time zone."""
        return (datetime.fromisoformat(self.began) - EPOCH) // timedelta(microseconds=1) * 1000

    @staticmethod
    def of(rig: Rig, **others: Any) -> EpisodeMeta:
        """The meta data with the rig's part filled in; `others` are the remaining fields."""
        # Where its file lies says nothing about the machine.
        facts = {name: value for name, value in asdict(rig).items() if name != "where"}
        return EpisodeMeta(rig_hash=rig.hash, rig=plain(facts), **others)


@dataclass(frozen=True)
class Joints:
    """Attributes: `measured` (6,) rad, `velocity` (6,) rad/s, `opening` m; the setpoint `sent` and the `requested`."""

    time: float
    measured: Float[np.ndarray, "6"]
    velocity: Float[np.ndarray, "6"]
    opening: float
    sent: JointTarget
    requested: JointTarget


@dataclass(frozen=True)
class Plan:
    """Attributes: `steps` as text, `current` index of the one under way (None: not begun), `reason` for planning."""

    time: float
    steps: tuple[str, ...]
    current: int | None
    reason: str


@dataclass(frozen=True)
class Event:
    """Attributes: `text` for people, `details` plain JSON for programs."""

    time: float
    kind: EventKind
    text: str
    details: Mapping[str, Any]


@dataclass(frozen=True)
class Timing:
    """Of one target, s: written on the robot's clock, read as seconds of the episode.

    Attributes:
        picture: when the oldest picture was exposed that was looked at since the target before; None where there was
            none. A policy that thinks beside the motion decides on it one decision later.
        asked: when it was handed to the stream; `due`: when its first setpoint was to be sent.
        computed: s of computing in between.
    """

    picture: float | None
    asked: float
    due: float
    computed: float


@dataclass(frozen=True)
class Picture:
    """An encoded RGB-D picture. `colour` (PNG; JPEG in older files) and `depth` (16-bit PNG, 1e-4 m) are None where the
    file is torn."""

    time: float
    camera: str
    intrinsics: Float[np.ndarray, "3 3"]
    world_T_cam: Float[np.ndarray, "4 4"]
    width: int
    height: int
    colour: bytes | None
    depth: bytes | None


@dataclass(frozen=True)
class Points:
    """Attributes: `xyz` (n, 3) float32 m in the world, `rgb` (n, 3) uint8."""

    time: float
    xyz: Float[np.ndarray, "n 3"]
    rgb: UInt8[np.ndarray, "n 3"]


def plain(value: Any) -> Any:
    """JSON values only; arrays become lists, numbers that JSON has no word for (NaN, infinities) become null."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
