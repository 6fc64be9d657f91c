"""Cornered Insertion-S as a ManiSkill environment, so that a GPU steps thousands of failed worlds at once.

The bodies come from `scene`, states and actions from `failed_worlds` and `recovery_policy`: this file only puts them
where ManiSkill expects them. When a recovery is done nobody wrote down: the planner's verdicts taught it, so the
environment has its success from beta_N of a library, and no other reward. Every parallel environment is built from a
task of its own, so sizes, friction, masses and gains differ between them; they stay as built, since ManiSkill cannot
rebuild one of many.

    import gymnasium
    import resync_robot.sim_training.domains.cornered_insertion_s.maniskill_env  # registers the environment
    env = gymnasium.make("ResyncCorneredInsertionS-v1", num_envs=1, sim_backend="physx_cpu")

`sim_backend="physx_cuda"` is written for, and follows what ManiSkill documents, but has not been run on a GPU yet: the
tests drive the CPU back end, which ManiSkill limits to one environment a process.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import sapien
import torch
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.utils import common
from mani_skill.utils.registration import register_env
from mani_skill.utils.structs import Actor, Pose
from mani_skill.utils.structs.types import GPUMemoryConfig, SceneConfig, SimConfig
from torch import Tensor

from resync_robot.core.errors import TrainingError
from resync_robot.core.library import Record, load_library
from resync_robot.core.rig import Rig, load_rig
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK, BOX
from resync_robot.learning import recovery_policy as view
from resync_robot.learning.terminals import Terminal
from resync_robot.sim_training.domains.cornered_insertion_s.domain import CORNERED_INSERTION_S
from resync_robot.sim_training.domains.cornered_insertion_s.maniskill_robot import Ur7e2f140
from resync_robot.sim_training.failed_worlds import CONTROL_PERIOD, FailedWorlds
from resync_robot.sim_training.physics.bodies import add_block, add_box, add_table
from resync_robot.sim_training.physics.solver import SHIPPED, solver_of

ENVIRONMENT = "ResyncCorneredInsertionS-v1"


@register_env(ENVIRONMENT, max_episode_steps=CORNERED_INSERTION_S.stages[0].horizon)
class CorneredInsertionEnv(BaseEnv):
    """The recovery MDP of a cornered block: 10 Hz, 3-D tip motions in [-1, 1] in, (n, 19) relational observations out.

    Actions are those of `recovery_policy.commanded_tip`: mirrored so that the block's nearest corner is at (+, +).

    Args:
        tasks: worlds, environment i being built from tasks[i % len(tasks)]; left out: training tasks of the domain,
            drawn from the seeds of the reset that builds the scene.
        block: the cornered block.
        done: (n, 19) observations -> (n,) is there nothing left to do? Left out: as the shipped library has it.
        render_backend: "none" builds no visuals; otherwise as ManiSkill has it.

    Raises:
        TrainingError: the tasks do not hold the same objects.
    """

    SUPPORTED_ROBOTS = (Ur7e2f140.uid,)
    SUPPORTED_OBS_MODES = ("state", "state_dict", "none")
    SUPPORTED_REWARD_MODES = ("sparse", "none")

    def __init__(
        self,
        *args: Any,
        tasks: Sequence[Task] | None = None,
        block: Object | None = None,
        done: Callable[[Tensor], Tensor] | None = None,
        robot_uids: str = Ur7e2f140.uid,
        render_backend: str = "none",
        **kwargs: Any,
    ) -> None:
        if tasks is not None and len({task.objects for task in tasks}) != 1:
            raise TrainingError("the tasks of parallel environments must hold the same objects, and there must be some")
        solvers = {solver_of(task.physics) for task in tasks or ()}
        if len({(solver.period, solver.inertia) for solver in solvers}) > 1:
            raise TrainingError("parallel environments step as one: their physics must have one period and one inertia")
        self._solver = next(iter(solvers), SHIPPED)
        self._given, self.block = tasks, block or BLOCK("b0")
        self._done, self.rig = done or _shipped_done(), load_rig()
        super().__init__(*args, robot_uids=robot_uids, render_backend=render_backend, **kwargs)
        # What a user sends is a tip motion; the agent's own space is that of its joints.
        self.single_action_space = spaces.Box(-1.0, 1.0, (view.ACTION_SIZE,), np.float32)
        many = self.num_envs > 1
        self.action_space = batch_space(self.single_action_space, self.num_envs) if many else self.single_action_space

    @property
    def _default_sim_config(self) -> SimConfig:
        return SimConfig(
            spacing=3,  # the arm reaches 1.2 m; close together, positions keep their digits
            sim_freq=round(1 / self._solver.period),
            control_freq=round(1 / CONTROL_PERIOD),
            # What is not said here, each body brings along.
            scene_config=SceneConfig(gravity=np.array(self._solver.gravity), enable_tgs=False),
            gpu_memory_config=GPUMemoryConfig(
                max_rigid_contact_count=max(2**19, 512 * self.num_envs),
                max_rigid_patch_count=max(2**18, 256 * self.num_envs),
                collision_stack_size=2**26,
            ),
        )

    # -- building ------------------------------------------------------------------------------------------------------

    def _load_agent(self, options: dict[str, Any], *_: Any, **__: Any) -> None:
        tasks = self._given or self._draw_tasks()
        self.tasks = [tasks[i % len(tasks)] for i in range(self.num_envs)]
        self.agent = Ur7e2f140(
            self.scene, self._control_freq, self._control_mode, physics=[task.physics for task in self.tasks]
        )

    def _draw_tasks(self) -> list[Task]:
        scenario = next(s for s in CORNERED_INSERTION_S.scenarios.values() if s.training)
        return [scenario.sample(np.random.default_rng(int(s)), int(s)) for s in self._episode_seed]

    def _load_scene(self, options: dict[str, Any]) -> None:
        rendered = self.scene.can_render()
        bodies: dict[Object, list[sapien.Entity]] = {}
        for i, (scene, task) in enumerate(zip(self.scene.sub_scenes, self.tasks, strict=True)):
            add_table(scene, task.physics, rendered)
            for obj in task.objects:
                if obj.type in (BOX, BLOCK):
                    entity = (add_box if obj.type == BOX else add_block)(scene, obj, task, rendered)
                    entity.name = f"scene-{i}_{obj.name}"
                    bodies.setdefault(obj, []).append(entity)
        self._initial = {
            obj: self._tensor(np.stack([task.initial[obj][:7] for task in self.tasks])).float() for obj in bodies
        }
        self._actors = {obj: self._view(obj, entities) for obj, entities in bodies.items()}
        self.worlds = FailedWorlds(self.tasks, self.block, self.rig, torch, self.device)
        self._everyone = torch.arange(self.num_envs, device=self.device)
        self._commanded = torch.zeros(self.num_envs, 3, device=self.device)
        self.x = torch.zeros(self.num_envs, view.PROJECTED_SIZE, device=self.device)

    def _view(self, obj: Object, entities: list[sapien.Entity]) -> Actor:
        """One batched handle on the bodies of `obj` in all parallel worlds."""
        actor = Actor.create_from_entities(entities, self.scene, torch.arange(len(entities), dtype=torch.int))
        actor.initial_pose = Pose.create(self._initial[obj])
        self.scene.actors[obj.name] = actor
        self.scene.add_to_state_dict_registry(actor)
        return actor

    def _tensor(self, value: Any) -> Tensor:
        return torch.as_tensor(value, device=self.device)

    # -- the simulated arm and block, batched --------------------------------------------------------------------------

    @property
    def joints(self) -> Tensor:
        """(n, 6) measured joint positions."""
        return self.agent.robot.qpos[:, self.agent.arm_index]

    @property
    def blocks(self) -> Tensor:
        """(n, 7) poses of the block."""
        return self._actors[self.block].pose.raw_pose

    def drive(self, q: Tensor, opening: float = 0.0) -> None:
        """Drive all arms to (n, 6) over one control step."""
        fingers = torch.full((self.num_envs, 1), opening, device=self.device)
        super()._step_action(torch.cat([q.float(), fingers], -1))

    def _initialize_episode(self, env_idx: Tensor, options: dict[str, Any]) -> None:
        """Put block and arm where options["start"] = ((k, 7) poses, (k, 6) joints) says, or where starts are drawn."""
        if "start" in options:
            poses, q = options["start"]
        else:
            # ManiSkill seeds torch's own generator before it calls this.
            seed = int(torch.randint(2**31, (1,)))
            poses, q = self._failures(env_idx, torch.Generator(self.device).manual_seed(seed))
        qpos = torch.zeros(len(env_idx), self.agent.robot.max_dof, device=self.device)
        qpos[:, self.agent.arm_index] = q.float()
        self.agent.robot.set_pose(self.agent.base)
        self.agent.robot.set_qpos(qpos)
        for obj, actor in self._actors.items():
            if obj.type == BLOCK:
                actor.set_pose(Pose.create(poses.float() if obj == self.block else self._initial[obj][env_idx]))
                if not self.gpu_sim_enabled:
                    for body in actor._bodies:
                        body.wake_up()
        self._commanded[env_idx] = self.worlds.tip_at(q)
        self.x[env_idx] = self._measure()[env_idx]

    def _failures(self, which: Tensor, random: torch.Generator) -> tuple[Tensor, Tensor]:
        """(k, 7) poses of the block where the skill failed, and (k, 6) joints that put the tip over it."""
        variety, block = view.PressVariety(), self.worlds.failures[which][:, view.BLOCK]
        drawn = torch.rand(len(which), 3, generator=random, device=self.device)
        tip = block[:, :3].clone()
        tip[:, :2] += variety.aside * (2 * drawn[:, :2] - 1)
        low, high = variety.height
        tip[:, 2] += block[:, 9] / 2 + view.STUD + low + (high - low) * drawn[:, 2]
        return block[:, :7].double(), self.worlds.joints_at(tip, which)

    # -- the MDP -------------------------------------------------------------------------------------------------------

    def _measure(self) -> Tensor:
        return self.worlds.states(self.joints, self.blocks, self._commanded, self._everyone)

    def _step_action(self, action: Any) -> Tensor:
        """Move the commanded tips by (n, 3) `action`; None leaves them where they are."""
        if action is None:
            action = torch.zeros(self.num_envs, view.ACTION_SIZE, device=self.device)
        action = common.to_tensor(action, device=self.device).float().reshape(self.num_envs, view.ACTION_SIZE)
        self._commanded = view.commanded_tip(self.x, action)
        self.drive(self.worlds.joints_at(self._commanded, self._everyone))
        self.x = self._measure()
        return action

    def evaluate(self) -> dict[str, Tensor]:
        with torch.no_grad():
            return {"success": self._done(view.observe(self.x)).bool()}

    def _get_obs_state_dict(self, info: dict[str, Any]) -> dict[str, Tensor]:
        return {"observation": view.observe(self.x)}


def _shipped_done() -> Callable[[Tensor], Tensor]:
    """Beta_N of the shipped recovery."""
    library = load_library(Path(str(files("resync_robot"))) / "shipped" / CORNERED_INSERTION_S.name)
    record = library.skills[CORNERED_INSERTION_S.recovery]
    weights = {k.removeprefix("terminal."): v for k, v in record.tensors.items() if k.startswith("terminal.")}
    terminal = Terminal.from_record(Record(record.meta["terminal"], weights))
    sure = float(record.meta.get("sure", 0.5))
    return lambda seen: terminal.probability(seen.cpu()).to(seen.device) > sure


class ManiSkillScenes:
    """The scenes of `DeviceEnv`, in tensors on a device.

    A scene keeps the world that it was built from.

    Args:
        tasks: worlds; scene i holds tasks[i % len(tasks)].
        block: the object that the policy moves.
        count: scenes; one where `device` is "cpu", as ManiSkill has it.
        device: "cpu", "cuda" or "cuda:1".

    Raises:
        TrainingError: several scenes on the CPU, or tasks that do not hold the same objects.
    """

    def __init__(self, tasks: Sequence[Task], block: Object, rig: Rig, count: int, device: str) -> None:
        if device == "cpu" and count > 1:
            raise TrainingError(f"ManiSkill steps one scene on the CPU, not {count}", "use a GPU")
        if rig.hash != load_rig().hash:
            raise TrainingError(f"ManiSkill's scenes are built for the simulated rig, not for '{rig.name}'")
        self.tasks, self.block, self.count = tasks, block, count
        backend = "physx_cpu" if device == "cpu" else device.replace("cuda", "physx_cuda")
        self.env = CorneredInsertionEnv(num_envs=count, sim_backend=backend, tasks=tasks, block=block, obs_mode="none")

    @property
    def joints(self) -> Tensor:
        """(count, 6) measured joint positions."""
        return self.env.joints

    @property
    def blocks(self) -> Tensor:
        """(count, 7) poses of the block."""
        return self.env.blocks

    def step(self, q: Tensor, opening: float = 0.0) -> None:
        """Drive all arms to (count, 6) over one control step."""
        self.env.drive(q, opening)

    def reset(self, resets: Sequence[tuple[int, int, Tensor, Tensor]]) -> None:
        """Begin anew: (scene, task index, (7,) block pose, (6,) joints) each. Raises TrainingError for another task."""
        resets = sorted(resets, key=lambda item: item[0])  # ManiSkill writes masked rows in order
        for scene, task, _, _ in resets:
            if task != scene % len(self.tasks):
                raise TrainingError(f"scene {scene} holds task {scene % len(self.tasks)} and cannot change to {task}")
        which = torch.tensor([item[0] for item in resets], device=self.env.device)
        poses, q = (torch.stack([torch.as_tensor(item[i]) for item in resets]).to(which.device) for i in (2, 3))
        self.env.reset(options={"env_idx": which, "start": (poses, q)})

    def close(self) -> None:
        self.env.close()

    def __enter__(self) -> ManiSkillScenes:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
