"""The controller's dashboard: a line asked, a line answered. Its state in clear sentences, and the few orders needed.

Written here and not taken from ur-rtde, whose client may end the process that holds it.
"""

from __future__ import annotations

import socket
import time

from resync_robot.core.machines import ARMS, ArmModel
from resync_robot.hardware.base import Connected, ProtectiveStopError, RobotError

PORT = 29999
MAX_REPLY = 4096
TIMEOUT_S = 3.0
END_S = 2.0
"""How long a program may take to end."""

OTHER_MODES = {
    "POWER_OFF": "the arm has no power: switch it on and release the brakes on the teach pendant",
    "POWER_ON": "the arm is starting: wait until it is ready",
    "IDLE": "the brakes are on: release them on the teach pendant",
    "BOOTING": "the controller is starting: wait until it is ready",
    "CONFIRM_SAFETY": "the safety configuration waits to be confirmed on the teach pendant",
    "BACKDRIVE": "somebody moves the arm by hand: end that on the teach pendant",
    "NO_CONTROLLER": "the controller does not run: restart the robot",
    "DISCONNECTED": "the arm is not connected to its controller: restart the robot",
}
OTHER_SAFETY = {
    "SAFEGUARD_STOP": "a safeguard (door, light curtain) is open: close it, and reset it on the machine",
    "AUTOMATIC_MODE_SAFEGUARD_STOP": "a safeguard (door, light curtain) is open: close it, and reset it on the machine",
    "SYSTEM_THREE_POSITION_ENABLING_STOP": "the enabling device is not held: hold it in its middle position",
    "SYSTEM_EMERGENCY_STOP": "an emergency stop of the system is pressed: release it and switch the arm on by hand",
    "ROBOT_EMERGENCY_STOP": "the emergency stop is pressed: release it and switch the arm on by hand",
    "VIOLATION": "a safety limit was violated: look at the teach pendant's log",
    "FAULT": "the safety system has a fault: look at the teach pendant's log",
    "RECOVERY": "the arm is outside its safety limits: move it back on the teach pendant",
}


class Dashboard(Connected):
    """One connection to the dashboard server.

    Args:
        address: IPv4 address of the controller.
    """

    def __init__(self, address: str, port: int = PORT, timeout: float = TIMEOUT_S) -> None:
        self._where, self._timeout = (address, port), timeout
        self._socket: socket.socket | None = None
        self._rest = b""

    def connect(self) -> None:
        address, port = self._where
        try:
            self._socket = socket.create_connection(self._where, self._timeout)
        except OSError as error:
            reason = "no answer" if isinstance(error, TimeoutError) else error.strerror or str(error)
            raise RobotError(
                f"no controller at {address}:{port}: {reason}",
                "switch the controller on, check [controller] address in the rig file, and try  ping " + address,
            ) from None
        self._rest = b""
        self._line()

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def ask(self, line: str) -> str:
        """The reply to a line. Raises RobotError when none comes, or more than a line."""
        if self._socket is None:
            raise RobotError("the dashboard is not connected", "use it as `with Dashboard(address) as dashboard:`")
        try:
            self._socket.sendall(line.encode("ascii") + b"\n")
        except OSError as error:
            raise RobotError(f"the controller's dashboard is gone: {error.strerror or error}") from None
        return self._line()

    def _line(self) -> str:
        if self._socket is None:
            raise RobotError("the dashboard is not connected")
        while b"\n" not in self._rest:
            try:
                data = self._socket.recv(1024)
            except OSError as error:
                raise RobotError(f"the controller's dashboard does not answer: {error.strerror or error}") from None
            self._rest += data
            if not data or len(self._rest) > MAX_REPLY:
                raise RobotError("the controller's dashboard ended the conversation")
        line, self._rest = self._rest.split(b"\n", 1)
        return line.decode("utf-8", "replace").strip()

    def safety(self) -> str:
        """The safety status, such as NORMAL."""
        return self._word("safetystatus")

    def mode(self) -> str:
        """The robot mode, such as RUNNING."""
        return self._word("robotmode")

    def _word(self, question: str, answer: str = "") -> str:
        """The word after `answer` (by default what was asked) and a colon."""
        reply = self.ask(question)
        head, colon, word = reply.partition(":")
        if not colon or head.lower() != (answer or question):
            raise RobotError(f"the dashboard answers '{reply[:80]}' to '{question}'", "is this a UR controller?")
        return word.strip().upper()

    def require_ready(self) -> None:
        """Raise what keeps the robot from being driven by a program: one sentence, and what to do.

        Raises:
            ProtectiveStopError: it stands in a protective stop.
            RobotError: its mode, its safety status, or local control.
        """
        safety = self.safety()
        if safety == "PROTECTIVE_STOP":
            raise ProtectiveStopError("the robot is in a protective stop", "look why, then acknowledge it")
        if safety not in ("NORMAL", "REDUCED"):
            raise RobotError(
                f"the robot must not move: {safety}", OTHER_SAFETY.get(safety, "look at the teach pendant")
            )
        mode = self.mode()
        if mode != "RUNNING":
            raise RobotError(f"the robot is not ready: {mode}", OTHER_MODES.get(mode, "look at the teach pendant"))
        if self.ask("is in remote control").lower() != "true":
            raise RobotError(
                "the robot is in local control", "switch it to remote control at the top right of the teach pendant"
            )

    def require_arm(self, model: ArmModel) -> None:
        """Raises RobotError where the controller says that its arm has other lengths than the rig's has."""
        said = self.ask("get robot model").upper()
        same = [arm for arm in ARMS.values() if arm.polyscope == said]
        # What it calls an arm that is not known here proves nothing.
        if same and all(arm.kinematics != model.kinematics for arm in same):
            raise RobotError(
                f"the controller's arm is a {said}, the rig file says {model.title}",
                f'write it as: model = "{next(name for name, arm in ARMS.items() if arm in same)}" under [arm]',
            )

    def stop_program(self) -> bool:
        """End whatever program runs on the controller; whether it then says, within END_S, that none does."""
        self.ask("stop")
        deadline = time.monotonic() + END_S
        while (running := self._word("running", "program running")) != "FALSE" and time.monotonic() < deadline:
            time.sleep(0.05)
        return running == "FALSE"

    def unlock_protective_stop(self) -> None:
        """Release it. Raises ProtectiveStopError when the controller refuses, as it does for its first 5 s."""
        self.ask("close safety popup")
        reply = self.ask("unlock protective stop")
        if "releasing" not in reply.lower():
            raise ProtectiveStopError(
                f"the protective stop was not released: {reply}", "wait 5 s, and look why it stopped"
            )
