"""What the client's control script does inside the controller: registers in, motion out.

The client writes a command number and its arguments into input registers; the script answers in output registers:
ready for a command, done with it. Commands of real time re-arm at once; the others wait until the client clears
its register. Source: the behaviour of ur-rtde 1.6.5 on the wire.
"""

from __future__ import annotations

import enum
import logging
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.errors import MotionError
from resync_robot.hardware.base import SERVO_PERIOD
from resync_robot.hardware.emulator.variables import Value

if TYPE_CHECKING:
    from resync_robot.hardware.emulator.controller import Controller

_log = logging.getLogger(__name__)


class Command(enum.IntEnum):
    """Numbers of the client's commands; those that it knows and this emulator does not are acknowledged undone."""

    NONE = 0
    MOVEJ = 1
    MOVEL = 3
    SPEEDJ = 9
    SERVOJ = 11
    SPEED_STOP = 15
    SERVO_STOP = 16
    SET_PAYLOAD = 17
    SET_TCP = 29
    PROTECTIVE_STOP = 31
    STOPL = 33
    STOPJ = 34
    SET_WATCHDOG = 35
    GET_TCP_OFFSET = 40
    STOP_SCRIPT = 255


REALTIME = (Command.SERVOJ, Command.SPEEDJ)
READY, DONE = 1, 2
FURTHEST = 2 * np.pi
"""rad to either side of any joint, the elbow too: that it meets the upper arm is the client's to know."""
ARGUMENTS = 8
"""Registers of numbers that a command may bring."""


class ControlProgram:
    """One run of the script.

    Attributes:
        ended: why it ended; '' while it runs.
    """

    def __init__(self, version: tuple[int, int, int, int], base: int = 0) -> None:
        self.ended = ""
        self._base = base
        self._version = version
        self._command = 0
        self._awaiting_clear = False
        self._handled = False
        self._target: Float[np.ndarray, "6"] | None = None
        self._speed = np.zeros(6)
        self._speed_until = 0.0
        self._acceleration = 0.0
        self._path: _Path | None = None
        self._moving_sync = False
        self._watchdog: float | None = None
        self._silent = 0.0
        self.registers: dict[str, Value] = {}
        self._set(0, READY)

    def _set(self, register: int, value: int) -> None:
        self.registers[f"output_int_register_{self._base + register}"] = value

    def on_input(self, values: dict[str, Value]) -> None:
        """Take what the client wrote; acted on at the next tick."""
        name = f"input_int_register_{self._base}"
        if name in values:
            self._silent = 0.0
            self._command = int(values[name])
            self._handled = False

    def tick(self, controller: Controller, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6"]:
        """Where the joints are asked to be after this tick (rad)."""
        self._silent += SERVO_PERIOD
        if self._watchdog is not None and self._silent > self._watchdog:
            self.ended = f"watchdog: the client was silent for {self._silent:.3f} s"
            return q
        if not self._handled:
            self._handled = True
            self._obey(controller, q)
        return q if self.ended else self._move(controller, q)

    def _double(self, controller: Controller, index: int) -> float:
        return float(controller.inputs.get(f"input_double_register_{self._base + index}", 0.0))

    def _six(self, controller: Controller) -> np.ndarray:
        return np.array([self._double(controller, i) for i in range(6)])

    def _obey(self, controller: Controller, q: np.ndarray) -> None:
        if self._command == Command.NONE:
            if not self._moving_sync:
                self._awaiting_clear = False
                self._set(0, READY)
            return
        if self._command in REALTIME:
            self._obey_realtime(controller, q)
            return
        if self._awaiting_clear:
            return
        self._awaiting_clear = True
        command = self._command
        if not np.isfinite([self._double(controller, i) for i in range(ARGUMENTS)]).all():
            controller.protective_stop()
            return
        if command in (Command.SERVO_STOP, Command.SPEED_STOP, Command.STOPJ, Command.STOPL):
            self._halt(self._double(controller, 0))
        elif command == Command.MOVEJ:
            goal = self._six(controller)
            if np.any(np.abs(goal) > FURTHEST):
                controller.protective_stop()
                return
            self._begin_move(controller, q, goal, self._double(controller, 6))
            return
        elif command == Command.MOVEL:
            pose = self._six(controller)
            try:
                goal = controller.settings.model.kinematics.inverse(
                    spatial.transform(spatial.rotation_from_vector(pose[3:]), pose[:3]), controller.commanded
                )
            except MotionError:
                controller.protective_stop()
                return
            self._begin_move(controller, q, goal, 1.0)
            return
        elif command == Command.SET_WATCHDOG:
            frequency = self._double(controller, 0)
            self._watchdog = 1.0 / frequency if frequency > 0 else None
        elif command == Command.PROTECTIVE_STOP:
            controller.protective_stop()
        elif command == Command.STOP_SCRIPT:
            self.ended = "the client ended it"
        elif command == Command.SET_PAYLOAD:
            mass, most = self._double(controller, 0), controller.settings.model.payload
            if not 0.0 <= mass <= most:
                self.ended = f"a payload of {mass:g} kg; the arm carries 0 to {most:g} kg"
                return
            controller.payload = mass
            controller.payload_cog = tuple(self._double(controller, i) for i in (1, 2, 3))
        elif command == Command.SET_TCP:
            controller.tcp = tuple(self._six(controller).tolist())
        elif command == Command.GET_TCP_OFFSET:
            for i, value in enumerate(controller.tcp):
                self.registers[f"output_double_register_{self._base + i}"] = value
        else:
            _log.debug("command %d is acknowledged and not carried out", command)
        self._set(0, DONE)

    def _obey_realtime(self, controller: Controller, q: np.ndarray) -> None:
        six = self._six(controller)
        self._path = None
        servo = self._command == Command.SERVOJ
        acceleration, hold = self._double(controller, 6), self._double(controller, 7)
        # What is not a number is not within a limit either.
        if not (np.abs(six) <= (FURTHEST if servo else controller.settings.model.speed)).all():
            controller.protective_stop()
            return
        if servo:
            self._target, self._speed = six, np.zeros(6)
        elif not np.isfinite([acceleration, hold]).all():
            controller.protective_stop()
            return
        else:
            self._target = None
            self._speed, self._acceleration = six, acceleration
            self._speed_until = controller.time + hold if hold > 0 else np.inf
        self._set(0, READY)

    def _halt(self, deceleration: float) -> None:
        self._target, self._path, self._speed = None, None, np.zeros(6)
        self._acceleration = deceleration if deceleration > 0 else 10.0

    def _begin_move(self, controller: Controller, q: np.ndarray, goal: np.ndarray, speed: float) -> None:
        self._halt(10.0)
        asynchronous = bool(controller.inputs.get(f"input_int_register_{self._base + 1}", 0))
        self._path = _Path(q, goal, min(max(speed, 0.01), np.pi))
        self._set(2, 0 if asynchronous else -1)
        if asynchronous:
            self._set(0, DONE)
        else:
            self._moving_sync = True

    def _move(self, controller: Controller, q: np.ndarray) -> np.ndarray:
        fraction = controller.speed_scaling
        if self._path is not None:
            q = self._path.advance(SERVO_PERIOD * fraction)
            if self._path.done:
                self._path = None
                self._set(2, -1)
                if self._moving_sync:
                    self._moving_sync = False
                    self._set(0, DONE)
            return q
        if self._target is not None:
            # The slider does not stretch a servo's path by itself: it only keeps the arm from catching up.
            return q + fraction * (self._target - q)
        wanted = self._speed if controller.time < self._speed_until else np.zeros(6)
        change = max(self._acceleration, 1e-3) * SERVO_PERIOD
        velocity = controller.velocity + np.clip(wanted * fraction - controller.velocity, -change, change)
        return q + velocity * SERVO_PERIOD


class _Path:
    """A joint move along a cosine in time."""

    def __init__(self, begin: np.ndarray, end: np.ndarray, speed: float) -> None:
        self._begin, self._end = begin, end
        self._seconds = max(float(np.abs(end - begin).max()) / speed * np.pi / 2, SERVO_PERIOD)
        self._time = 0.0

    @property
    def done(self) -> bool:
        return self._time >= self._seconds

    def advance(self, seconds: float) -> np.ndarray:
        self._time += seconds
        share = (1 - np.cos(np.pi * min(1.0, self._time / self._seconds))) / 2
        return self._begin + share * (self._end - self._begin)
