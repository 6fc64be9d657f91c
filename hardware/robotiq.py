"""The Robotiq 2F-85 or 2F-140 over the socket that its URCap opens on the controller.

The socket speaks in registers and counts; here it is openings in m. Requests go out from a thread of their own, so that
a slow answer never holds up the setpoints of the arm.
"""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from jaxtyping import Float

from resync_robot.core.machines import GRIPPERS, GripperModel
from resync_robot.hardware.base import Connected, GripperState, RobotError
from resync_robot.hardware.pauses import pauses

_log = logging.getLogger(__name__)

PORT = 63352
TIMEOUT_S = 2.0
POLL_S = 0.02
ACTIVATION_LIMIT_S = 10.0
STALE_S = 0.5
DEFAULT_TABLE = ((3, 0.140), (230, 0.0))
"""(counts, m between the pads), open to closed. Every unit differs: measure it with a calliper."""
MAX_LINE = 64
FAULTS = {
    5: "the motion waits for the activation to finish",
    7: "it is not activated",
    8: "it is too hot: let it cool down",
    9: "its communication was lost for a second",
    0xA: "its supply voltage is too low",
    0xB: "it was released automatically and must be activated again",
    0xC: "an internal error; its maker has to look at it",
    0xD: "the activation failed: check that nothing hinders the fingers",
    0xE: "its current is too high",
    0xF: "it has been released automatically",
}


class ObjectStatus(IntEnum):
    """Register OBJ."""

    MOVING = 0
    WHILE_OPENING = 1
    WHILE_CLOSING = 2
    AT_REQUEST = 3
    """Where it was asked to be: nothing was gripped, or what was gripped is lost."""


class Robotiq(Connected):
    """A two-finger gripper, activated and ready.

    Args:
        address: IPv4 address of the controller that carries the URCap.
        table: measured (counts, m) pairs, counts rising, openings falling; the rig file's reader sees to that.
        speed: m/s of opening; None for the fastest of the model.
        force: 0 to 1 of what the gripper can do; counts of force are no newtons.
        model: whose speeds the counts 0 and 255 stand for.

    Raises:
        RobotError: a speed or force that cannot be.
    """

    def __init__(
        self,
        address: str,
        table: Sequence[Sequence[float]] | Float[np.ndarray, "n 2"] = DEFAULT_TABLE,
        speed: float | None = None,
        force: float = 0.2,
        port: int = PORT,
        model: GripperModel = GRIPPERS["2f-140"],
    ) -> None:
        least, most = model.speed
        speed = most if speed is None else speed
        if not least <= speed <= most or not 0.0 <= force <= 1.0:
            raise RobotError(f"gripper speed {speed} m/s and force {force}; allowed: {least} to {most} m/s and 0 to 1")
        self._where = (address, port)
        self._counts, self._openings = np.array(table, dtype=float).T
        self._spe = round(255 * (speed - least) / (most - least))
        self._for = round(255 * force)
        self._socket: socket.socket | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        self._wanted: int | None = None
        self._state = GripperState(0.0, False)
        self._error: RobotError | None = None
        self._heard = 0.0
        self._closing = False

    def connect(self) -> None:
        """Open the socket and activate the gripper where it is not; activation opens and closes it once.

        Raises:
            RobotError: nobody answers, it is in a fault, or it does not become active.
        """
        address, port = self._where
        try:
            self._socket = socket.create_connection(self._where, TIMEOUT_S)
        except OSError as error:
            reason = "no answer" if isinstance(error, TimeoutError) else error.strerror or str(error)
            raise RobotError(
                f"no gripper at {address}:{port}: {reason}", "install and start the Robotiq URCap on the controller"
            ) from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            if self.get("STA") != 3:
                self._activate()
            self._check_fault(self.get("FLT"))
            self._set(GTO=1, SPE=self._spe, FOR=self._for)
            self._refresh()
        except BaseException:
            self.close()
            raise
        self._error, self._closing, self._wanted = None, False, None
        pauses()
        self._thread = threading.Thread(target=self._work, name="gripper", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave the gripper as it stands, gripping what it grips; may be called twice."""
        self._closing = True
        if self._thread is not None:
            self._thread.join(TIMEOUT_S + 1.0)
            self._thread = None
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def state(self) -> GripperState:
        """The latest reading. Raises RobotError on a fault, or when the gripper has fallen silent."""
        self._require_work()
        # While this program stood still nobody asked it anything.
        if min(time.monotonic() - self._heard, pauses().since()) > STALE_S + TIMEOUT_S:
            raise RobotError("the gripper has fallen silent", "check its cable and its URCap")
        return self._state

    def move(self, opening: float) -> None:
        """Start moving towards `opening` (m); returns at once. Raises RobotError as `state` does."""
        if not np.isfinite(opening) or not -1e-6 <= opening <= self._openings[0] + 0.01:
            raise RobotError(f"an opening of {opening} m; allowed: 0 to {self._openings[0]:.3f} m")
        self._require_work()
        with self._lock:
            self._wanted = self.count(opening)

    def count(self, opening: float) -> int:
        """Position counts for an opening in m, by the table."""
        return round(float(np.interp(-opening, -self._openings, self._counts)))

    def opening(self, count: int) -> float:
        """Opening in m at position counts, by the table."""
        return float(np.interp(count, self._counts, self._openings))

    def get(self, register: str) -> int:
        """A register's value. Raises RobotError when the gripper answers `?` or nonsense."""
        line = self._talk(f"GET {register}", b"\n").strip()
        name, _, value = line.partition(" ")
        if line == "?":
            raise RobotError(
                f"the gripper does not give {register}: the robot is in an emergency stop, or its power is off",
                "release the emergency stop, switch the arm on, and connect again",
            )
        if name != register or not value.isascii() or not value.isdigit() or int(value) > 255:
            raise RobotError(f"the gripper answers '{line[:40]}' to GET {register}", "restart its URCap")
        return int(value)

    def _set(self, **registers: int) -> None:
        words = " ".join(f"{name} {value}" for name, value in registers.items())
        answer = self._talk(f"SET {words}", b"ack").strip()
        if answer != "ack":
            raise RobotError(f"the gripper answers '{answer[:40]}' to SET {words}", "restart its URCap")

    def _talk(self, line: str, end: bytes) -> str:
        """Send a line, receive until `end` (an `ack` has no line end) or a line end."""
        sock = self._socket
        if sock is None:
            raise _unconnected()
        answer = b""
        try:
            sock.sendall(line.encode("ascii") + b"\n")
            while not answer.endswith((end, b"\n")):
                data = sock.recv(MAX_LINE)
                answer += data
                if not data or len(answer) > MAX_LINE:
                    raise ConnectionResetError
        except ConnectionError:
            raise RobotError("the gripper ended the conversation", "check its URCap, and connect again") from None
        except OSError as error:
            raise RobotError(
                f"the gripper does not answer: {error.strerror or error}", "check its cable and its URCap"
            ) from None
        return answer.decode("ascii", "replace")

    def _activate(self) -> None:
        """Reset, then activate: by the maker's procedure. A reset would drop what is gripped, so only when needed."""
        deadline = time.monotonic() + ACTIVATION_LIMIT_S
        self._set(ACT=0, ATR=0)
        for register, value, reset in (("STA", 0, True), ("STA", 3, False)):
            if not reset:
                self._set(ACT=1)
            while self.get(register) != value:
                if time.monotonic() > deadline:
                    self._check_fault(self.get("FLT"))
                    raise RobotError("the gripper does not become active", "check that nothing hinders the fingers")
                time.sleep(0.02)

    def _check_fault(self, code: int) -> None:
        if code:
            raise RobotError(
                f"the gripper reports fault {code:#x}: {FAULTS.get(code, 'of an unknown kind')}",
                "mend that, then connect again",
            )

    def _refresh(self) -> None:
        self._check_fault(self.get("FLT"))
        opening = self.opening(self.get("POS"))
        status = self.get("OBJ")
        gripped = status in (ObjectStatus.WHILE_CLOSING, ObjectStatus.WHILE_OPENING)
        self._state, self._heard = GripperState(opening, gripped), time.monotonic()

    def _require_work(self) -> None:
        if self._error is not None:
            raise self._error
        if self._thread is None:
            raise _unconnected()

    def _work(self) -> None:
        sent: int | None = None
        while not self._closing:
            try:
                with self._lock:
                    wanted, self._wanted = self._wanted, None
                if wanted is not None and wanted != sent:
                    self._set(POS=wanted, SPE=self._spe, FOR=self._for, GTO=1)
                    sent = wanted
                self._refresh()
            except RobotError as error:
                self._error = error
                _log.warning("gripper: %s", error.what)
                return
            time.sleep(POLL_S)


def _unconnected() -> RobotError:
    return RobotError("the gripper is not connected", "use it as `with Robotiq(address) as gripper:`")
