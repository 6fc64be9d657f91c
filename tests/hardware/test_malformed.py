"""Nonsense on the wire: the drivers turn it into one error of theirs, the emulator into the end of a conversation."""

from __future__ import annotations

import io
import os
import struct
import threading
import time
from contextlib import suppress

import numpy as np
import pytest

from resync_robot.core.errors import ResyncError
from resync_robot.core.rig import load_rig
from resync_robot.core.world import Window
from resync_robot.hardware.base import RobotError
from resync_robot.hardware.dashboard import Dashboard
from resync_robot.hardware.emulator.arm import KinematicArm
from resync_robot.hardware.emulator.controller import Controller, SafetyMode
from resync_robot.hardware.emulator.dashboard import DashboardClient
from resync_robot.hardware.emulator.gripper import EmulatedGripper, GripperClient
from resync_robot.hardware.emulator.lab_client import LabClient
from resync_robot.hardware.emulator.rtde import RtdeClient
from resync_robot.hardware.emulator.server import Emulator
from resync_robot.hardware.robotiq import Robotiq
from resync_robot.hardware.ur7e import Ur7e
from resync_robot.hardware.ur_process import LinkProcess
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

LAB_VALUES = (
    "0", "1", "3", "-1", "5.5", "1e999", "NaN", "true", "null", '"3"', "[]", "[1]", "{}", '{"a": {}}', '{"a": 3}',
    '{"a": {"type": "block", "features": 3}}', '{"a": {"type": [], "features": []}}', "9" * 5000, "[" * 100_000,
)  # fmt: skip
LAB_WORDS = (b"{", b"}", b"{}", b"[" * 3000, b'{"a":' * 3000, b"NaN", b"\xff", b"null", b"3", b'"bytes": []')
EMULATED_GRIPPER_WORDS = (b"GET", b"SET", b"POS", b"ACT", b"-1", b"99999999", b"\xff", b"0", b"", b"GET POS", b"\x00")
KNOWN_ANSWERS = {b"POS 66", b"POS 67", b"POS 68", b"ACT 0", b"ACT 1"}
"""To what by chance is a question; the fingers stand still."""
EMULATED_DASHBOARD_WORDS = (
    b"popup", b"play", b"robotmode", b"running", b"unlock", b"protective stop", b"{}", b"%s", b"\xff\xfe", b"\x00", b"",
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
        return rng.bytes(9000).replace(b"\n", b" ")
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


def test_ten_thousand_answers_of_a_lab_that_is_none() -> None:
    rng, errors = np.random.default_rng(7), 0
    lab, window = LabClient("127.0.0.1"), Window(0, 0, 1, 1)
    questions = (lambda: lab.ask({}), lab.truth, lambda: lab.picture("wrist"), lambda: lab.window("wrist", window, 1))
    for i in range(10_000):
        names = rng.choice(["bytes", "time", "height", "width", "objects", "error"], size=int(rng.integers(6)))
        fields = [f'"{name}": {LAB_VALUES[int(rng.integers(len(LAB_VALUES)))]}' for name in names]
        line = "{" + ", ".join(fields) + "}\n"
        talk = line.encode() + rng.bytes(5) if rng.random() < 0.8 else nonsense(rng, LAB_WORDS)
        lab._socket, lab._buffer = Wire(talk, rng), b""  # type: ignore[assignment]
        try:
            questions[i % len(questions)]()
        except ResyncError:
            errors += 1
    assert 7_000 < errors < 10_000, "some are what a lab says"


def in_pieces(data: bytes, rng: np.random.Generator) -> list[bytes]:
    cuts = sorted(int(i) for i in rng.integers(0, len(data) + 1, size=int(rng.integers(0, 4))))
    return [data[i:j] for i, j in zip([0, *cuts], [*cuts, len(data)], strict=True)]


def test_ten_thousand_lines_to_a_gripper_that_mean_nothing_to_it() -> None:
    rng, gripper, cut_off = np.random.default_rng(2), EmulatedGripper(0.1, activated=True), 0
    for _ in range(10_000):
        client = GripperClient(gripper)
        for piece in in_pieces(nonsense(rng, EMULATED_GRIPPER_WORDS), rng):
            assert set(client.feed(piece).replace(b"ack", b"").split(b"\n")) <= {b"", b"?"} | KNOWN_ANSWERS
        cut_off += client.ended
    assert cut_off > 50, "lines without an end"
    gripper.tick(gripper.measured)
    assert all(0 <= value <= 255 for value in gripper.registers.values())


def test_ten_thousand_lines_to_a_dashboard_that_mean_nothing_to_it() -> None:
    rng, controller, cut_off = np.random.default_rng(4), Controller(KinematicArm(load_rig().arm.home)), 0
    for _ in range(10_000):
        client, talk = DashboardClient(controller), nonsense(rng, EMULATED_DASHBOARD_WORDS)
        answer = b"".join(client.feed(piece) for piece in in_pieces(talk, rng))
        # A line for a line, whatever it says, until it is cut off.
        assert answer.count(b"\n") == talk.count(b"\n") or client.ended
        assert answer.endswith(b"\n") or not answer
        cut_off += client.ended
    assert cut_off > 50, "lines without an end"
    controller.tick()
    assert (controller.uploads, controller.safety_mode) == (0, SafetyMode.NORMAL)


class Talkative:
    """In place of the link's process: says `lines` before it is ready or ends."""

    def __init__(self, lines: bytes) -> None:
        read, write = os.pipe()
        self.stdin, self.stdout = io.BytesIO(), os.fdopen(read, "rb", 0)
        os.write(write, lines)
        os.close(write)


def test_ten_thousand_answers_of_a_link_that_is_none() -> None:
    rng = np.random.default_rng(9)
    words = (
        b"{",
        b"}",
        b'{"ready": true}',
        b'"error"',
        b"[" * 3000,
        b'{"a":' * 300,
        b"NaN",
        b"\xff",
        b"1e999",
        b"null",
    )
    ready = 0
    nothing_said = threading.Thread(target=list)
    nothing_said.start()
    for _ in range(10_000):
        link = LinkProcess.__new__(LinkProcess)
        link.process = Talkative(nonsense(rng, words))  # type: ignore[assignment]
        link._errors, link._last_error = nothing_said, ""
        answer = link._ask({})
        link.process.stdout.close()  # type: ignore[union-attr]
        ready += answer == {"ready": True}
        assert answer == {"ready": True} or "did not start" in str(answer["error"])
    assert 100 < ready < 5_000


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("seed", "count"),
    # Those that a client reads before it gives up are few: what counts is how differently a talk goes wrong.
    [*((seed, 1300) for seed in range(8)), *(pytest.param(seed, 25, marks=pytest.mark.slow) for seed in range(8, 408))],
)
def test_a_controller_that_sends_nonsense_to_the_link_is_one_error(seed: int, count: int) -> None:
    """Behind a sound beginning come packets of wrong kinds, sizes and content, all at once: over 10,000 each way."""
    emulators.need_client()
    rng = np.random.default_rng(seed)
    with emulators.emulated() as machine:
        rig = emulators.rig_at(machine.address)
        robot = Ur7e(rig, Robotiq(machine.address))
        with robot:
            assert robot._link is not None
            process = robot._link.process
            machine.call(lambda: babble(machine, rng, count))
            deadline = time.monotonic() + 8.0
            with pytest.raises(RobotError):
                while time.monotonic() < deadline:
                    robot.servo(rig.arm.home, 0.1)
        assert process.poll() is not None
        assert machine.controller.uploads == 1


def babble(machine: Emulator, rng: np.random.Generator, count: int) -> None:
    """Send every client of RTDE what no controller says, in the midst of what one says."""
    for connection in machine._connections:
        if isinstance(connection.talk, RtdeClient):
            for _ in range(count):
                body = rng.bytes(int(rng.integers(0, 60)))
                size = len(body) + 3 if rng.random() < 0.7 else int(rng.integers(0, 65536))
                kind = b"UUUvVMOIS?\x00"[int(rng.integers(11))]
                connection.unsent += struct.pack(">HB", size, kind) + body
