"""Nonsense on the wire: the drivers turn it into one error of theirs, the emulator into the end of a conversation."""

from __future__ import annotations

import struct
import time
from contextlib import suppress

import numpy as np
import pytest

from hardware.base import RobotError
from hardware.dashboard import Dashboard
from hardware.emulator.rtde import RtdeClient
from hardware.emulator.server import Emulator
from hardware.robotiq import Robotiq
from hardware.ur7e import Ur7e
from tests import emulators

GRIPPER_WORDS = (
    b"STA",
    b"POS",
    b"3",
    b"ack",
    b"?",
    b"-1",
    b"256",
    b"\xff\x00",
    b"1e9",
    b"",
    b" ",
    b"STA 3 3",
    b"STA\t3",
)
DASHBOARD_WORDS = (
    b"Safetystatus:", b"Robotmode:", b"NORMAL", b"RUNNING", b"true", b":", b"", b"\xff\xfe", b"\x00", b"Safetystatus",
)  # fmt: skip


class Wire:
    """In place of a socket: gives one answer in pieces, then is silent or closed."""

    def __init__(self, answer: bytes, rng: np.random.Generator) -> None:
        self._answer, self._rng = answer, rng

    def sendall(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        pass

    def recv(self, most: int) -> bytes:
        size = int(self._rng.integers(1, most + 1))
        piece, self._answer = self._answer[:size], self._answer[size:]
        if not piece and self._rng.random() < 0.5:
            raise TimeoutError("timed out")
        return piece


def nonsense(rng: np.random.Generator, words: tuple[bytes, ...]) -> bytes:
    """A few words or bytes, with an end of the line, several, or none; now and then far too long."""
    if rng.random() < 0.02:
        return rng.bytes(9000)
    if rng.random() < 0.2:
        return rng.bytes(int(rng.integers(0, 40))) + b"\n"
    line = b" ".join(words[int(i)] for i in rng.integers(len(words), size=int(rng.integers(0, 4))))
    return line + (b"\n", b"\n\n", b"\r\n", b"ack", b"")[int(rng.integers(5))]


def test_ten_thousand_answers_of_a_gripper_that_is_none() -> None:
    rng, errors = np.random.default_rng(5), 0
    gripper = Robotiq("127.0.0.1")
    for _ in range(10_000):
        gripper._socket = Wire(nonsense(rng, GRIPPER_WORDS), rng)  # type: ignore[assignment]
        try:
            assert 0 <= gripper.get("STA") <= 255
        except RobotError:
            errors += 1
        gripper._socket = Wire(nonsense(rng, GRIPPER_WORDS), rng)  # type: ignore[assignment]
        with suppress(RobotError):
            gripper._set(POS=3)
    assert 5_000 < errors < 10_000, "some are what a gripper says"


def test_ten_thousand_answers_of_a_dashboard_that_is_none() -> None:
    rng, errors = np.random.default_rng(6), 0
    dashboard = Dashboard("127.0.0.1")
    for _ in range(10_000):
        talk = b"".join(nonsense(rng, DASHBOARD_WORDS) for _ in range(3))
        dashboard._socket, dashboard._rest = Wire(talk, rng), b""  # type: ignore[assignment]
        try:
            dashboard.require_ready()
        except RobotError:
            errors += 1
    assert errors > 9_900, "three sound answers in a row are rare"


@pytest.mark.realtime
@pytest.mark.parametrize("seed", range(8))
def test_a_controller_that_sends_nonsense_to_the_link_is_one_error(seed: int) -> None:
    """Behind a sound beginning come packets of wrong kinds, sizes and content, all at once: over a thousand a run."""
    emulators.need_client()
    rng = np.random.default_rng(seed)
    with emulators.emulated() as machine:
        rig = emulators.rig_at(machine.address)
        robot = Ur7e(rig, Robotiq(machine.address))
        with robot:
            assert robot._link is not None
            process = robot._link.process
            machine.call(lambda: babble(machine, rng))
            deadline = time.monotonic() + 8.0
            with pytest.raises(RobotError):
                while time.monotonic() < deadline:
                    robot.servo(rig.arm.home, 0.1)
        assert process.poll() is not None
        assert machine.controller.uploads == 1


def babble(machine: Emulator, rng: np.random.Generator) -> None:
    """Send every client of RTDE what no controller says, in the midst of what one says."""
    for connection in machine._connections:
        if isinstance(connection.talk, RtdeClient):
            for _ in range(1300):
                body = rng.bytes(int(rng.integers(0, 60)))
                size = len(body) + 3 if rng.random() < 0.7 else int(rng.integers(0, 65536))
                kind = b"UUUvVMOIS?\x00"[int(rng.integers(11))]
                connection.unsent += struct.pack(">HB", size, kind) + body
