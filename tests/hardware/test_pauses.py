"""A program that stood still knows it, whoever asks first."""

from __future__ import annotations

import math

import pytest

from resync_robot.hardware import pauses as module
from resync_robot.hardware.pauses import BLAME_S, PAUSE_S, Pauses, blaming_a_pause


class Clock:
    """Stands where it is set, so that the beats in the background see no pause of their own."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_without_a_pause_nothing_is_blamed(clock: Clock) -> None:
    pauses = Pauses(clock)
    clock.now += 0.9 * PAUSE_S
    assert (pauses.lately(), pauses.since()) == (0.0, math.inf)


def test_a_pause_is_known_to_whoever_asks_first_and_forgotten_after_a_while(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    pauses = Pauses(clock)
    monkeypatch.setattr(module, "pauses", lambda: pauses)
    clock.now += 60.0
    assert pauses.lately() == 60.0 and pauses.since() == 0.0
    what, fix = blaming_a_pause("the controller has said nothing", "check the cable")
    assert what.startswith("this program stood still for 60.0 s") and what.endswith("the controller has said nothing")
    assert "cable" not in fix and "awake" in fix
    for _ in range(math.ceil(BLAME_S / 0.5)):
        clock.now += 0.5
        pauses.since()
    assert pauses.lately() == 0.0
    assert blaming_a_pause("it is gone", "check the cable") == ("it is gone", "check the cable")
