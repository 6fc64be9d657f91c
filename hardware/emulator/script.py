"""The script port: a client sends the text of a program, and the controller runs it."""

from __future__ import annotations

import logging

from resync_robot.hardware.emulator.controller import Controller

_log = logging.getLogger(__name__)
MAX_SCRIPT = 1 << 20
"""Characters; the client's own script has about sixty thousand."""


class ScriptClient:
    """One connection's side of it. A program is complete at an `end` that stands at the start of a line."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._lines: list[str] | None = None
        self._rest = b""
        self._size = 0
        self.ended = False

    def feed(self, data: bytes) -> bytes:
        """Take a part of a script; nothing is ever answered."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._size += len(data)
        if self._size > MAX_SCRIPT:
            self.ended = True
            return b""
        for raw in lines:
            line = raw.decode("utf-8", "replace").rstrip()
            if self._lines is not None:
                self._lines.append(line)
                if line == "end":
                    self._run("\n".join(self._lines))
                    self._lines = None
            elif line.startswith(("def ", "sec ")):
                self._lines = [line]
            elif line:
                self._run(line)
        return b""

    def _run(self, script: str) -> None:
        self._size = 0
        refused = self._controller.start_program(script)
        if refused:
            _log.warning("a script was refused: %s", refused)
