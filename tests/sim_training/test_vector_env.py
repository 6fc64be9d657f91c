"""Many scenes at once: each by itself, put where they are asked to be, the same in one process and in two."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core.rig import load_rig
from resync_robot.sim_training.physics.world import SimWorld
from resync_robot.sim_training.vector_env import CONTROL_PERIOD, RECOVERY_TORQUE, RecoveryScenes
from tests import scenes
from tests.scenes import B0
from tests.sim_training.physics.test_world import joints_at

RIG = load_rig()
TASKS = [scenes.scene({"b0": (x, 0.0)}) for x in (0.0, 0.05)]
ABOVE, BESIDE = joints_at(np.array([0.48, 0.0, 0.25])), joints_at(np.array([0.40, 0.0, 0.04]))


def place(x: float, y: float) -> np.ndarray:
    return scenes.block_features(x, y)[:7]


def drag(recovery: RecoveryScenes) -> np.ndarray:
    """Put the arms beside the blocks and push through the first; the history of joints and blocks."""
    recovery.reset([(i, i % 2, place(0.0, 0.0), BESIDE) for i in range(recovery.count)])
    rows = []
    for x in (0.44, 0.48, 0.52):
        q = np.tile(ABOVE, (recovery.count, 1))
        q[0] = joints_at(np.array([x, 0.0, 0.04]))
        recovery.step(q)
        rows.append(np.concatenate([recovery.joints, recovery.blocks], 1).copy())
    return np.stack(rows)


def test_scenes_begin_with_the_tasks_in_turn() -> None:
    with RecoveryScenes(TASKS, B0, RIG, count=3, workers=0) as recovery:
        assert recovery.joints.shape == (3, 6) and recovery.blocks.shape == (3, 7)
        expected = [TASKS[i % 2].initial[B0][:3] for i in range(3)]
        np.testing.assert_allclose(recovery.blocks[:, :3], expected, atol=1e-3)


def test_only_the_scene_that_is_pushed_moves() -> None:
    with RecoveryScenes(TASKS, B0, RIG, count=2, workers=0) as recovery:
        history = drag(recovery)
    pushed, other = history[-1, 0, 6:9], history[-1, 1, 6:9]
    assert pushed[0] - place(0, 0)[0] > 0.02
    np.testing.assert_allclose(other, place(0.0, 0.0)[:3], atol=2e-3)


def test_a_reset_puts_block_and_arm_where_they_are_asked_to_be_and_no_other_scene() -> None:
    with RecoveryScenes(TASKS, B0, RIG, count=2, workers=0) as recovery:
        drag(recovery)
        kept = recovery.blocks[0].copy()
        recovery.reset([(1, 0, place(-0.05, 0.08), ABOVE)])
        np.testing.assert_allclose(recovery.blocks[1, :3], place(-0.05, 0.08)[:3], atol=1e-3)
        np.testing.assert_allclose(recovery.joints[1], ABOVE, atol=1e-3)
        np.testing.assert_array_equal(recovery.blocks[0], kept)


def test_the_same_commands_give_the_same_history() -> None:
    histories = []
    for _ in range(2):
        with RecoveryScenes(TASKS, B0, RIG, count=2, workers=0) as recovery:
            histories.append(drag(recovery))
    np.testing.assert_array_equal(*histories)


@pytest.mark.slow
def test_two_processes_give_what_one_gives() -> None:
    histories = []
    for workers in (0, 2):
        with RecoveryScenes(TASKS, B0, RIG, count=3, workers=workers) as recovery:
            histories.append(drag(recovery))
    np.testing.assert_array_equal(*histories)


def test_it_is_the_world_that_skills_run_in() -> None:
    """The same push in a SimWorld under the same effort ends where it ends here: a policy that learned here works
    there."""
    with RecoveryScenes(TASKS, B0, RIG, count=1, workers=0) as recovery:
        there = drag(recovery)[-1, 0, 6:9]
    world = SimWorld(TASKS[0], RIG)
    world.limit_effort(RECOVERY_TORQUE)
    world.built.set_configuration(BESIDE, 0.0)
    world.drive(BESIDE, 0.0)
    from resync_robot.core.joints import JointTarget

    for x in (0.44, 0.48, 0.52):
        world.act(JointTarget(joints_at(np.array([x, 0.0, 0.04])), 0.0), CONTROL_PERIOD)
    np.testing.assert_allclose(world.perceive()[B0][:3], there, atol=4e-3)
