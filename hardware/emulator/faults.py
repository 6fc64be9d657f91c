"""What can go wrong at a machine, by name, to be brought about on an emulated one."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from resync_robot.core.errors import ConfigError, UnknownNameError
from resync_robot.hardware.emulator.controller import RobotMode, SafetyMode
from resync_robot.hardware.emulator.server import Emulator


def _safety(mode: SafetyMode) -> Callable[[Emulator], None]:
    return lambda e: e.controller.set_safety(mode)


def _local(e: Emulator) -> None:
    e.controller.remote = False
    e.controller.stop_program("local control")


def _power_off(e: Emulator) -> None:
    e.controller.power(RobotMode.POWER_OFF)


def _slider(e: Emulator) -> None:
    e.controller.slider = 0.5


def _set(name: str, value: object) -> Callable[[Emulator], None]:
    return lambda e: setattr(e, name, value)


def _gripper(name: str, value: object) -> Callable[[Emulator], None]:
    def happen(e: Emulator) -> None:
        if e.gripper is not None:
            setattr(e.gripper, name, value)

    return happen


FAULTS: dict[str, Callable[[Emulator], None]] = {
    "protective-stop": _safety(SafetyMode.PROTECTIVE_STOP),
    "emergency-stop": _safety(SafetyMode.ROBOT_EMERGENCY_STOP),
    "system-emergency-stop": _safety(SafetyMode.SYSTEM_EMERGENCY_STOP),
    "safeguard-stop": _safety(SafetyMode.SAFEGUARD_STOP),
    "automatic-safeguard-stop": _safety(SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP),
    "enabling-stop": _safety(SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP),
    "recovery": _safety(SafetyMode.RECOVERY),
    "violation": _safety(SafetyMode.VIOLATION),
    "safety-fault": _safety(SafetyMode.FAULT),
    "reduced": _safety(SafetyMode.REDUCED),
    "power-off": _power_off,
    "program-stop": lambda e: e.controller.stop_program("stopped at the teach pendant"),
    "local": _local,
    "slider": _slider,
    "freeze": _set("frozen", True),
    "mute": _set("mute", True),
    "link-drop": Emulator.drop_link,
    "gripper-fault": _gripper("fault", 0xE),
    "gripper-silent": _gripper("silent", True),
    "gripper-gone": Emulator.drop_gripper,
}
"""Name on the command line -> what happens then, on the emulator's thread."""


@dataclass(frozen=True)
class PlannedFault:
    """Attributes: `after` s of a running control program, the fault `name`."""

    name: str
    after: float


def parse_fault(text: str) -> PlannedFault:
    """Read NAME or NAME@SECONDS. Raises UnknownNameError or ConfigError."""
    name, at, seconds = text.partition("@")
    if name not in FAULTS:
        raise UnknownNameError("fault", name, list(FAULTS))
    if at and not re.fullmatch(r"\d+(\.\d+)?", seconds):
        raise ConfigError(f"--fault {text}: '{seconds}' is no number of seconds", f"write it as --fault {name}@10")
    return PlannedFault(name, float(seconds) if at else 5.0)


class FaultPlan:
    """Brings each planned fault about once, after its time of running program; call it at every tick."""

    def __init__(self, faults: Sequence[PlannedFault]) -> None:
        self._waiting = list(faults)
        self._began: float | None = None
        self.happened: list[tuple[float, str]] = []

    def __call__(self, emulator: Emulator) -> None:
        if not self._waiting:
            return
        now = emulator.controller.time
        if self._began is None:
            if emulator.controller.program is None:
                return
            self._began = now
        for fault in [f for f in self._waiting if now - (self._began or 0.0) >= f.after]:
            self._waiting.remove(fault)
            self.happened.append((now, fault.name))
            FAULTS[fault.name](emulator)
