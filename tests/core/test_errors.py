"""Errors say what happened and what to do next, here and across processes."""

import copy

import pytest

from resync_robot.core.errors import LibraryError, ResyncError, UnknownNameError
from resync_robot.hardware.base import SafetyError


def test_a_message_ends_with_what_to_do() -> None:
    assert str(LibraryError("it is torn", "train again")) == "it is torn\n  -> train again"
    assert str(LibraryError("it is torn")) == "it is torn"


def test_an_unknown_name_lists_the_valid_ones() -> None:
    assert str(UnknownNameError("scenario", "s9", ["s1", "s0"])) == "unknown scenario 's9'\n  -> valid: s0, s1"
    assert "(none)" in str(UnknownNameError("scenario", "s9", []))
    assert "unknown camera 'back' in rig.toml\n" in str(UnknownNameError("camera", "back", [], "rig.toml"))


@pytest.mark.parametrize(
    "error",
    [
        LibraryError("it is torn", "train again"),
        UnknownNameError("scenario", "s9", ["s0"]),
        SafetyError("velocity", "elbow_joint", 9.0, 3.0, "too fast", "slow down"),
    ],
)
def test_an_error_of_a_worker_process_arrives_as_it_was_raised(error: ResyncError) -> None:
    back = copy.copy(error)  # by the same road as pickle
    assert type(back) is type(error)
    assert (str(back), vars(back)) == (str(error), vars(error))
