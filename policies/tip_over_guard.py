"""Feeling through the hand that what it presses on gives way.

A block that is narrow, high and rough tips over rather than slides, within two tenths of a second. As it begins to
lean it lifts the hand that presses on it, by millimetres that the joints tell at once, where no picture would show it
in time. Let go then, it falls back on its feet, a centimetre further on. A hand also rises as it presses less: pads and
fingers yield by millimetres. But what leans pushes the hand up against the arm, and is felt. A hand that sinks beneath
the block's upper face has slid off it. And a hand that is done pressing goes straight up: drawn sideways as the
pressure fades, it would take the block's top along.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from resync_robot.core.joints import JointTarget
from resync_robot.core.world import ArmObservation
from resync_robot.learning.recovery_policy import STUD
from resync_robot.policies.cartesian import GIVE_IN_STEP, Hand

PRESSED = 0.005
"""m that the hand is sent beneath where it stands: then it rests on something."""
FELT = 50.0
"""N that a block which leans pushes with at least. An arm that drags presses with what its effort limit allows, 60 to
120 N; one that yields to an impact, as a UR7e does, presses with less and less, and its hand rises by as much."""
RISE, RISE_STEPS = 0.002, 3
"""m above the lowest that it stood since it has pressed, for so many control steps: a hand that has struck wobbles by
as much, but not for as long. Dragging a block that stands lifts the hand by less."""
LIFTED = 0.0007
"""m above that lowest at which a block that gives way a moment later has begun to lean: from there on it turned about
its lower edge, and did not come along."""
ABOVE = 0.001
"""m above the stud at which no hand rests that presses, unless the block leans."""
LET_GO_RISE = 0.03
"""m that the hand goes up from a block that leans; pushing it over takes half a metre a second for a tenth of one."""
LET_GO_STEPS, WAIT_STEPS = 5, 10
"""Control steps up, and for the block to fall back."""
BENEATH = 0.004
"""m beneath the block's upper face at which the tip is beside the block."""


@dataclass
class TipOverGuard:
    """Whether what the hand presses on lifts it, or is not beneath it any more.

    Attributes:
        top: height of the block's upper face, its stud not counted, m; NaN where nobody measured it.
        stood_at: (3,) m, the tip where it pressed last before it was lifted; None where it has not pressed.
        sank_at: (3,) m, the tip where it is beneath the block's upper face; None where it is not.
    """

    top: float = np.nan
    stood_at: Float[np.ndarray, "3"] | None = field(default=None, init=False)
    sank_at: Float[np.ndarray, "3"] | None = field(default=None, init=False)
    _lowest: float = field(default=np.inf, init=False)
    _risen: int = field(default=0, init=False)

    def gives_way(self, tip: Float[np.ndarray, "3"], sent_z: float, force: float) -> bool:
        """Look at one control step.

        Args:
            tip: as measured, m.
            sent_z: height where it was sent, m.
            force: that pushes the tip up, N.
        """
        tip_z = float(tip[2])
        self.sank_at = tip if tip_z < self.top - BENEATH else None
        if self.sank_at is not None:
            return True
        if sent_z > tip_z - PRESSED:
            self._lowest, self._risen, self.stood_at = np.inf, 0, None
            return False
        self._lowest = min(self._lowest, tip_z)
        if tip_z < self._lowest + LIFTED:
            self.stood_at = tip
        if force < FELT:
            self._risen = 0
            return False
        self._risen = self._risen + 1 if tip_z > self._lowest + RISE else 0
        stud = self.top + STUD
        return (self._lowest < stud and tip_z > stud + ABOVE) or self._risen >= RISE_STEPS


def press_on(
    hand: Hand, goal: Float[np.ndarray, "3"], steps: int, guard: TipOverGuard
) -> Generator[JointTarget, ArmObservation, bool]:
    """Send the tip to `goal` in so many control steps; straight up where it goes up from what it presses on, and where
    that gives way.

    Returns:
        Whether the way was gone to its end. If not, the hand has let go.
    """
    begin, tip = hand.position.copy(), hand.tip()
    # One that only presses less goes on dragging.
    if begin[2] < tip[2] - PRESSED < goal[2]:
        behind = tip[:2] - begin[:2]
        share = min(1.0, GIVE_IN_STEP * steps / max(float(np.linalg.norm(behind)), 1e-9))
        goal = np.array([*(begin[:2] + share * behind), goal[2]])
    for i in range(1, steps + 1):
        hand.position = begin + (goal - begin) * i / steps
        hand.last = yield hand.target()
        if guard.gives_way(hand.tip(), hand.position[2], float(hand.last.tip_force[2])):
            break
    else:
        return True
    begin, goal = hand.position.copy(), hand.tip() + [0.0, 0.0, LET_GO_RISE]
    # From far beneath where it stands, and from far ahead of it, it takes more steps: an arm is not to jump.
    up = max(LET_GO_STEPS, int(np.ceil(np.linalg.norm(goal - begin) / GIVE_IN_STEP)))
    for i in range(1, up + WAIT_STEPS + 1):
        hand.position = begin + (goal - begin) * min(1.0, i / up)
        hand.last = yield hand.target()
    return False
