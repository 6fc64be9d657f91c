"""One scene of this project as `DeviceEnv` takes scenes, so that it can be tried without a device."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sapien

from resync_robot.core.rig import Rig
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.sim_training.failed_worlds import CONTROL_PERIOD, RECOVERY_TORQUE
from resync_robot.sim_training.physics.scene import build_scene


class OneScene:
    """The first of the tasks, in numpy."""

    count = 1

    def __init__(self, tasks: Sequence[Task], block: Object, rig: Rig) -> None:
        self.tasks, self.block = tasks, block
        self._built = build_scene(tasks[0], rig, rendered=False)
        self._built.set_torque_limits(RECOVERY_TORQUE)
        self._last = self.joints[0]

    @property
    def joints(self) -> np.ndarray:
        return self._built.robot.qpos[self._built.arm_index].astype(np.float64)[None].copy()

    @property
    def blocks(self) -> np.ndarray:
        pose = self._built.rigid[self.block].entity_pose
        return np.concatenate([pose.p, pose.q])[None].astype(np.float64)

    def step(self, q: np.ndarray, opening: float = 0.0) -> None:
        self._built.approach(self._last, q[0], opening, CONTROL_PERIOD)
        self._last = q[0]

    def reset(self, resets: Sequence[tuple[int, int, np.ndarray, np.ndarray]]) -> None:
        for _, _, pose, q in resets:
            body = self._built.rigid[self.block]
            body.entity.set_pose(sapien.Pose(pose[:3], pose[3:]))
            body.linear_velocity = body.angular_velocity = np.zeros(3)
            body.wake_up()
            self._built.set_configuration(q, 0.0)
            self._last = q
            for _ in range(self._built.solver.steps(0.02)):
                self._built.scene.step()
