"""A machine that stood still excuses a test that was late, and nothing else."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from resync_robot.core.errors import MotionError
from resync_robot.core.rig import load_rig
from tests import conftest
from tests.hardware.adversary import assert_nothing_out_of_limits
from tests.stalls import LimitBrokenError


def outcome(error: BaseException, marked: bool = True) -> type[BaseException]:
    """What a test ends with that fails with `error`."""
    item: Any = SimpleNamespace(get_closest_marker=lambda name: marked or None)
    call = conftest.pytest_runtest_call(item)
    next(call)
    with pytest.raises(BaseException) as caught:
        call.throw(error)
    return caught.type


def test_lateness_is_excused_where_the_machine_stood_still(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conftest, "MOST_S", -1.0)
    assert outcome(AssertionError("too late")) is pytest.skip.Exception
    assert outcome(AssertionError("too late"), marked=False) is AssertionError
    monkeypatch.setattr(conftest, "MOST_S", 60.0)
    assert outcome(AssertionError("too late")) is AssertionError


def test_a_broken_limit_is_never_excused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conftest, "MOST_S", -1.0)
    rig = load_rig()
    with pytest.raises(LimitBrokenError) as caught:
        assert_nothing_out_of_limits([rig.arm.home, rig.arm.home + 0.5], rig)
    assert outcome(caught.value) is LimitBrokenError
    assert outcome(MotionError("no way there")) is MotionError
    assert_nothing_out_of_limits([rig.arm.home] * 3, rig)
