"""A press on springs through the real client: what the emulated machine is sent, and what it feels."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core.joints import JointTarget
from resync_robot.hardware.emulator.arm import KinematicArm, Measured
from resync_robot.hardware.robotiq import Robotiq
from resync_robot.hardware.stream import Stream
from resync_robot.hardware.ur7e import Ur7e
from tests import emulators
from tests.hardware.adversary import assert_nothing_out_of_limits
from tests.hardware.test_yielding import AHEAD, LIMIT, RIG, TOUCH, lowered

pytestmark = pytest.mark.realtime
STIFFNESS = 2e4
"""N/m; AHEAD of it would be 700 N."""


class OnSprings(KinematicArm):
    """Whose tip meets springs TOUCH below home."""

    def __init__(self) -> None:
        super().__init__(RIG.arm.home)
        self.surface = RIG.tip_pose(RIG.arm.home)[2, 3] - TOUCH
        self.forces: list[float] = []

    def measure(self) -> Measured:
        self.force[2] = STIFFNESS * max(0.0, self.surface - RIG.tip_pose(self.q)[2, 3])
        return super().measure()

    def tick(self, q: np.ndarray, opening: float) -> None:
        super().tick(q, opening)
        self.forces.append(float(self.force[2]))


def test_a_press_beyond_the_limit_stays_at_it_and_goes_on_from_where_it_yielded_to() -> None:
    emulators.need_client()
    arm = OnSprings()
    with emulators.emulated() as machine:
        machine.call(lambda: machine.controller.install(arm))
        rig = emulators.rig_at(machine.address, force_limit=300.0)
        with Ur7e(rig, Robotiq(machine.address)) as robot:
            stream = Stream(robot, rig)
            stream.limit_effort(tuple(LIMIT))
            for q in lowered(np.linspace(0.0, TOUCH + AHEAD, 15)):
                stream.run(JointTarget(q, 0.1), 0.1)
            for _ in range(20):
                stream.run(stream.target, 0.1)
            asked, held = stream.target.arm, arm.forces[-500:]
            stream.limit_effort(None)
            yielded = stream.target.arm
            for q in lowered(np.array([TOUCH, TOUCH / 2, 0.0])):
                stream.run(JointTarget(q, 0.1), 0.5, travel=True)
            assert stream.settle()
            wire = [q for _, q in machine.controller.wire or []]
    assert_nothing_out_of_limits(wire, rig)
    allowed = (LIMIT[1:5] / np.abs(rig.tip_jacobian(asked)[2, 1:5])).min()
    assert np.mean(held) == pytest.approx(allowed, rel=0.15)
    assert max(arm.forces) < 1.5 * allowed < STIFFNESS * AHEAD / 4
    assert np.abs(yielded - asked).max() > 0.02
    np.testing.assert_allclose(wire[-1], rig.arm.home, atol=1e-4)
    assert arm.forces[-1] == 0.0
