"""The simulated arm as a ManiSkill agent: built by `scene`, driven by joint targets. See `maniskill_env`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sapien
import torch
from gymnasium import spaces
from mani_skill.agents.base_agent import BaseAgent
from mani_skill.agents.controllers.base_controller import BaseController, ControllerConfig
from mani_skill.agents.registration import register_agent
from mani_skill.utils.structs import Articulation, Pose
from torch import Tensor

from resync_robot.core.joints import ARM_JOINTS
from resync_robot.core.rig import load_rig
from resync_robot.sim_training.failed_worlds import RECOVERY_TORQUE
from resync_robot.sim_training.physics.scene import FINGER_JOINTS, TARGET_PERIOD, BuiltScene, add_robot, urdf_path
from resync_robot.sim_training.physics.solver import solver_of

_PARKED = 1.0
"""m over its place at which the arm is built: ManiSkill asks that nothing overlaps while the GPU starts up."""


class JointTargetController(BaseController):
    """Arm joints and finger opening, (n, 7), approached in even increments over a control step.

    ManiSkill's own interpolation starts from the measured joints, which gives way under a press, and its increments do
    not reach a GPU simulation.
    """

    sets_target_qpos = True
    sets_target_qvel = False
    starting: Tensor | None = None
    """(n,) environments that the reset under way begins anew."""
    _goal: Tensor | None = None

    def _initialize_action_space(self) -> None:
        low, high = self.articulation.get_qlimits()[0, self.active_joint_indices].cpu().numpy().T
        opening = len(ARM_JOINTS)
        self.single_action_space = spaces.Box(
            np.append(low[:opening], 0.0).astype(np.float32),
            np.append(high[:opening], high[opening:].sum()).astype(np.float32),
        )

    def set_drive_property(self) -> None:
        """Gains and torque limits were drawn with each world; `Ur7e2f140` sets them when it builds the arm."""

    def reset(self) -> None:
        if self._goal is None or self.starting is None:
            self._goal = self.qpos.clone()
        else:
            # The others hold what they were driven to: going to where they are would release a press.
            self._goal = torch.where(self.starting[:, None], self.qpos, self._goal)
        self._begin, self._step = self._goal, self._sim_steps
        self._send(self._goal)

    def set_action(self, action: Tensor) -> None:
        action = self._preprocess_action(action)
        arm, finger = action[:, : len(ARM_JOINTS)], action[:, len(ARM_JOINTS) :] / len(FINGER_JOINTS)
        self._begin, self._step = self._goal, 0
        self._goal = torch.cat([arm, *[finger] * len(FINGER_JOINTS)], -1)

    def before_simulation_step(self) -> None:
        every = max(1, round(TARGET_PERIOD / self.scene.timestep))
        if self._step % every == 0 and self._step < self._sim_steps:
            share = min(1.0, (self._step + every) / self._sim_steps)
            self._send(self._begin + (self._goal - self._begin) * share)
        self._step += 1

    def _send(self, targets: Tensor) -> None:
        self.articulation.set_joint_drive_targets(targets, self.joints, self.active_joint_indices)
        if self.scene.gpu_sim_enabled:
            self.scene.px.gpu_apply_articulation_target_position()


@dataclass
class JointTargetConfig(ControllerConfig):
    controller_cls = JointTargetController


@register_agent()
class Ur7e2f140(BaseAgent):
    """The simulated arm of `scene`, with the lower torque limits under which a recovery is learned.

    Args:
        physics: what was drawn for each parallel world (`Task.physics`); left out: one nominal set for all.
    """

    uid = "ur7e_2f140"
    urdf_path = urdf_path()

    def __init__(self, *args: Any, physics: Sequence[Mapping[str, Any]] | None = None, **kwargs: Any) -> None:
        self._physics = physics
        self._rig = load_rig()
        super().__init__(*args, **kwargs)

    def _load_articulation(self, initial_pose: Any = None) -> None:
        base = self._rig.arm.world_T_base.copy()
        self.base = Pose.create(sapien.Pose(base), device=self.scene.device)
        base[2, 3] += _PARKED
        rig = replace(self._rig, arm=replace(self._rig.arm, world_T_base=base))
        arms = []
        for i, scene in enumerate(self.scene.sub_scenes):
            physics = {"friction_pad": 1.15, "pad_stiffness": 1e4} if self._physics is None else self._physics[i]
            arm = add_robot(scene, rig, physics, self.scene.can_render())
            built = BuiltScene(scene, arm, {}, {}, float(physics.get("gain", 1.0)), solver_of(physics))
            built.set_torque_limits(RECOVERY_TORQUE)
            # ManiSkill finds the name that all parallel copies share by cutting off this prefix.
            arm.name = f"scene-{i}_{self.uid}"
            for part in (*arm.links, *arm.joints):
                part.name = f"scene-{i}-{self.uid}_{part.name}"
            arms.append(arm)
        everyone = torch.arange(len(arms), dtype=torch.int)
        self.robot = Articulation.create_from_physx_articulations(arms, self.scene, everyone)
        self.robot.initial_pose = Pose.create(sapien.Pose(base), device=self.scene.device)
        self.robot.name = self.uid
        self.scene.articulations[self.uid] = self.robot
        self.scene.add_to_state_dict_registry(self.robot)
        self.robot_link_names = [link.name for link in self.robot.get_links()]
        order = [joint.name for joint in self.robot.active_joints]
        self.arm_index = torch.tensor([order.index(n) for n in ARM_JOINTS], device=self.scene.device)

    def reset(self, init_qpos: Tensor | None = None) -> None:
        super().reset(init_qpos)
        # By the time ManiSkill resets the controller, it has forgotten which environments it resets.
        self.controller.starting = self.scene._reset_mask.clone()

    @property
    def _controller_configs(self) -> dict[str, ControllerConfig]:
        return {"joint_target": JointTargetConfig([*ARM_JOINTS, *FINGER_JOINTS])}
