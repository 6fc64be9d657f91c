"""A Robotiq 2F-85 or 2F-140 behind the URCap's socket: registers by name, `GET` and `SET`.

Positions are counts, and this unit, like every real one, does not use all of 0 to 255: it is open at 3 counts and
closed at 230. Source: the manufacturer's register table and what clients expect of the URCap.
"""

from __future__ import annotations

import re

import numpy as np

from resync_robot.core.machines import GRIPPERS, GripperModel
from resync_robot.hardware.base import SERVO_PERIOD
from resync_robot.hardware.emulator.lines import LineConversation

OPEN_COUNT, CLOSED_COUNT = 3, 230
ACTIVATION_S = 0.6
"""A real one takes longer: it opens and closes once."""
STUCK_S, STUCK_M = 0.06, 0.0015
"""After so long without moving, so far from the request, an object is reported."""
MAX_LINE = 256
SETTABLE = ("ACT", "GTO", "ATR", "ADR", "FOR", "SPE", "POS")


class EmulatedGripper:
    """The unit itself.

    Args:
        opening: m between the pads; None for the whole stroke.
        model: its stroke, which the driver's table may put otherwise, and its speeds at SPE 0 and 255.

    Attributes:
        registers: as the unit holds them; POS is measured, PRE the request's echo.
        silent: reads answer `?`, as under an emergency stop.
        fault: code of FLT.
    """

    def __init__(
        self, opening: float | None = None, activated: bool = False, model: GripperModel = GRIPPERS["2f-140"]
    ) -> None:
        self.model = model
        opening = model.stroke if opening is None else opening
        self.request = opening
        self.driven = opening
        self.measured = opening
        self.fault = 0
        self.silent = False
        self.registers = {"ACT": int(activated), "GTO": int(activated), "ATR": 0, "ADR": 0, "FOR": 0, "SPE": 255}
        self.status = 3 if activated else 0
        self.object = 3
        self._activating = 0.0
        self._still = 0.0
        self._pre = self.count_of(opening)

    def lay_open(self, opening: float) -> None:
        """Stand open at `opening` (m), as in a new scene."""
        self.request = self.driven = self.measured = opening
        self.object, self._pre = 3, self.count_of(opening)

    def count_of(self, opening: float) -> int:
        """Position counts of an opening in m."""
        share = 1.0 - min(max(opening / self.model.stroke, 0.0), 1.0)
        return round(OPEN_COUNT + share * (CLOSED_COUNT - OPEN_COUNT))

    def opening_of(self, count: int) -> float:
        """Opening in m at position counts."""
        share = (min(max(count, OPEN_COUNT), CLOSED_COUNT) - OPEN_COUNT) / (CLOSED_COUNT - OPEN_COUNT)
        return self.model.stroke * (1.0 - share)

    def set(self, name: str, value: int) -> None:
        value = min(max(value, 0), 255)
        if name == "POS":
            self._pre = value
            self.request = self.opening_of(value)
            self.object, self._still = 0, 0.0
        else:
            self.registers[name] = value
        if name == "ACT":
            self.status = 1 if value else 0
            self._activating = 0.0
            if not value:
                self.fault = 0

    def get(self, name: str) -> int | None:
        if name == "POS":
            return self.count_of(self.measured)
        status = {"PRE": self._pre, "OBJ": self.object, "STA": self.status, "FLT": self.fault}
        return status.get(name, self.registers.get(name))

    def tick(self, measured: float) -> float:
        """Advance by SERVO_PERIOD with the pads measured at `measured`; returns where the drive wants them (m)."""
        moved, self.measured = abs(measured - self.measured), measured
        if self.registers["ACT"] and self.status != 3:
            self._activating += SERVO_PERIOD
            self.status = 3 if self._activating >= ACTIVATION_S else 1
        if not (self.status == 3 and self.registers["GTO"]) or self.fault:
            self.driven = measured if self.fault else self.driven
            return self.driven
        least, most = self.model.speed
        speed = least + (most - least) * self.registers["SPE"] / 255
        step = speed * SERVO_PERIOD
        self.driven += float(np.clip(self.request - self.driven, -step, step))
        away = measured - self.request
        self._still = self._still + SERVO_PERIOD if moved < 1e-6 else 0.0
        if abs(away) <= STUCK_M and self.driven == self.request:
            self.object = 3
        elif self._still >= STUCK_S and self.driven == self.request:
            self.object = 2 if away > 0 else 1
        elif self.object != 3 or abs(self.driven - self.request) > 0:
            self.object = 0
        elif abs(away) > STUCK_M:
            self.object = 3
        return self.driven


class GripperClient(LineConversation):
    """One connection's side of it."""

    def __init__(self, gripper: EmulatedGripper) -> None:
        super().__init__(MAX_LINE)
        self._gripper = gripper

    def answer(self, line: str) -> bytes:
        words = line.split()
        if len(words) == 2 and words[0] == "GET":
            value = self._gripper.get(words[1])
            return b"?\n" if value is None or self._gripper.silent else f"{words[1]} {value}\n".encode()
        if len(words) >= 3 and words[0] == "SET" and len(words) % 2 == 1:
            pairs = list(zip(words[1::2], words[2::2], strict=True))
            if all(n in SETTABLE and re.fullmatch(r"\d{1,6}", v) for n, v in pairs):
                if not self._gripper.silent:
                    for name, number in pairs:
                        self._gripper.set(name, int(number))
                # No newline: that is how the real one answers, and known clients compare exactly.
                return b"ack"
        return b"?\n"
