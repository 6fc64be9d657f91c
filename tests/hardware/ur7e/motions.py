"""A motion to disturb, and what to look at afterwards."""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig
from resync_robot.hardware.base import Recorder, RobotError
from resync_robot.hardware.emulator.server import Emulator
from resync_robot.hardware.stream import Stream
from resync_robot.hardware.ur7e import Ur7e


def swing(stream: Stream, rig: Rig, seconds: float, begin: float = 0.0) -> None:
    """Move the first joint to and fro, at up to 0.4 rad/s, as from `begin` s of that motion on."""
    for k in range(round(begin / 0.02), round((begin + seconds) / 0.02)):
        q = rig.arm.home.copy()
        q[0] += 0.2 * np.sin(2 * k * 0.02)
        stream.run(JointTarget(q, 0.1), 0.02)


def during_motion(
    robot: Ur7e, rig: Rig, happen: Callable[[], object], recorders: Sequence[Recorder] = ()
) -> BaseException:
    """What a motion ends with when `happen` happens in the midst of it."""
    stream = Stream(robot, rig, recorders=list(recorders))
    swing(stream, rig, 0.5)
    timer = threading.Timer(0.1, happen)
    timer.start()
    try:
        with pytest.raises(RobotError) as caught:
            swing(stream, rig, 8.0, begin=0.5)
    finally:
        timer.join()
    return caught.value


def link_of(robot: Ur7e) -> subprocess.Popen[bytes]:
    assert robot._link is not None
    return robot._link.process


def is_still(machine: Emulator) -> bool:
    return bool(np.abs(machine.controller.velocity).max() < 1e-9)


def wait_for(condition: Callable[[], bool], seconds: float = 5.0) -> bool:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.01)
    return condition()
