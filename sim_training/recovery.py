"""The recovery MDP: where episodes begin, what counts as recovered, and the reward. Batched torch on any device.

Success is a proxy for "Plan_f succeeds from here" (section 3.1 of the paper): the failed skill needs room for its
fingers. Training checks the proxy against the real skill on fresh worlds and reports how often it holds.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from resync_robot.learning.recovery_policy import BLOCK, BOX, STUD, TIP, box_axes, tip_above_stud, up_axis, wall_gaps


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
    horizon: int = 80


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
    """(n,) shaping: room to the walls, then the hand on the stud while there is none, away from it once there is."""
    deficit = ((s.gap + 0.003 - wall_gaps(x)) / s.gap).clamp(0, 1.2).mean(-1)
    on_stud = x[:, BLOCK][:, :3].clone()
    on_stud[:, 2] += x[:, BLOCK][:, 9] / 2 + STUD
    distance = (x[:, TIP] - on_stud).norm(dim=-1)
    away = (tip_above_stud(x) / s.lift).clamp(0, 1)
    return -s.gap_weight * deficit + torch.where(is_free(x, s), 0.2 + away, -torch.tanh(5 * distance))


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
    """
    n = len(x)
    kind = torch.rand(n, generator=random)
    along_x, along_y = box_axes(x)
    centre, block = x[:, BOX][:, :2], x[:, BLOCK][:, :2]
    local = torch.stack([((block - centre) * along_x).sum(-1), ((block - centre) * along_y).sum(-1)], -1)
    inward = torch.zeros(n, 2)
    mid_gap, near_goal = (kind >= 0.60) & (kind < 0.85), kind >= 0.85
    inward[mid_gap] = 0.04 * torch.rand(int(mid_gap.sum()), 2, generator=random)
    inward[near_goal] = 0.03 + 0.015 * torch.rand(int(near_goal.sum()), 2, generator=random)
    local = local - torch.sign(local) * inward
    block = centre + local[:, :1] * along_x + local[:, 1:] * along_y
    top = x[:, BLOCK][:, 2] + x[:, BLOCK][:, 9] / 2 + STUD
    spread = torch.where(kind < 0.30, 0.02, 0.012)[:, None]
    planar = block + spread * (2 * torch.rand(n, 2, generator=random) - 1)
    above = torch.where(
        kind < 0.30, 0.05 + 0.03 * torch.rand(n, generator=random), 0.001 + 0.03 * torch.rand(n, generator=random)
    )
    return block, torch.cat([planar, (top + above)[:, None]], -1)
