"""The dashboard server's conversation: one line in, one line out. Source: the manufacturer's dashboard guide."""

from __future__ import annotations

from resync_robot.hardware.emulator.controller import Controller, RobotMode, SafetyMode
from resync_robot.hardware.emulator.lines import LineConversation

BANNER = b"Connected: Universal Robots Dashboard Server\n"
MAX_LINE = 1024
_REMOTE_ONLY = ("play", "stop", "pause", "power on", "power off", "brake release", "unlock protective stop")


class DashboardClient(LineConversation):
    """One connection's side of it."""

    def __init__(self, controller: Controller) -> None:
        super().__init__(MAX_LINE)
        self._controller = controller

    def answer(self, line: str) -> bytes:
        return self._reply(line).encode() + b"\n"

    def _reply(self, line: str) -> str:
        c, word = self._controller, line.lower()
        if word in _REMOTE_ONLY and not c.remote:
            return (
                f"Command is not allowed due to safety reasons: {line}"
                if word != "play"
                else f"Failed to execute: {word}"
            )
        if word in ("quit", "exit"):
            self.ended = True
            return "Disconnected"
        if word == "unlock protective stop":
            if c.unlock_protective_stop():
                return "Protective stop releasing"
            return "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop"
        if word == "stop":
            c.stop_program("stopped on the dashboard")
            return "Stopped"
        powers = {
            "power on": (RobotMode.IDLE, "Powering on"),
            "power off": (RobotMode.POWER_OFF, "Powering off"),
            "brake release": (RobotMode.RUNNING, "Brake releasing"),
        }
        if word in powers:
            mode, reply = powers[word]
            return reply if c.power(mode) else f"Failed to execute: {word}"
        if word == "restart safety":
            if c.safety_mode in (SafetyMode.FAULT, SafetyMode.VIOLATION):
                c.safety_mode, c.robot_mode = SafetyMode.NORMAL, RobotMode.POWER_OFF
            return "Restarting safety"
        if word in ("close popup", "close safety popup"):
            c.popup = ""
            return "closing popup" if word == "close popup" else "closing safety popup"
        if word.startswith(("popup ", "addtolog ")):
            c.popup = line.partition(" ")[2] if word.startswith("popup ") else c.popup
            return "showing popup" if word.startswith("popup ") else "Added log message"
        replies = {
            "polyscopeversion": "URSoftware {}.{}.{}.{} (Jan 01 2026)".format(*c.settings.version),
            "get serial number": c.settings.serial,
            "get robot model": c.settings.model.polyscope,
            "is in remote control": str(c.remote).lower(),
            "robotmode": f"Robotmode: {c.robot_mode.name}",
            "safetymode": f"Safetymode: {c.safety_mode.name}",
            "safetystatus": f"Safetystatus: {c.safety_mode.name}",
            "running": f"Program running: {str(c.program is not None).lower()}",
            "programstate": "PLAYING rtde_control" if c.program is not None else "STOPPED rtde_control",
            "get loaded program": "No program loaded",
        }
        return replies.get(word, f'could not understand: "{line}"')
