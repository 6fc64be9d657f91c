"""RTDE, protocol version 2: clients agree on recipes, send inputs, and get outputs at their frequency."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field

from resync_robot.hardware.emulator.variables import IN_USE, INPUTS, NOT_FOUND, OUTPUTS, Recipe, Value

HEADER = struct.Struct(">HB")
MAX_PACKET = 4096
"""Bytes. A real controller cuts off at 2048; the limit here only has to end a conversation with something else."""
RATE = 500
VERSION, PROTOCOL, TEXT, DATA, OUTPUT_SETUP, INPUT_SETUP, START, PAUSE = b"vVMUOISP"


def packet(kind: int, body: bytes) -> bytes:
    return HEADER.pack(HEADER.size + len(body), kind) + body


class ProtocolError(Exception):
    """A client said something that the protocol does not know; its connection ends."""


@dataclass
class RtdeClient:
    """One connection's side of the conversation; bytes in, bytes out.

    Attributes:
        started: data packages are flowing.
        every: ticks between two of them.
    """

    version: tuple[int, int, int, int]
    reserve: Callable[[RtdeClient, tuple[str, ...]], bool]
    on_input: Callable[[dict[str, Value]], None]
    started: bool = False
    every: int = 1
    output: Recipe | None = None
    inputs: dict[int, Recipe] = field(default_factory=dict)
    _buffer: bytearray = field(default_factory=bytearray)

    def feed(self, data: bytes) -> bytes:
        """Take bytes from the client and return what to answer. Raises ProtocolError."""
        self._buffer += data
        answers = b""
        while len(self._buffer) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._buffer)
            if not HEADER.size <= size <= MAX_PACKET:
                raise ProtocolError(f"a packet of {size} bytes")
            if len(self._buffer) < size:
                break
            body = bytes(self._buffer[HEADER.size : size])
            del self._buffer[:size]
            answers += self._answer(kind, body)
        return answers

    def data(self, tick: int, values: dict[str, Value]) -> bytes:
        """The data package of this tick; empty when none is due."""
        if not self.started or self.output is None or tick % self.every:
            return b""
        return packet(DATA, b"\x01" + self.output.pack(values))

    def _answer(self, kind: int, body: bytes) -> bytes:
        if kind == PROTOCOL:
            return packet(kind, bytes([body == struct.pack(">H", 2)]))
        if kind == VERSION:
            return packet(kind, struct.pack(">4I", *self.version))
        if kind == OUTPUT_SETUP:
            return self._set_output(body)
        if kind == INPUT_SETUP:
            return self._add_input(body)
        if kind in (START, PAUSE):
            usable = self.output is not None and self.output.usable
            self.started = kind == START and usable
            return packet(kind, bytes([usable]))
        if kind == DATA:
            self._take(body)
            return b""
        if kind == TEXT:
            return b""
        raise ProtocolError(f"a packet of type {kind}")

    def _set_output(self, body: bytes) -> bytes:
        if len(body) < 8:
            raise ProtocolError("a set-up of outputs without a frequency")
        (frequency,) = struct.unpack_from(">d", body)
        names = _names(body[8:])
        self.output = Recipe(names, tuple(OUTPUTS.get(n, NOT_FOUND) for n in names))
        self.every = max(1, round(RATE / frequency)) if 1.0 <= frequency <= RATE else 1
        return packet(OUTPUT_SETUP, b"\x01" + ",".join(self.output.types).encode())

    def _add_input(self, body: bytes) -> bytes:
        names = _names(body)
        types = tuple(INPUTS.get(n, NOT_FOUND) for n in names)
        if NOT_FOUND not in types and not self.reserve(self, names):
            types = (IN_USE,) * len(names)
        recipe = Recipe(names, types)
        if not recipe.usable or len(self.inputs) >= 255:
            return packet(INPUT_SETUP, b"\x00" + ",".join(types).encode())
        identity = len(self.inputs) + 1
        self.inputs[identity] = recipe
        return packet(INPUT_SETUP, bytes([identity]) + ",".join(types).encode())

    def _take(self, body: bytes) -> None:
        recipe = self.inputs.get(body[0]) if body else None
        if recipe is None:
            raise ProtocolError("data for a recipe that was not agreed on")
        try:
            values = recipe.unpack(body[1:])
        except struct.error as error:
            raise ProtocolError(f"a data package of the wrong length: {error}") from None
        self.on_input(values)


def _names(body: bytes) -> tuple[str, ...]:
    """The variables of a set-up request; clients may end their list with a comma."""
    try:
        text = body.decode("ascii")
    except UnicodeDecodeError:
        raise ProtocolError("names of variables that are no text") from None
    return tuple(n for n in (part.strip() for part in text.split(",")) if n)
