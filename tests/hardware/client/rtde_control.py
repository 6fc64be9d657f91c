"""In place of ur-rtde: takes every setpoint and writes it down, until it does what CLIENT_FAULT says."""

from __future__ import annotations

import os
import time
from pathlib import Path

FAULT = os.environ.get("CLIENT_FAULT", "")
GOOD = 20
"""Setpoints before a fault."""
told: dict[str, object] = {}


class RTDEControlInterface:
    FLAG_NO_WAIT = 0

    def __init__(self, address: str, frequency: float, flags: int) -> None:
        if FAULT == "in use":
            raise RuntimeError("One of the RTDE input registers are already in use!")
        self._log = Path(os.environ["CLIENT_LOG"]).open("a", buffering=1)  # noqa: SIM115
        self._count = 0

    def reuploadScript(self) -> bool:
        return True

    def isProgramRunning(self) -> bool:
        return True

    def isConnected(self) -> bool:
        return True

    def setPayload(self, mass: float, centre: list[float]) -> bool:
        told["payload"], told["centre"] = mass, [0.0, 0.0, 0.1] if FAULT == "centre" else centre
        return True

    def setTcp(self, tcp: list[float]) -> bool:
        told["tcp"] = tcp
        return True

    def getTCPOffset(self) -> object:
        return told["tcp"]

    def setWatchdog(self, frequency: float) -> bool:
        return True

    def kickWatchdog(self) -> bool:
        return True

    def servoJ(self, q: list[float], *_: float) -> bool:
        self._count += 1
        if self._count > GOOD and FAULT == "raise":
            raise RuntimeError("the library has a bad day")
        if self._count > GOOD and FAULT == "hang":
            time.sleep(60.0)
        if self._count > GOOD and FAULT == "stop":
            told["stopped"] = True
        if self._count > GOOD and FAULT == "no time":
            told["time"] = float("nan")
        if self._count > GOOD and FAULT == "refuse":
            return False
        if FAULT == "chatter":
            os.write(1, b"x" * 4095 + b"\n")
        if self._count > GOOD and FAULT in ("press", "pull"):
            told["force"] = [0.0, 0.0, 100.0 if FAULT == "press" else -100.0, 0.0, 0.0, 0.0]
        if FAULT == "knock":
            told["force"] = [0.0, 0.0, 400.0 if 400 < self._count <= 405 else 0.0, 0.0, 0.0, 0.0]
        self._log.write(" ".join(map(str, q)) + "\n")
        return True

    def servoStop(self, deceleration: float) -> bool:
        return True

    def stopScript(self) -> None:
        self._log.write("end\n")
        told["ended"] = FAULT != "stays"
