"""The RTDE conversation, byte by byte, without sockets."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.hardware.emulator.rtde import HEADER, ProtocolError, RtdeClient, packet
from resync_robot.hardware.emulator.variables import FORMATS, INPUTS, LENGTHS, OUTPUTS, Recipe

VERSION = (5, 22, 0, 0)


class Registry:
    """Inputs belong to whoever asks first."""

    def __init__(self) -> None:
        self.owner: dict[str, RtdeClient] = {}
        self.seen: list[dict[str, object]] = []

    def reserve(self, client: RtdeClient, names: tuple[str, ...]) -> bool:
        if any(self.owner.get(n, client) is not client for n in names):
            return False
        self.owner |= dict.fromkeys(names, client)
        return True

    def client(self) -> RtdeClient:
        return RtdeClient(VERSION, self.reserve, self.seen.append)


@pytest.fixture
def registry() -> Registry:
    return Registry()


def ask(client: RtdeClient, kind: str, body: bytes) -> bytes:
    answer = client.feed(packet(ord(kind), body))
    size, answered = HEADER.unpack_from(answer)
    assert (size, answered) == (len(answer), ord(kind))
    return answer[HEADER.size :]


def outputs(frequency: float, names: str) -> bytes:
    return struct.pack(">d", frequency) + names.encode()


def test_protocol_2_and_the_version_are_answered(registry: Registry) -> None:
    client = registry.client()
    assert ask(client, "V", struct.pack(">H", 2)) == b"\x01"
    assert ask(client, "V", struct.pack(">H", 1)) == b"\x00"
    assert struct.unpack(">4I", ask(client, "v", b"")) == VERSION


@pytest.mark.parametrize("comma", ["", ","], ids=["without", "with"])
def test_outputs_flow_at_the_frequency_asked_for_once_started(registry: Registry, comma: str) -> None:
    client = registry.client()
    assert ask(client, "O", outputs(125.0, "timestamp,actual_q,robot_mode" + comma)) == b"\x01DOUBLE,VECTOR6D,INT32"
    values = {"timestamp": 1.5, "actual_q": (1, 2, 3, 4, 5, 6), "robot_mode": 7}
    assert client.data(4, values) == b""
    assert ask(client, "S", b"") == b"\x01"
    got = [tick for tick in range(1, 17) if client.data(tick, values)]
    assert got == [4, 8, 12, 16]
    body = client.data(4, values)[HEADER.size :]
    assert body[0] == 1 and struct.unpack(">7di", body[1:]) == (1.5, 1, 2, 3, 4, 5, 6, 7)
    assert ask(client, "P", b"") == b"\x01"
    assert client.data(8, values) == b""


def test_an_unknown_output_is_named_and_nothing_starts(registry: Registry) -> None:
    client = registry.client()
    assert ask(client, "O", outputs(500.0, "timestamp,warp_factor")) == b"\x01DOUBLE,NOT_FOUND"
    assert ask(client, "S", b"") == b"\x00"
    assert client.data(1, {}) == b""


def test_recipes_are_numbered_in_order_and_decoded(registry: Registry) -> None:
    client = registry.client()
    assert ask(client, "I", b"input_int_register_0,") == b"\x01INT32"
    assert ask(client, "I", b"input_int_register_0,input_double_register_3") == b"\x02INT32,DOUBLE"
    assert client.feed(packet(ord("U"), b"\x02" + struct.pack(">id", 11, 0.5))) == b""
    assert registry.seen == [{"input_int_register_0": 11, "input_double_register_3": 0.5}]


def test_an_input_of_another_client_is_in_use_and_an_unknown_one_not_found(registry: Registry) -> None:
    first, second = registry.client(), registry.client()
    ask(first, "I", b"input_int_register_0")
    assert ask(second, "I", b"input_int_register_0") == b"\x00IN_USE"
    assert ask(second, "I", b"input_int_register_99") == b"\x00NOT_FOUND"
    assert ask(second, "I", b"input_int_register_1") == b"\x01INT32"


@pytest.mark.parametrize(
    "data",
    [
        struct.pack(">HB", 2, ord("V")),
        struct.pack(">HB", 5000, ord("V")),
        packet(ord("?"), b""),
        packet(ord("O"), b"short"),
        packet(ord("I"), b"\xff\xfe"),
        packet(ord("U"), b""),
        packet(ord("U"), b"\x09abc"),
    ],
    ids=["too small", "too large", "unknown", "no frequency", "no text", "empty data", "no such recipe"],
)
def test_what_is_no_rtde_ends_the_conversation(registry: Registry, data: bytes) -> None:
    with pytest.raises(ProtocolError):
        registry.client().feed(data)


def test_data_of_the_wrong_length_ends_the_conversation_and_writes_nothing(registry: Registry) -> None:
    client = registry.client()
    ask(client, "I", b"input_double_register_0")
    with pytest.raises(ProtocolError, match="length"):
        client.feed(packet(ord("U"), b"\x01" + b"\x00" * 7))
    assert registry.seen == []


def test_packets_may_arrive_in_any_pieces(registry: Registry) -> None:
    whole = packet(ord("V"), struct.pack(">H", 2)) + packet(ord("I"), b"input_int_register_0")
    at_once = registry.client().feed(whole)
    client = Registry().client()
    assert b"".join(client.feed(whole[i : i + 1]) for i in range(len(whole))) == at_once


def test_ten_thousand_malformed_packets_raise_nothing_else() -> None:
    rng = np.random.default_rng(0)
    kinds = b"VvMUOISP?\x00"
    refused = 0
    for _ in range(10_000):
        client = Registry().client()
        if rng.random() < 0.5:
            client.feed(packet(ord("I"), b"input_double_register_0,input_int_register_1"))
        body = rng.bytes(int(rng.integers(0, 40)))
        size = len(body) + 3 if rng.random() < 0.7 else int(rng.integers(0, 65536))
        try:
            client.feed(struct.pack(">HB", size, kinds[int(rng.integers(len(kinds)))]) + body)
        except ProtocolError:
            refused += 1
    assert refused > 1000


@given(st.lists(st.sampled_from(sorted(OUTPUTS)), min_size=1, max_size=12, unique=True))
def test_what_is_packed_is_unpacked_again(names: list[str]) -> None:
    types = tuple(OUTPUTS[n] for n in names)
    recipe = Recipe(tuple(names), types)
    values = {}
    for i, (name, kind) in enumerate(zip(names, types, strict=True)):
        count = LENGTHS.get(kind, 1)
        one = bool(i % 2) if kind == "BOOL" else (i + 0.5 if kind in ("DOUBLE", "VECTOR3D", "VECTOR6D") else i)
        values[name] = one if count == 1 else (one,) * count
    assert recipe.unpack(recipe.pack(values)) == values


def test_every_type_has_a_format() -> None:
    assert {*OUTPUTS.values(), *INPUTS.values()} <= set(FORMATS)
