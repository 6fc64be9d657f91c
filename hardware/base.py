"""What every arm, gripper and camera driver looks like, and how it fails. SI units, joints in ARM_JOINTS order."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol, Self, runtime_checkable

import numpy as np
from jaxtyping import Float

from resync_robot.core.errors import MotionError, ResyncError
from resync_robot.core.joints import JointTarget
from resync_robot.core.world import CameraFrame, Cutout, Glimpse, Window

if TYPE_CHECKING:
    from resync_robot.core.episode_records import Timing
    from resync_robot.hardware.clearance import Obstacle
    from resync_robot.hardware.workspace import Workspace

SERVO_PERIOD = 0.002
"""Seconds between two setpoints: the controller's tick of 500 Hz."""


class RobotError(ResyncError):
    """The robot, gripper or camera cannot be talked to, or is in a state in which it must not move."""


class StaleError(RobotError):
    """The controller or a camera has fallen silent: what it last said is too old to move by."""


class ProtectiveStopError(RobotError):
    """The controller stopped by itself. A person looks why, and acknowledges, before anything moves again."""


class SkewError(RobotError):
    """Depth and colour of a camera were not exposed together: they show two different moments."""


class Halt(Enum):
    """What is known of a robot that this program steers no more. The value is the sentence for it."""

    STOPPED = "the controller says that the robot's program has ended"
    """By its runtime state or on its dashboard. Without a program it brakes the arm, and holds it."""
    UNKNOWN = "nobody knows whether the robot has stopped: assume that it may still move"
    """The controller does not answer, or says that the program still runs."""


class StarvedError(RobotError):
    """Setpoints came too late, or the tip felt too much force, and the arm has braked.

    Attributes:
        q: (6,) rad, the setpoint at which it now rests.
        felt: N at the tip, where that was why; else None.
    """

    def __init__(self, q: Float[np.ndarray, "6"], felt: float | None = None) -> None:
        why = "setpoints came too late" if felt is None else f"the tip felt {felt:.0f} N"
        super().__init__(f"{why}, and the arm braked to rest")
        self.q, self.felt = q, felt


class SafetyError(MotionError):
    """A setpoint that was refused before it was sent. Nothing of the refused motion reached the robot.

    Attributes:
        quantity: what was violated: 'shape', 'finite', 'position', 'jump', 'velocity', 'acceleration', 'jerk',
            'opening', 'opening speed', 'floor', 'clearance', 'workspace', 'tip speed' or 'force'.
        joint: name of the joint, or 'gripper', 'tip', 'flange', or the part of the arm that comes too near.
        value, limit: what was asked and what is allowed, SI units.
    """

    def __init__(self, quantity: str, joint: str, value: float, limit: float, what: str, fix: str = "") -> None:
        super().__init__(what, fix)
        self.quantity, self.joint, self.value, self.limit = quantity, joint, value, limit


@dataclass(frozen=True, slots=True)
class RobotState:
    """One measurement of the robot.

    Attributes:
        time: s on the robot's clock.
        q: (6,) joint positions, rad.
        qd: (6,) joint velocities, rad/s.
        tip_force: (3,) force that the world exerts on the hand, N, world frame.
        opening: measured free distance between the finger pads, m.
    """

    time: float
    q: Float[np.ndarray, "6"]
    qd: Float[np.ndarray, "6"]
    tip_force: Float[np.ndarray, "3"]
    opening: float


@dataclass(frozen=True, slots=True)
class GripperState:
    """Attributes: `opening` between the pads in m; `object_detected` when the pads stopped short of the request."""

    opening: float
    object_detected: bool


@dataclass(frozen=True, slots=True)
class Command:
    """What a skill asked for and what went to the robot at `time` (s, robot's clock)."""

    time: float
    requested: JointTarget
    sent: JointTarget


Recorder = Callable[[RobotState, Command], None]


class Device(Protocol):
    """Something that is connected, used, and closed; `close` may be called twice."""

    def connect(self) -> None:
        """Raises RobotError when the device does not answer or is not ready."""
        ...

    def close(self) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Robot(Device, Protocol):
    """An arm with its gripper."""

    def state(self) -> RobotState:
        """The latest measurement; never waits for a new one. Raises RobotError when it is stale."""
        ...

    def servo(self, q: Float[np.ndarray, "6"], opening: float) -> None:
        """Take the next setpoint (rad, m); called every SERVO_PERIOD, blocks until the tick is due.

        Only `resync_robot.hardware.safety.Guard` calls this. The array belongs to the caller and may change afterwards.
        """
        ...

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        """Cap the joint torques at (6,) N m; None restores the arm's own limits.

        A `RealtimeRobot` must be at rest. It yields instead (`resync_robot.hardware.yielding`), and may rest elsewhere
        than it was sent when the limit goes: the next `play` then raises StarvedError, and says where.
        """
        ...


@runtime_checkable
class RealtimeRobot(Robot, Protocol):
    """An arm whose clock does not wait for setpoints: a real one, or a simulation of a real one's controller."""

    def speed_fraction(self) -> float:
        """Share of full speed that the controller allows now (slider, reduced mode): 0 < fraction <= 1.

        No property: up to Python 3.11 `isinstance` reads those. Raises RobotError when the slider stands at zero.
        """
        ...

    def stay_in(self, workspace: Workspace) -> None:
        """Yield within this workspace, as it is when an effort limit is set; its guard's, which may still change it."""
        ...

    def due(self) -> float:
        """When the next setpoint that is handed over will go out, s on the robot's clock."""
        ...

    def last_sent(self) -> JointTarget:
        """What went out last, which is not what was handed over last: that waits in a queue, and an arm that yields is
        sent elsewhere. Where the arm rests, before the first.
        """
        ...

    def play(
        self,
        setpoints: Float[np.ndarray, "n 6"],
        openings: Float[np.ndarray, " n"],
        stop: Float[np.ndarray, "m 6"],
        after_each: Callable[[], None] | None = None,
    ) -> None:
        """Take a block of setpoints (rad, m), one for each SERVO_PERIOD; returns shortly before the last is due.

        Args:
            stop: the way to rest from the end of the block, played when no other block comes in time; (0, 6) where
                the block itself ends at rest.

        Raises:
            StarvedError: the way to rest of the block before had already begun, and nothing of this block was sent; or
                the tip felt too much force on the way.
            RobotError: the controller stopped, or does not answer.
        """
        ...


class Motions(Protocol):
    """What takes an arm from target to target: `resync_robot.hardware.stream.Stream`, or a recording of one."""

    @property
    def target(self) -> JointTarget:
        """The last target asked for; after `restart` and `limit_effort` where the arm rests."""
        ...

    @property
    def timing(self) -> Timing | None:
        """Of the last target that `run` was given."""
        ...

    recorders: list[Recorder]
    """Told what is measured and sent meanwhile."""

    def run(self, target: JointTarget, duration: float, travel: bool = False) -> Any:
        """Move towards `target` for `duration` s."""
        ...

    def settle(self, tolerance: float = 2e-3, timeout: float = 3.0) -> bool:
        """Hold the last target until the arm rests there."""
        ...

    def limit_effort(self, limit: tuple[float, ...] | None) -> None: ...

    def restart(self) -> None:
        """Begin again where the arm is measured, at rest."""
        ...

    def keep_out(self, *obstacles: Obstacle) -> None: ...


class Gripper(Device, Protocol):
    """A two-finger gripper."""

    def state(self) -> GripperState: ...

    def move(self, opening: float) -> None:
        """Start moving towards `opening` (m); returns at once."""
        ...


class Camera(Device, Protocol):
    """An RGB-D camera of the rig."""

    @property
    def name(self) -> str: ...

    def capture(self) -> CameraFrame:
        """A picture exposed after this call. Raises RobotError when none arrives."""
        ...


@runtime_checkable
class WindowedCamera(Protocol):
    """A camera that gives a part of its picture for less than the whole costs."""

    def cut_out(self, window: Window, size: int) -> Cutout:
        """What lies in the window now, scaled to (size, size). Raises RobotError when no picture arrives."""
        ...


@runtime_checkable
class FilmedCamera(Protocol):
    """A camera that shows what it sees by the way: nobody who asks it for a picture waits longer for it, or gets
    another one."""

    def glimpse(self) -> Glimpse:
        """What it sees about now. Raises RobotError when there is nothing."""
        ...


class Connected(ABC):
    """`with device:` for drivers that have `connect` and `close`."""

    @abstractmethod
    def connect(self) -> None: ...

    @abstractmethod
    def close(self) -> None: ...

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
