"""What an executive may ask of a world, real or simulated."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from resync_robot.core.state import State


@dataclass(frozen=True)
class CameraFrame:
    """One RGB-D picture, depth aligned to colour.

    Attributes:
        colour: (H, W, 3) uint8, RGB.
        depth: (H, W) uint16, millimetres / 10 (unit 1e-4 m), 0 = no measurement.
        intrinsics: (3, 3) camera matrix in pixels.
        world_T_cam: (4, 4) pose of the camera as the robot believes it, OpenCV axes (x right, y down, z forward).
        time: seconds on the robot's clock when it was exposed.
    """

    name: str
    colour: UInt8[np.ndarray, "h w 3"]
    depth: UInt16[np.ndarray, "h w"]
    intrinsics: Float[np.ndarray, "3 3"]
    world_T_cam: Float[np.ndarray, "4 4"]
    time: float

    DEPTH_UNIT_M = 1e-4


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of a camera's picture, in its pixels, counted from the upper left edge."""

    left: float
    top: float
    width: float
    height: float


@dataclass(frozen=True)
class Cutout:
    """A window of a picture, scaled to (size, size).

    Attributes:
        colour: (size, size, 3) uint8, RGB.
        time: seconds on the robot's clock when it was exposed.
    """

    name: str
    colour: UInt8[np.ndarray, "size size 3"]
    time: float


@dataclass(frozen=True)
class Glimpse:
    """What a camera sees by the way, for people.

    Attributes:
        colour: (H, W, 3) uint8, RGB.
        time: seconds on the robot's clock when it was exposed.
    """

    name: str
    colour: UInt8[np.ndarray, "h w 3"]
    time: float


Look = Callable[[str, Window, int], Cutout]
"""(camera, window, size) -> what that camera sees there now. Raises UnknownNameError or PerceptionError."""


Ready = Callable[[Future[Any]], bool]
"""Whether something that a skill thinks out beside the motion is finished. Where time stands still meanwhile, as in a
simulator, it always is: it is waited for."""


def awaited(thought: Future[Any]) -> bool:
    """`Ready` of a world whose time waits; whatever the thought raises is left to whoever wants its result."""
    thought.exception()
    return True


@dataclass(frozen=True, kw_only=True)
class Observation:
    """What a skill sees at one control step.

    Attributes:
        time: seconds since the episode began.
        state: the current belief about the objects, the robot's own features always measured.
        ready: whether a thought that a skill began is finished.
    """

    time: float
    state: State
    ready: Ready = awaited


@dataclass(frozen=True, kw_only=True)
class ArmObservation(Observation):
    """What an arm measures besides.

    Attributes:
        arm: (6,) measured joint positions, rad, order of ARM_JOINTS.
        arm_velocity: (6,) rad/s.
        opening: measured free distance between the pads, m.
        commanded_opening: what the pads were last told, m: less than `opening` by what makes them hold a block.
        tip_force: (3,) force that the world exerts on the hand, N, world frame, estimated.
        look: takes pictures, where the world has cameras that a skill may look through while it runs.
    """

    arm: Float[np.ndarray, "6"]
    arm_velocity: Float[np.ndarray, "6"]
    opening: float
    commanded_opening: float
    tip_force: Float[np.ndarray, "3"]
    look: Look | None = None


ObservationT_co = TypeVar("ObservationT_co", bound=Observation, covariant=True)
ActionT_contra = TypeVar("ActionT_contra", contravariant=True)


class World(Protocol[ObservationT_co, ActionT_contra]):
    """A robot among objects. Its action is a `JointTarget` where it is an arm, else what its domain declares: (n,)."""

    def observe(self, live: bool = False) -> ObservationT_co:
        """The latest measurements; never moves the robot.

        Args:
            live: ask for the objects' poses as they are now, not as they were last perceived.
        """
        ...

    def act(self, action: ActionT_contra, duration: float, /) -> None:
        """Do `action` for `duration` seconds."""
        ...

    def perceive(self) -> State:
        """A fresh, full estimate of the scene; may move the robot to look around."""
        ...


@runtime_checkable
class EffortLimited(Protocol):
    """A world whose robot can be told how hard it may press: an arm's."""

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        """Cap the arm's joint torques at (6,) N m; None restores its own limits."""
        ...


class Simulator(World[ObservationT_co, ActionT_contra], Protocol[ObservationT_co, ActionT_contra]):
    """A world whose state can be put back."""

    def save(self) -> Any:
        """A snapshot for `restore`. Replays after a restore in mid-contact are not bit-exact."""
        ...

    def restore(self, snapshot: Any) -> None: ...
