"""The supervised process that holds the ur-rtde client (`resync_robot.hardware.ur_link`), seen from the driver."""

from __future__ import annotations

import json
import logging
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import resync_robot
from resync_robot.hardware.base import Halt, RobotError
from resync_robot.hardware.ur_memory import LinkMemory

_log = logging.getLogger(__name__)

START_S = 15.0
END_S = 4.0


class LinkProcess:
    """Started with its settings, one line of JSON; ready when the constructor returns.

    Args:
        stop_program: ends the robot's program, and says what is then known of it; called where the link has gone
            without the controller's word that the program has ended, and once more at the end where that stays unknown.

    Attributes:
        memory: what driver and link share.
        process: the child.
        halt: what is known of the robot's program once the child has gone; None before, and where it began none.

    Raises:
        RobotError: the controller is controlled by another program, or the link does not start.
    """

    def __init__(self, address: str, settings: dict[str, Any], stop_program: Callable[[], Halt]) -> None:
        self._stop_program = stop_program
        self.halt: Halt | None = None
        self._last_error = ""
        file = LinkMemory.new_file()
        try:
            self.memory = LinkMemory(file)
            root = str(Path(resync_robot.__file__).parents[1])
            path = os.pathsep.join([root, *(p for p in sys.path if p)])
            self.process = subprocess.Popen(
                [sys.executable, "-c", "from resync_robot.hardware.ur_link import main; main()"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                pass_fds=(file,),
                env=os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"},
                # A Ctrl-C at the terminal is for the driver, which brakes; the link ends after it.
                start_new_session=True,
            )
            self._errors = threading.Thread(target=self._log_errors, name="link's errors", daemon=True)
            self._errors.start()
            try:
                answer = self._ask({"memory": file, "address": address, **settings})
            except BaseException:
                self.close()
                raise
        finally:
            os.close(file)
        if "error" in answer:
            self.close()
            reason = str(answer["error"])
            if answer.get("started") is False and self._last_error:
                reason = f"the link did not start ({self._last_error})"
            if "already in use" in reason or "IN_USE" in reason:
                raise RobotError(
                    f"another program controls the robot: {reason}",
                    "end it, or disable its EtherNet/IP, PROFINET or MODBUS unit on the teach pendant",
                )
            known = f"; {self.halt.value}" if self.halt is Halt.UNKNOWN else ""
            raise RobotError(f"no control of the robot at {address}: {reason}{known}")

    def order(self, **content: Any) -> None:
        """A line of JSON for the link, which counts the last one it has carried out in `orders`. Raises RobotError."""
        try:
            if self.process.stdin is None:
                raise OSError
            self.process.stdin.write(json.dumps(content).encode() + b"\n")
            self.process.stdin.flush()
        except OSError:
            raise RobotError("the link to the robot takes no orders: its process has ended") from None

    def ended(self, wait: float = 0.0) -> str:
        """How it ended, within `wait` s from now: a signal or a code, and its reason; '' while it runs."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(wait)
        code = self.process.poll()
        if code is None:
            return ""
        if self.halt is None and self.memory.words["uploaded"]:
            self.halt = Halt.STOPPED if code == 0 else self._stop_program()
        why = bytes(self.memory.words["why"]).decode("utf-8", "replace")
        return (f"signal {signal.Signals(-code).name}" if code < 0 else f"code {code}") + (why and f": {why}")

    def close(self) -> None:
        """Let it brake and end its program, and reap it; `halt` says what came of it."""
        before = self.halt
        self.memory.words["finish"] = 1
        with suppress(OSError):
            if self.process.stdin is not None:
                self.process.stdin.close()
        if not self.ended(END_S):
            self.process.kill()
            self.ended(END_S)
        if self.memory.words["uploaded"] and (self.halt is None or before is Halt.UNKNOWN):
            # Once more: a controller that had fallen silent may answer by now.
            self.halt = self._stop_program()
        self._errors.join(0.5)
        if self.process.stdout is not None:
            self.process.stdout.close()

    def _log_errors(self) -> None:
        """What it and the client's library print as errors is for whoever looks for a defect."""
        stream = self.process.stderr
        if stream is not None:
            with stream:
                for line in stream:
                    text = line.decode("utf-8", "replace").rstrip()
                    self._last_error = text or self._last_error
                    _log.debug("the link: %s", text)

    def _ask(self, settings: dict[str, Any]) -> dict[str, object]:
        """Its first line of JSON. The client's library prints lines of its own, which are logged."""
        if self.process.stdin is None or self.process.stdout is None:
            raise RobotError("the link to the robot has no pipes")
        self.process.stdin.write(json.dumps(settings).encode() + b"\n")
        self.process.stdin.flush()
        deadline = time.monotonic() + START_S
        rest, lines = b"", []
        while time.monotonic() < deadline:
            if not select.select([self.process.stdout], [], [], 0.1)[0]:
                continue
            data = os.read(self.process.stdout.fileno(), 4096)
            *whole, rest = (rest + data).split(b"\n")
            for line in whole:
                text = line.decode("utf-8", "replace").strip()
                with suppress(ValueError, RecursionError):
                    content = json.loads(text)
                    if isinstance(content, dict) and content.keys() & {"ready", "error"}:
                        return content
                lines.append(text)
                _log.debug("ur-rtde: %s", text)
            if not data:
                break
        last = next((x for x in reversed(lines) if x), "it said nothing")
        return {"error": f"the link did not start ({last})", "started": False}
