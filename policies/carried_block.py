"""Where a block can be that a hand has pressed on since a scan saw it.

A scan knows a block to a millimetre, and nothing but the hand moves it: it went along with the hand at most. Pictures
on the way know it to a few millimetres, but in a world that looks like no other they may take a cornered block for a
free one. What they cannot be right about is not believed. The policy that knows the exact state then acts on the block
as it would be had it come along. Where the hand then sinks into the place of that block, or stands beside a stud that
should bear it, the block is not there, and pictures are right after all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from resync_robot.core import spatial
from resync_robot.core.library import Record
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.learning.camera_view import GAPS, Prediction
from resync_robot.learning.carried import Carried
from resync_robot.learning.recovery_policy import STUD, commanded_tip, observe, project, wall_gaps
from resync_robot.policies.state_recovery import how_sure, recovery_nets, sure_enough
from resync_robot.policies.tip_over_guard import BENEATH

BEYOND = 0.015
"""m by which pictures may put the block, or a wall of its box, further away than the hand can have taken it: rarely are
they that wrong in worlds like those of training."""
INSIDE = 0.010
"""m inside the block's edges from which on tips that sink have not slid off it: where it stands is known as well."""
OVER_STUD = 0.010
"""m from a stud's middle within which closed fingers rest on it, and not beside it on the block."""


@dataclass(frozen=True)
class ByState:
    """The recovery that knows the exact state: (n, 19) observations -> (n, 3) actions, and (n,) how likely it is done.
    It is from the probability `sure` on."""

    act: Callable[[Tensor], Tensor]
    done: Callable[[Tensor], Tensor]
    sure: float = 0.5

    @staticmethod
    def of(record: Record) -> ByState:
        """That of a library's record. Raises LibraryError on a broken one."""
        net, done = recovery_nets(record)
        return ByState(net.act, done.probability, how_sure(record))


@dataclass
class CarriedBlock:
    """The block of one attempt, as the scan before it saw it.

    Attributes:
        state: what the scan saw; world frame, m.
        objects: robot, block and box.
        carried: how far the hand can have taken it.
        elsewhere: the hand has been where it would be by that, so it is not there.
    """

    state: State
    objects: tuple[Object, Object, Object]
    carried: Carried = field(init=False)
    elsewhere: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        z, height = self.state.get(self.objects[1], "z", "size_z")
        self.carried = Carried(z + height / 2 + STUD)

    def sank(self, tip: Float[np.ndarray, "3"]) -> None:
        """The tips are at (3,), m: lower than the block, or its stud, would bear them where it would be by the scan and
        the hand, they show that it is elsewhere."""
        pose = spatial.pose_from_features(self.state[self.objects[1]][:7])
        pose[:2, 3] += self.carried.away
        half = self.state.get(self.objects[1], "size_x", "size_y") / 2
        beside = np.abs((spatial.inverse(pose) @ np.append(tip, 1.0))[:2])
        stud, face = self.carried.top, self.carried.top - STUD
        beneath_stud = tip[2] < stud - STUD / 2 and (beside < OVER_STUD).all()
        beneath_face = tip[2] < face - BENEATH and (beside < half - INSIDE).all()
        self.elsewhere |= bool(beneath_stud or beneath_face)

    def projected(self, tip: np.ndarray, sent: np.ndarray) -> Tensor:
        """(1, 27) as `recovery_policy.project`, with the block as far along as it can be."""
        robot, block, box = self.objects
        x, y = self.state.get(block, "x", "y") + self.carried.away
        there = self.state.with_features(block, x=x, y=y)
        return project(there.with_features(robot, x=tip[0], y=tip[1], z=tip[2]), robot, block, box, sent)

    def refutes(self, said: Prediction, tip: np.ndarray) -> bool:
        """Whether a policy sees a wall further away than it can be."""
        if self.elsewhere:
            return False
        gaps = wall_gaps(self.projected(tip, tip))[0].numpy()
        return bool((said.block[0, GAPS] > gaps + BEYOND).any())

    def plausible(self, seen: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
        """The place of the block by pictures, m, world frame; where it cannot have got there, that by the scan and the
        hand."""
        place = self.state.get(self.objects[1], "x", "y") + self.carried.away
        return seen if self.elsewhere or np.linalg.norm(seen - place) < BEYOND else place

    def step(self, policy: ByState, tip: np.ndarray, sent: np.ndarray) -> np.ndarray | None:
        """(3,) where the policy that knows the state sends the tip; None where it holds itself for done."""
        x = self.projected(tip, sent)
        with torch.no_grad():
            seen = observe(x)
            if float(policy.done(seen)) > sure_enough(policy.sure, self.carried.away):
                return None
            return commanded_tip(x, policy.act(seen))[0].double().numpy()
