"""The controller itself: modes, safety, the program that runs, and the 500 Hz tick. No sockets here.

Everything happens in `tick`, on one thread; the servers call in between ticks on the same thread.
"""

from __future__ import annotations

import enum
import logging
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.machines import ARMS, ArmModel
from resync_robot.hardware.base import SERVO_PERIOD
from resync_robot.hardware.emulator.arm import Measured, PhysicsArm
from resync_robot.hardware.emulator.judge import Judge
from resync_robot.hardware.emulator.program import Command, ControlProgram
from resync_robot.hardware.emulator.variables import Value

_log = logging.getLogger(__name__)

UNLOCK_AFTER_S = 5.0
"""A protective stop cannot be unlocked earlier; the manufacturer's figure."""
STOP_DECELERATION = 20.0
"""rad/s^2 of every joint when the controller itself brakes; chosen."""


class RobotMode(enum.IntEnum):
    """`robot_mode`, as the manufacturer numbers it."""

    POWER_OFF = 3
    IDLE = 5
    RUNNING = 7


class SafetyMode(enum.IntEnum):
    """`safety_mode`, as the manufacturer numbers it."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9
    AUTOMATIC_MODE_SAFEGUARD_STOP = 10
    SYSTEM_THREE_POSITION_ENABLING_STOP = 11


STATUS_BIT = {
    SafetyMode.NORMAL: 0,
    SafetyMode.REDUCED: 1,
    SafetyMode.PROTECTIVE_STOP: 2,
    SafetyMode.RECOVERY: 3,
    SafetyMode.SAFEGUARD_STOP: 4,
    SafetyMode.SYSTEM_EMERGENCY_STOP: 5,
    SafetyMode.ROBOT_EMERGENCY_STOP: 6,
    SafetyMode.VIOLATION: 8,
    SafetyMode.FAULT: 9,
    SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP: 4,
    SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP: 10,
}
MOVES = (SafetyMode.NORMAL, SafetyMode.REDUCED)
POWERED = (
    *MOVES,
    SafetyMode.PROTECTIVE_STOP,
    SafetyMode.RECOVERY,
    SafetyMode.SAFEGUARD_STOP,
    SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP,
    SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP,
)


class Runtime(enum.IntEnum):
    """`runtime_state`."""

    STOPPED = 1
    PLAYING = 2


@dataclass(frozen=True, kw_only=True)
class ControllerSettings:
    """What the emulated machine is."""

    version: tuple[int, int, int, int] = (5, 22, 0, 0)
    """PolyScope 5.22 is the first that knows the UR7e."""
    model: ArmModel = ARMS["ur7e"]
    serial: str = "20260700001"
    remote: bool = True
    """Remote control; in local control the machine refuses scripts and most dashboard commands."""
    world_T_base: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))


class Controller:
    """An arm with its controller.

    Attributes:
        time: s since it was switched on, its own clock.
        wire: the servo setpoints received, as (time in s, (6,) rad), kept where a test sets it to a list.
        judge: looks at each of them, where there is one.
        opening: m that the gripper wants between its pads.
    """

    def __init__(self, arm: PhysicsArm, settings: ControllerSettings | None = None) -> None:
        self.settings = settings or ControllerSettings()
        self.arm = arm
        self.ticks = 0
        self.remote = self.settings.remote
        self.robot_mode = RobotMode.RUNNING
        self.safety_mode = SafetyMode.NORMAL
        self.slider = 1.0
        self.payload = 0.0
        self.payload_cog: tuple[float, ...] = (0.0, 0.0, 0.0)
        self.tcp: tuple[float, ...] = (0.0,) * 6
        self.inputs: dict[str, Value] = {}
        self.program: ControlProgram | None = None
        self.uploads = 0
        """Control programs that were started since power-on."""
        self.protective_stops = 0
        self.popup = ""
        self.wire: list[tuple[float, np.ndarray]] | None = None
        self.judge: Judge | None = None
        self._stopped_at = -np.inf
        self.commanded: Float[np.ndarray, "6"] = arm.measure().q.copy()
        self.velocity = np.zeros(6)
        self.opening = arm.measure().opening
        self._measured: Measured = arm.measure()

    @property
    def time(self) -> float:
        return self.ticks * SERVO_PERIOD

    @property
    def runtime(self) -> Runtime:
        return Runtime.STOPPED if self.program is None else Runtime.PLAYING

    @property
    def speed_scaling(self) -> float:
        """Share of full speed: the slider, and half of it in reduced mode."""
        return self.slider * (0.5 if self.safety_mode is SafetyMode.REDUCED else 1.0)

    @property
    def measured(self) -> Measured:
        """After the last tick."""
        return self._measured

    def install(self, arm: PhysicsArm) -> None:
        """Another arm in another scene; whatever program ran is ended, the clock goes on."""
        self.stop_program("another scene was laid out")
        self.arm, self._measured = arm, arm.measure()
        self.commanded, self.velocity = self._measured.q.copy(), np.zeros(6)
        self.opening = self._measured.opening

    def tick(self) -> None:
        """Advance by SERVO_PERIOD."""
        self.ticks += 1
        before = self.commanded
        program = self.program
        if program is not None:
            self.commanded = program.tick(self, self.commanded.copy())
            # What it did may have stopped it already.
            if program.ended and self.program is program:
                _log.info("the control program ended: %s", program.ended)
                self.program = None
        else:
            self._brake()
        self.velocity = (self.commanded - before) / SERVO_PERIOD
        self.arm.tick(self.commanded, self.opening)
        self._measured = self.arm.measure()

    def on_input(self, values: dict[str, Value]) -> None:
        """Registers and outputs that a client wrote."""
        self.inputs.update(values)
        fraction = float(values.get("speed_slider_fraction", np.nan))
        if self.inputs.get("speed_slider_mask") and np.isfinite(fraction):
            self.slider = min(max(fraction, 0.0), 1.0)
        if self.program is not None:
            self.program.on_input(values)
            if values.get("input_int_register_0") == Command.SERVOJ:
                self._write_down(np.array([values.get(f"input_double_register_{i}", np.nan) for i in range(6)]))

    def _write_down(self, q: Float[np.ndarray, "6"]) -> None:
        if self.wire is not None:
            self.wire.append((self.time, q))
        if self.judge is not None:
            self.judge.take(q)

    def start_program(self, script: str) -> str:
        """Run an uploaded script; returns why not, '' when it runs."""
        if not self.remote:
            return "the robot is in local control"
        if self.robot_mode is not RobotMode.RUNNING or self.safety_mode not in MOVES:
            return f"the robot is in {self.robot_mode.name}, {self.safety_mode.name}"
        if "rtde_control" not in script and "read_input_integer_register" not in script:
            return "" if self.program is None else self._end_program("another script was sent")
        self.program = ControlProgram(self.settings.version)
        self.uploads += 1
        if self.judge is not None:
            self.judge.begin(self._measured.q)
        # A script starts from registers that nobody has written since.
        for name in [n for n in self.inputs if "_int_register_" in n]:
            self.inputs[name] = 0
        return ""

    def stop_program(self, why: str) -> None:
        self._end_program(why)

    def _end_program(self, why: str) -> str:
        if self.program is not None:
            self.program.ended = why
            _log.info("the control program ended: %s", why)
            self.program = None
        return ""

    def protective_stop(self) -> None:
        if self.safety_mode in (*MOVES, SafetyMode.PROTECTIVE_STOP):
            self.safety_mode = SafetyMode.PROTECTIVE_STOP
            self._stopped_at = self.time
            self.protective_stops += 1
            self._end_program("protective stop")

    def unlock_protective_stop(self) -> bool:
        """Release it, from UNLOCK_AFTER_S on."""
        if self.safety_mode is not SafetyMode.PROTECTIVE_STOP or self.time < self._stopped_at + UNLOCK_AFTER_S:
            return False
        self.safety_mode = SafetyMode.NORMAL
        return True

    def set_safety(self, mode: SafetyMode) -> None:
        """What the safety system decides: emergency stop, safeguard, and their release."""
        if mode is SafetyMode.PROTECTIVE_STOP:
            return self.protective_stop()
        self.safety_mode = mode
        if mode not in MOVES:
            self._end_program(mode.name)
        if mode not in POWERED:
            self.robot_mode = RobotMode.POWER_OFF

    def power(self, mode: RobotMode) -> bool:
        """Switch the arm's power or brakes; refused while the safety system holds it."""
        if self.safety_mode not in MOVES:
            return False
        self.robot_mode = mode
        if mode is not RobotMode.RUNNING:
            self._end_program(mode.name)
        return True

    def outputs(self) -> dict[str, Value]:
        """Every variable that has a value, as RTDE names it."""
        m = self._measured
        flange = self.settings.model.kinematics.forward(m.q)
        base_R_world = self.settings.world_T_base[:3, :3].T
        force = base_R_world @ m.force
        pose = (*flange[:3, 3], *spatial.rotation_vector(flange[:3, :3]))
        bits = 1 << STATUS_BIT[self.safety_mode]
        bits |= (1 << 7) * (self.safety_mode in (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP))
        bits |= (1 << 10) * (self.safety_mode not in MOVES)
        running = self.robot_mode is RobotMode.RUNNING
        values: dict[str, Value] = {
            **self.inputs,
            "timestamp": self.time,
            "actual_q": m.q.tolist(),
            "actual_qd": m.qd.tolist(),
            "target_q": self.commanded.tolist(),
            "target_qd": self.velocity.tolist(),
            "actual_TCP_pose": pose,
            "target_TCP_pose": pose,
            "actual_TCP_force": (*force.tolist(), 0.0, 0.0, 0.0),
            "robot_mode": int(self.robot_mode),
            "safety_mode": int(self.safety_mode),
            "safety_status": int(self.safety_mode),
            "safety_status_bits": bits,
            "robot_status_bits": int(running) | 2 * (self.program is not None),
            "runtime_state": int(self.runtime),
            "speed_scaling": self.speed_scaling,
            "target_speed_fraction": self.slider,
            "payload": self.payload,
            "payload_cog": self.payload_cog,
            "joint_mode": (253,) * 6 if running else (239,) * 6,
            "actual_main_voltage": 48.0,
            "actual_robot_voltage": 48.0,
            "joint_temperatures": (30.0,) * 6,
        }
        if self.program is not None:
            values |= self.program.registers
        return values

    def _brake(self) -> None:
        """Come to rest along the last velocity, as the controller does when its program is gone."""
        speed = np.maximum(np.abs(self.velocity) - STOP_DECELERATION * SERVO_PERIOD, 0.0)
        self.commanded = self.commanded + np.sign(self.velocity) * speed * SERVO_PERIOD
