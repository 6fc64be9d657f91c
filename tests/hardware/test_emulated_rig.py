"""The rig of the emulated lab is the simulated rig with a controller."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from resync_robot.core.rig import Rig, load_rig
from tests.emulators import RIG_FILE


def plain(rig: Rig) -> list[str]:
    """Everything but what may differ, as text that can be compared."""
    cameras = tuple(replace(c, serial="") for c in rig.cameras)
    with np.printoptions(precision=12):
        return [repr(part) for part in (rig.arm, rig.gripper, *cameras)]


def test_only_the_controller_and_the_serial_numbers_differ() -> None:
    emulated, simulated = load_rig(RIG_FILE), load_rig()
    assert plain(emulated) == plain(simulated)
    assert simulated.controller is None
    assert emulated.controller is not None and emulated.controller.emulated
