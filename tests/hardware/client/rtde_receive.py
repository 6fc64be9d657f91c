"""In place of ur-rtde: a controller in good order, at rest."""

from __future__ import annotations

import os
import time

from rtde_control import FAULT, told

Q = [float(x) for x in os.environ["CLIENT_Q"].split()]


class RTDEReceiveInterface:
    def __init__(self, address: str, frequency: float, variables: list[str]) -> None:
        pass

    def isConnected(self) -> bool:
        return True

    def getTimestamp(self) -> float:
        return told.get("time", time.monotonic())

    def getActualQ(self) -> list[float]:
        return Q

    def getActualQd(self) -> list[float]:
        return [0.0] * 6

    def getActualTCPForce(self) -> list[float]:
        return told.get("force", [0.0] * 6)

    def getRobotMode(self) -> int:
        return 7

    def getSafetyMode(self) -> int:
        if "stopped" in told:
            # The machine is busy.
            time.sleep(0.1)
        return told.get("safety mode", 1)

    def getRuntimeState(self) -> int:
        if "stopped" in told:
            # The emergency stop's packet came between the reading of the one and of the other.
            told["safety mode"] = 6
        return 1 if "stopped" in told or told.get("ended") else 2

    def getSpeedScaling(self) -> float:
        return {"no fraction": float("nan"), "no speed": 0.0}.get(FAULT, 1.0)

    def getPayload(self) -> object:
        return told["payload"]

    def getPayloadCog(self) -> object:
        return told["centre"]
