"""The ManiSkill environment: one scene on the CPU back end, against the project's own scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from resync_robot.core.errors import TrainingError
from resync_robot.core.rig import load_rig
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK
from resync_robot.learning import recovery_policy as view
from resync_robot.sim_training.block_recovery import DEVICE_SCENES, RecoveryEnv, scaled_to_device, train_recovery
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.domains.cornered_insertion_s.maniskill_env import (
    ENVIRONMENT,
    CorneredInsertionEnv,
    ManiSkillScenes,
)
from resync_robot.sim_training.physics.solver import SHIPPED
from resync_robot.sim_training.ppo import PpoSettings
from resync_robot.sim_training.recovery import FailedWorlds, RecoverySettings
from resync_robot.sim_training.vector_env import RecoveryScenes

B0 = BLOCK("b0")
RIG = load_rig()
CPU = torch.device("cpu")


def make_tasks(count: int = 1) -> list[Task]:
    """Training tasks of the domain: b0 stands in a corner of the box."""
    scenario = find_domain("cornered-insertion-s").scenario("s0")
    return [scenario.sample(np.random.default_rng(seed), seed) for seed in range(count)]


def make_env(**options: Any) -> Any:
    return gymnasium.make(ENVIRONMENT, num_envs=1, sim_backend="physx_cpu", **options)


def press_and_drag(scenes: RecoveryScenes | ManiSkillScenes, xp: Any) -> torch.Tensor:
    """(t, 27) states while the tip presses on the stud, drags it away from the corner, and lifts off."""
    worlds, task = FailedWorlds(scenes.tasks, scenes.block, RIG, xp, CPU), torch.zeros(1, dtype=torch.long)
    block = worlds.failures[:, view.BLOCK]
    commanded = block[:, :3].clone()
    commanded[:, 2] += block[:, 9] / 2 + view.STUD + 0.004
    scenes.reset([(0, 0, worlds.array(block[0, :7]), worlds.joints_at(commanded, task)[0])])
    states = []
    for action in [(0, 0, -1)] * 3 + [(-0.5, -0.5, -0.5)] * 15 + [(0, 0, 1)] * 5:
        states.append(worlds.states(scenes.joints, scenes.blocks, commanded, task))
        commanded = view.commanded_tip(states[-1], torch.tensor([action], dtype=torch.float32))
        scenes.step(worlds.joints_at(commanded, task))
    return torch.cat([*states, worlds.states(scenes.joints, scenes.blocks, commanded, task)])


@pytest.fixture(scope="module")
def two_runs() -> tuple[torch.Tensor, torch.Tensor]:
    """The same press-and-drag in this project's scene and in ManiSkill's."""
    tasks = make_tasks()
    with RecoveryScenes(tasks, B0, RIG, 1, 0) as ours:
        first = press_and_drag(ours, np)
    with ManiSkillScenes(tasks, B0, RIG, 1, "cpu") as theirs:
        return first, press_and_drag(theirs, torch)


def test_both_simulations_drag_the_block_out_of_its_corner(two_runs: tuple[torch.Tensor, torch.Tensor]) -> None:
    for states in two_runs:
        gaps = view.wall_gaps(states)
        assert gaps[0].max() < 0.005 and gaps[-1].min() > RecoverySettings().gap
        assert view.up_axis(states)[:, 2].min() > 0.9


def test_both_simulations_move_tip_and_block_alike(two_runs: tuple[torch.Tensor, torch.Tensor]) -> None:
    ours, theirs = two_runs
    assert torch.allclose(ours[0, view.TIP], theirs[0, view.TIP], atol=1e-4)
    # A hand that slips off the stud does so a moment sooner or later: alike, not equal.
    tips = (ours[:, view.TIP] - theirs[:, view.TIP]).norm(dim=-1)
    blocks = (ours[:, 6:9] - theirs[:, 6:9]).norm(dim=-1)
    for apart in (tips, blocks):
        assert apart.median() < 0.006 and apart.max() < 0.020


def test_random_rollout_through_gymnasium() -> None:
    env = make_env()
    assert env.action_space.shape == (view.ACTION_SIZE,)
    observation, _ = env.reset(seed=3)
    assert observation.shape == env.observation_space.shape == (1, view.OBSERVATION_SIZE)
    env.action_space.seed(0)
    for step in range(1, RecoverySettings().horizon + 1):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert torch.isfinite(observation).all() and torch.isfinite(reward).all()
        assert bool(terminated) == bool(info["success"] | info["fail"])
        if terminated:
            break
        assert bool(truncated) == (step == RecoverySettings().horizon)
    assert torch.equal(observation, view.observe(env.unwrapped.x))
    env.close()


def test_starts_follow_the_seed() -> None:
    env = make_env()
    first, again, other = (env.reset(seed=seed)[0] for seed in (5, 5, 6))
    assert torch.equal(first, again) and not torch.equal(first, other)
    env.close()


def test_worlds_differ_in_their_physics() -> None:
    soft, heavy = make_tasks(2)
    found = []
    for task in (soft, heavy):
        env = CorneredInsertionEnv(num_envs=1, sim_backend="physx_cpu", tasks=[task], block=B0)
        body, joint = env._actors[B0]._bodies[0], env.agent.robot.active_joints[0]
        friction = body.collision_shapes[0].physical_material.dynamic_friction
        found.append((float(body.mass), friction, float(joint.stiffness)))
        assert np.isclose(body.mass, SHIPPED.inertia * task.physics["masses"]["b0"])
        assert np.isclose(friction, task.physics["friction_block"])
        env.close()
    assert all(a != b for a, b in zip(*found, strict=True))


def test_a_press_is_held_while_other_environments_begin_anew() -> None:
    env = CorneredInsertionEnv(num_envs=1, sim_backend="physx_cpu", tasks=make_tasks(), block=B0)
    env.step(torch.tensor([[0.0, 0.0, -1.0]]))
    controller = env.agent.controller
    sent = controller._goal.clone()
    controller.starting = torch.tensor([False])
    controller.reset()
    assert torch.equal(controller._goal, sent) and not torch.allclose(sent, controller.qpos, atol=1e-6)
    controller.starting = torch.tensor([True])
    controller.reset()
    assert torch.allclose(controller._goal, controller.qpos)
    env.close()


def test_the_mdp_runs_in_torch_as_in_numpy() -> None:
    tasks = make_tasks()
    states = []
    for make, options in ((RecoveryScenes, (1, 0)), (ManiSkillScenes, (1, "cpu"))):
        with make(tasks, B0, RIG, *options) as scenes:
            env = RecoveryEnv(scenes, RIG, RecoverySettings(), 0.98, seed=4, rebuild=0.0)
            first = env.x.clone()
            reward, *_ = env.step(torch.zeros(1, view.ACTION_SIZE))
            assert torch.isfinite(reward).all()
            states.append(first)
    # The same draws put tip and block in the same place; one simulation has settled for 20 ms, the other has not.
    assert torch.allclose(*states, atol=2e-3)


def test_starts_of_many_worlds_are_the_same_in_torch_and_numpy() -> None:
    tasks, task = make_tasks(5), torch.arange(64) % 5
    drawn = []
    for xp in (np, torch):
        worlds = FailedWorlds(tasks, B0, RIG, xp, CPU)
        poses, q, tip = worlds.draw_starts(task, torch.Generator().manual_seed(0))
        assert torch.allclose(worlds.tip_at(q), tip, atol=1e-6)
        drawn.append((torch.as_tensor(poses), torch.as_tensor(q), worlds.states(q, poses, tip, task)))
    for ours, theirs in zip(*drawn, strict=True):
        assert ours.shape[0] == 64 and torch.allclose(ours, theirs, atol=1e-7)


def test_training_runs_on_maniskill_scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "resync_robot.sim_training.block_recovery.RecoveryScenes", lambda *a: ManiSkillScenes(*a[:4], "cpu")
    )
    settings = PpoSettings(scenes=1, steps=16, minibatch=8, total_steps=32, least_steps=0, rebuild=0.0)
    path = tmp_path / "ppo.safetensors"
    net, figures = train_recovery(
        make_tasks(), B0, RIG, 0, 0, settings, RecoverySettings(horizon=8), path, lambda *_: None
    )
    assert figures["curve"]["steps"] == [16, 32]
    assert all(torch.isfinite(p).all() for p in net.parameters())


def test_what_a_device_cannot_do_is_refused() -> None:
    tasks = make_tasks(2)
    with pytest.raises(TrainingError, match="one scene on the CPU"):
        ManiSkillScenes(tasks, B0, RIG, 2, "cpu")
    with ManiSkillScenes(tasks, B0, RIG, 1, "cpu") as scenes:
        start = (torch.tensor(tasks[1].initial[B0][:7]), torch.tensor(RIG.arm.home))
        with pytest.raises(TrainingError, match="holds task 0 and cannot change to 1"):
            scenes.reset([(0, 1, *start)])
    with pytest.raises(TrainingError, match="same objects"):
        CorneredInsertionEnv(num_envs=1, sim_backend="physx_cpu", tasks=[])


def test_a_device_gets_thousands_of_scenes_and_as_many_updates() -> None:
    settings = PpoSettings()
    assert scaled_to_device(settings, "cpu") is settings
    scaled = scaled_to_device(settings, "cuda")
    assert scaled.scenes == DEVICE_SCENES and scaled.rebuild == 0
    assert scaled.total_steps / scaled.scenes >= settings.total_steps / settings.scenes / 4
