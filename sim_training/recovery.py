"""The recovery MDP: where episodes begin, what counts as recovered, and the reward. Batched torch on any device.

Success is a proxy for "Plan_f succeeds from here" (section 3.1 of the paper): the failed skill needs room for its
fingers. Training checks the proxy against the real skill on fresh worlds and reports how often it holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from resync_robot.core import spatial
from resync_robot.core.kinematics import WORK_BRANCH
from resync_robot.core.rig import Rig
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BOX as BOX_TYPE
from resync_robot.learning.recovery_policy import (
    BLOCK,
    BOX,
    COMMANDED,
    STUD,
    TIP,
    box_axes,
    tip_above_stud,
    up_axis,
    wall_gaps,
)


@dataclass(frozen=True, kw_only=True)
class RecoverySettings:
    """Lengths in m."""

    gap: float = 0.040
    """Free distance to both walls that counts as recovered."""
    lift: float = 0.05
    """Height of the tip over the stud at which the hand counts as out of the way."""
    upright: float = 0.98
    """Least z component of the block's own z axis."""
    tipped: float = 0.90
    """Below this the episode ends as a failure: a block on its side cannot be dragged upright again."""
    success_reward: float = 3.0
    step_cost: float = 0.01
    tipping_cost: float = 1.0
    gap_weight: float = 3.0
    excess_weight: float = 0.5
    """Further than needed is where other blocks may stand."""
    horizon: int = 80
    lag: float = 0.9
    """Most control steps that an arm may be behind its commands: streaming within jerk limits costs 30 to 90 ms."""


def lagging(command: Tensor, before: Tensor, lag: Tensor) -> Tensor:
    """(n, 3) where an arm that is (n,) `lag` control steps late is sent by the end of this one.

    Commands are ramps from one to the next; a late arm ends each step that share of the ramp behind.
    """
    return command - lag[:, None] * (command - before)


def is_free(x: Tensor, s: RecoverySettings) -> Tensor:
    """(n,) does the block stand upright on the box floor with room to both walls?"""
    standing = (x[:, BLOCK][:, 2] - x[:, BLOCK][:, 9] / 2 - x[:, BOX][:, 2]).abs() < 0.006
    return (wall_gaps(x).min(-1).values > s.gap) & (up_axis(x)[:, 2] > s.upright) & standing


def is_recovered(x: Tensor, previous: Tensor, s: RecoverySettings) -> Tensor:
    """(n,) free, at rest, and the hand out of the way."""
    at_rest = (x[:, BLOCK][:, :3] - previous[:, BLOCK][:, :3]).norm(dim=-1) < 0.001
    return is_free(x, s) & at_rest & (tip_above_stud(x) > s.lift)


def is_tipped(x: Tensor, s: RecoverySettings) -> Tensor:
    return up_axis(x)[:, 2] < s.tipped


def potential(x: Tensor, s: RecoverySettings) -> Tensor:
    """(n,) shaping: room to the walls but not too much, the hand on the stud until there is room, then away from it."""
    short = (s.gap + 0.003 - wall_gaps(x)) / s.gap
    missing = s.gap_weight * short.clamp(0, 1.2).mean(-1) + s.excess_weight * (-short - 0.3).clamp(0, 1).mean(-1)
    on_stud = x[:, BLOCK][:, :3].clone()
    on_stud[:, 2] += x[:, BLOCK][:, 9] / 2 + STUD
    distance = (x[:, TIP] - on_stud).norm(dim=-1)
    away = (tip_above_stud(x) / s.lift).clamp(0, 1)
    return -missing + torch.where(is_free(x, s), 0.2 + away, -torch.tanh(5 * distance))


def reward(x: Tensor, previous: Tensor, gamma: float, s: RecoverySettings) -> tuple[Tensor, Tensor, Tensor]:
    """Reward, success and failure of the steps `previous` -> `x`, each (n,)."""
    success, tipped = is_recovered(x, previous, s), is_tipped(x, s)
    shaped = gamma * potential(x, s) - potential(previous, s)
    return shaped + s.success_reward * success - s.step_cost - s.tipping_cost * tipped, success, tipped & ~success


def draw_starts(x: Tensor, random: torch.Generator) -> tuple[Tensor, Tensor]:
    """Where episodes begin: block positions (n, 2) and tip positions (n, 3) in the world.

    Near contact and near the goal as well as at the failure itself, so that success is found early.

    Args:
        x: (n, 27) projected failure states.
        random: a generator on the device of `x`.
    """
    n = len(x)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=random, device=x.device)

    kind = uniform(n)
    along_x, along_y = box_axes(x)
    centre, block = x[:, BOX][:, :2], x[:, BLOCK][:, :2]
    local = torch.stack([((block - centre) * along_x).sum(-1), ((block - centre) * along_y).sum(-1)], -1)
    inward = torch.zeros(n, 2, device=x.device)
    mid_gap, near_goal = (kind >= 0.60) & (kind < 0.85), kind >= 0.85
    inward[mid_gap] = 0.04 * uniform(int(mid_gap.sum()), 2)
    inward[near_goal] = 0.03 + 0.015 * uniform(int(near_goal.sum()), 2)
    local = local - torch.sign(local) * inward
    block = centre + local[:, :1] * along_x + local[:, 1:] * along_y
    top = x[:, BLOCK][:, 2] + x[:, BLOCK][:, 9] / 2 + STUD
    spread = torch.where(kind < 0.30, 0.02, 0.012)[:, None]
    planar = block + spread * (2 * uniform(n, 2) - 1)
    above = torch.where(kind < 0.30, 0.05 + 0.03 * uniform(n), 0.001 + 0.03 * uniform(n))
    return block, torch.cat([planar, (top + above)[:, None]], -1)


def draw_still(x: Tensor, random: torch.Generator) -> Tensor:
    """(n, 27) the states `x` with the block anywhere from its corner to the middle, and a hand at rest over it.

    A policy's own path hardly shows these: a block that is nearly free, and nobody touches it. Yet a deployed skill
    may begin there, and its terminal function must say whether anything is left to do.
    """
    n, still = len(x), x.clone()

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=random, device=x.device)

    along_x, along_y = box_axes(x)
    from_centre = x[:, BLOCK][:, :2] - x[:, BOX][:, :2]
    local = torch.stack([(from_centre * along_x).sum(-1), (from_centre * along_y).sum(-1)], -1) * uniform(n, 2)
    still[:, BLOCK.start : BLOCK.start + 2] = x[:, BOX][:, :2] + local[:, :1] * along_x + local[:, 1:] * along_y
    top = x[:, BLOCK][:, 2] + x[:, BLOCK][:, 9] / 2 + STUD
    planar = still[:, BLOCK][:, :2] + 0.03 * (2 * uniform(n, 2) - 1)
    still[:, TIP] = still[:, COMMANDED] = torch.cat([planar, (top + 0.10 * uniform(n))[:, None]], -1)
    return still


class FailedWorlds:
    """The worlds that a recovery is learned in, batched: where episodes begin, what the policy's state is made of,
    and the arm's way to a tip. Index `task` is a (k,) tensor of positions in `tasks` throughout.

    Args:
        tasks: failures, each as a task whose initial state fails.
        block: the object that the policy moves.
        xp: numpy for scenes that speak numpy (processes), torch for scenes whose tensors stay on a device.
        device: where states and random draws live.
    """

    def __init__(self, tasks: Sequence[Task], block: Object, rig: Rig, xp: Any, device: torch.device) -> None:
        self._xp, self.device = xp, device
        rows = [_failure_state(task, block) for task in tasks]
        yaws = np.array([_tool_yaw(row) for row in rows])
        down = spatial.rotation_about("z", yaws) @ spatial.rotation_about("x", np.pi)
        self.failures = torch.stack(rows).to(device)
        self._world_T_tip = self.array(spatial.transform(down))
        self._world_T_base = self.array(rig.arm.world_T_base)
        self._base_T_world = self.array(spatial.inverse(rig.arm.world_T_base))
        self._flange_T_tip = self.array(rig.gripper.flange_T_tip)
        self._tip_T_flange = self.array(spatial.inverse(rig.gripper.flange_T_tip))
        self._home, self._kinematics = self.array(rig.arm.home), rig.arm.kinematics

    def array(self, value: Any) -> Any:
        """`value` in double precision, as the scenes speak: a numpy array or a tensor on the device."""
        if self._xp is np:
            return np.asarray(value, dtype=np.float64)
        return torch.as_tensor(value, dtype=torch.float64, device=self.device)

    def index(self, which: Tensor) -> Any:
        """`which` as an index into the scenes' arrays."""
        return which.numpy() if self._xp is np else which

    def draw_starts(self, task: Tensor, random: torch.Generator) -> tuple[Any, Any, Tensor]:
        """Where episodes begin: (k, 7) block poses and (k, 6) joints as the scenes speak, (k, 3) tip positions."""
        failure = self.failures[task]
        block, tip = draw_starts(failure, random)
        poses = self.array(failure[:, BLOCK][:, :7])
        poses[:, :2] = self.array(block)
        return poses, self.joints_at(tip, task), tip

    def joints_at(self, tip: Tensor, task: Tensor) -> Any:
        """(k, 6) joints that put the tips at (k, 3), tool down and square to the box."""
        xp = self._xp
        world_T_tip = self._world_T_tip[self.index(task)]
        world_T_tip[:, :3, 3] = self.array(tip)
        base_T_flange = self._base_T_world @ world_T_tip @ self._tip_T_flange
        q = self._kinematics.inverse_branch(base_T_flange, WORK_BRANCH, xp)
        return q + 2 * np.pi * xp.round((self._home - q) / (2 * np.pi))

    def tip_at(self, joints: Any) -> Tensor:
        """(k, 3) tip positions at (k, 6) joints."""
        pose = self._world_T_base @ self._kinematics.forward(self.array(joints), self._xp) @ self._flange_T_tip
        return torch.as_tensor(pose[:, :3, 3], dtype=torch.float32)

    def states(self, joints: Any, blocks: Any, commanded: Tensor, task: Tensor) -> Tensor:
        """(k, 27) projected states from what the scenes measure: (k, 6) joints and (k, 7) block poses."""
        x = self.failures[task]
        x[:, TIP], x[:, COMMANDED] = self.tip_at(joints), commanded
        x[:, BLOCK.start : BLOCK.start + 7] = torch.as_tensor(blocks, dtype=torch.float32)
        return x


def _failure_state(task: Task, block: Object) -> Tensor:
    """(27,) the projected failure, its tip left open."""
    box = next(o for o in task.objects if o.type == BOX_TYPE)
    return torch.as_tensor(np.concatenate([np.zeros(6), task.initial[block], task.initial[box]]), dtype=torch.float32)


def _tool_yaw(failure: Tensor) -> float:
    w, z = float(failure[BOX][3]), float(failure[BOX][6])
    return float(spatial.wrap(2 * np.arctan2(z, w), np.pi / 2))
