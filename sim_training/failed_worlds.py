"""Worlds in which a block is stuck, batched: what a recovery's state is made of, and the arm's way to a tip.

Numpy for one scene in a process, torch for thousands on a device.
"""

from __future__ import annotations

from collections.abc import Sequence
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
from resync_robot.learning.recovery_policy import BLOCK, BOX, COMMANDED, TIP

CONTROL_PERIOD = 0.1
"""s of one control step of the recovery policy."""
RECOVERY_TORQUE = (40.0, 40.0, 40.0, 12.0, 12.0, 12.0)
"""N m while a learned skill runs: without the cap a policy learns to flick the block with 200 N."""


def lagging(command: Tensor, before: Tensor, lag: Tensor) -> Tensor:
    """(n, 3) where an arm that is (n,) `lag` control steps late is sent by the end of this one.

    Commands are ramps from one to the next; a late arm ends each step that share of the ramp behind.
    """
    return command - lag[:, None] * (command - before)


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
        if isinstance(value, np.ndarray) and not value.flags.writeable:
            value = value.copy()
        return torch.as_tensor(value, dtype=torch.float64, device=self.device)

    def index(self, which: Tensor) -> Any:
        """`which` as an index into the scenes' arrays."""
        return which.numpy() if self._xp is np else which

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
