"""The side door of an emulated lab, which no real one has: lay out a scene, ask where things really are, get pictures.

One line of JSON each way on its own port; a picture's bytes follow its line. `LabClient` is the deployment's end of it;
the other end lives with the simulator.
"""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from resync_robot.core.state import State
from resync_robot.core.vocabulary import TYPES
from resync_robot.core.world import Window
from resync_robot.hardware.base import Connected, RobotError

PORT = 30910
MAX_LINE = 1 << 20
MAX_PICTURE = 1 << 26
TIMEOUT_S = 120.0
"""A scene and its first picture take half a minute where the processor draws and is busy, others up to a second."""


@contextmanager
def _sense() -> Iterator[None]:
    """Around the reading of an answer: one error for any that is not what was asked for."""
    try:
        yield
    except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
        raise RobotError(
            f"the emulated lab's answer makes no sense: {type(error).__name__}: {str(error)[:60]}", "start it again"
        ) from None


class LabClient(Connected):
    """Talks to the emulated lab at `address`."""

    def __init__(self, address: str, port: int = PORT) -> None:
        self._where = (address, port)
        self._socket: socket.socket | None = None
        self._buffer = b""
        self._asking = threading.Lock()

    def connect(self) -> None:
        address, port = self._where
        try:
            self._socket = socket.create_connection(self._where, TIMEOUT_S)
        except OSError as error:
            raise RobotError(
                f"no emulated lab at {address}:{port}: {error.strerror or error}",
                "start one in another terminal:  resync-robot emulate",
            ) from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def lay_out(self, domain: str, scenario: str, seed: int, episode: int) -> None:
        """Put the scene of that episode before the robot, which stands at its home again."""
        self.ask({"do": "lay out", "domain": domain, "scenario": scenario, "seed": seed, "episode": episode})

    def lay_out_bench(self, bench: Mapping[str, Any]) -> dict[str, np.ndarray]:
        """Put what a calibration looks at before the robot: a `resync_robot.sim_training.scenes.calibration.Bench`.

        Returns:
            (4, 4) where each camera really is in its mount, by name.
        """
        head, _ = self.ask({"do": "lay out", "bench": bench})
        with _sense():
            poses = {
                str(name): np.array(pose, dtype=np.float64).reshape(4, 4) for name, pose in head["cameras"].items()
            }
        return poses

    def truth(self) -> State:
        """Where everything really is."""
        head, _ = self.ask({"do": "truth"})
        with _sense():
            return State.from_json(head["objects"], TYPES)

    def picture(self, camera: str) -> tuple[float, np.ndarray, np.ndarray]:
        """Time on the controller's clock (s), (H, W, 3) uint8 RGB, (H, W) uint16 depth in 1e-4 m, with all noise."""
        head, body = self.ask({"do": "picture", "camera": camera})
        with _sense():
            time, height, width = float(head["time"]), int(head["height"]), int(head["width"])
        if len(body) != height * width * 5:
            raise RobotError(f"the emulated camera '{camera}' sent {len(body)} bytes for {width} x {height} pixels")
        colour = np.frombuffer(body, np.uint8, height * width * 3).reshape(height, width, 3)
        depth = np.frombuffer(body, "<u2", height * width, height * width * 3).reshape(height, width)
        return time, colour, depth

    def window(self, camera: str, window: Window, size: int) -> tuple[float, np.ndarray]:
        """Time on the controller's clock (s), and (size, size, 3) uint8 RGB of a part of a picture, with all noise."""
        sides = [window.left, window.top, window.width, window.height]
        head, body = self.ask({"do": "picture", "camera": camera, "window": sides, "size": size})
        if len(body) != size * size * 3:
            raise RobotError(f"the emulated camera '{camera}' sent {len(body)} bytes for {size} x {size} pixels")
        with _sense():
            time = float(head["time"])
        return time, np.frombuffer(body, np.uint8).reshape(size, size, 3)

    def colour(self, camera: str) -> tuple[float, np.ndarray]:
        """Time on the controller's clock (s), and (H, W, 3) uint8 RGB, for a film: no picture that is asked for changes
        by it."""
        head, body = self.ask({"do": "picture", "camera": camera, "film": True})
        with _sense():
            time, height, width = float(head["time"]), int(head["height"]), int(head["width"])
            colour = np.frombuffer(body, np.uint8).reshape(height, width, 3)
        return time, colour

    def ask(self, question: Mapping[str, Any]) -> tuple[dict[str, Any], bytes]:
        """The answer, and the bytes that follow it, for any thread. Raises RobotError with the lab's own words."""
        with self._asking:
            return self._ask(question)

    def _ask(self, question: Mapping[str, Any]) -> tuple[dict[str, Any], bytes]:
        if self._socket is None:
            raise RobotError("the emulated lab is not connected")
        try:
            self._socket.sendall(json.dumps(question).encode() + b"\n")
            while b"\n" not in self._buffer:
                self._receive(MAX_LINE)
            line, self._buffer = self._buffer.split(b"\n", 1)
            head = json.loads(line)
            if not isinstance(head, dict):
                raise ValueError("no JSON object")
            if "error" in head:
                raise RobotError(f"the emulated lab: {head['error']}")
            size = head.get("bytes", 0)
            if not isinstance(size, int) or not 0 <= size <= MAX_PICTURE:
                raise ValueError(f"{str(size)[:40]} bytes")
            while len(self._buffer) < size:
                self._receive(MAX_PICTURE)
        except (OSError, ValueError, RecursionError) as error:
            self.close()
            raise RobotError(f"the emulated lab does not answer: {error}", "start it again") from None
        body, self._buffer = self._buffer[:size], self._buffer[size:]
        return head, body

    def _receive(self, most: int) -> None:
        if self._socket is None or len(self._buffer) > most:
            raise ValueError("too much")
        data = self._socket.recv(1 << 16)
        if not data:
            raise ConnectionResetError("it closed the connection")
        self._buffer += data
