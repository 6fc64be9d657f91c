"""The gripper's registers, tick by tick, and its socket's words."""

from __future__ import annotations

import pytest

from resync_robot.core.machines import GRIPPERS, GripperModel
from resync_robot.hardware.base import SERVO_PERIOD
from resync_robot.hardware.emulator.gripper import CLOSED_COUNT, OPEN_COUNT, EmulatedGripper, GripperClient


@pytest.fixture
def gripper() -> EmulatedGripper:
    return EmulatedGripper(0.1, activated=True)


@pytest.fixture
def client(gripper: EmulatedGripper) -> GripperClient:
    return GripperClient(gripper)


def run(gripper: EmulatedGripper, seconds: float, object_width: float = 0.0) -> float:
    """Tick with pads that follow exactly, but close no further than the object; the last opening."""
    opening = gripper.measured
    for _ in range(round(seconds / SERVO_PERIOD)):
        opening = max(gripper.tick(opening), object_width)
    return opening


@pytest.mark.parametrize("model", GRIPPERS.values(), ids=GRIPPERS)
def test_counts_and_openings_are_inverse(model: GripperModel) -> None:
    gripper, counts = EmulatedGripper(model=model), range(OPEN_COUNT, CLOSED_COUNT + 1)
    assert [gripper.opening_of(OPEN_COUNT), gripper.opening_of(CLOSED_COUNT)] == [model.stroke, 0.0]
    assert [gripper.count_of(gripper.opening_of(c)) for c in counts] == [*counts]


@pytest.mark.parametrize("model", GRIPPERS.values(), ids=GRIPPERS)
def test_it_moves_at_the_speed_of_its_model(model: GripperModel) -> None:
    for spe, speed in ((0, model.speed[0]), (255, model.speed[1])):
        gripper = EmulatedGripper(model.stroke, activated=True, model=model)
        gripper.set("SPE", spe)
        gripper.set("POS", 255)
        assert model.stroke - run(gripper, 0.2) == pytest.approx(0.2 * speed)


def test_it_has_to_be_activated() -> None:
    gripper = EmulatedGripper(0.1)
    client = GripperClient(gripper)
    client.feed(b"SET POS 255 GTO 1\n")
    assert run(gripper, 1.0) == 0.1
    assert client.feed(b"SET ACT 1\n") == b"ack"
    assert client.feed(b"GET STA\n") == b"STA 1\n"
    run(gripper, 1.0)
    assert client.feed(b"GET STA\n") == b"STA 3\n"


def test_it_closes_at_its_speed_and_reports_its_arrival(gripper: EmulatedGripper, client: GripperClient) -> None:
    assert client.feed(b"SET POS 255 SPE 0 FOR 50 GTO 1\n") == b"ack"
    assert client.feed(b"GET PRE\n") == b"PRE 255\n"
    assert client.feed(b"GET OBJ\n") == b"OBJ 0\n"
    assert run(gripper, 1.0) == pytest.approx(0.07, abs=1e-3)
    run(gripper, 3.0)
    assert client.feed(b"GET OBJ\nGET POS\n") == b"OBJ 3\nPOS 230\n"


def test_an_object_stops_it_and_a_lost_one_shows(gripper: EmulatedGripper, client: GripperClient) -> None:
    client.feed(b"SET POS 255 SPE 255 GTO 1\n")
    assert run(gripper, 2.0, object_width=0.06) == 0.06
    assert client.feed(b"GET OBJ\n") == b"OBJ 2\n"
    assert run(gripper, 1.0) == 0.0
    assert client.feed(b"GET OBJ\n") == b"OBJ 3\n"


def test_a_fault_holds_it_and_an_emergency_stop_silences_it(gripper: EmulatedGripper, client: GripperClient) -> None:
    gripper.fault = 0xE
    client.feed(b"SET POS 255\n")
    assert run(gripper, 1.0) == 0.1
    assert client.feed(b"GET FLT\n") == b"FLT 14\n"
    gripper.silent = True
    assert client.feed(b"GET POS\n") == b"?\n"
