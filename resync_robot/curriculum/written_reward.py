"""The recovery of the cornered block on a GPU: its scenes by the thousand, and a reward written by hand.

The verdict of the failed skill, which every other training is rewarded by, runs in scenes of a process each.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from resync_robot.core.library import Record
from resync_robot.core.rig import Rig
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.curriculum.mine import Mined
from resync_robot.learning import recovery_policy as view
from resync_robot.learning.recovery_policy import ActorCritic
from resync_robot.learning.terminals import train_terminal
from resync_robot.sim_training.block_recovery import RecoveryEnv, scaled_to_device, train_recovery
from resync_robot.sim_training.ppo import PpoSettings, Progress
from resync_robot.sim_training.recovery import RecoverySettings, draw_still, is_recovered
from resync_robot.sim_training.vector_env import RecoveryScenes

BUDGETS = {
    "smoke": PpoSettings(total_steps=45_000, least_steps=0, stop_at=0.9),
    "quick": PpoSettings(),
    "full": PpoSettings(total_steps=2_000_000, least_steps=1_000_000, stop_at=0.999),
}
"""By preset."""


def learn_by_written_reward(
    rig: Rig,
    mined: Mined,
    seed: int,
    workers: int,
    checkpoint: Path,
    progress: Progress,
    settings: PpoSettings,
    device: str,
) -> tuple[Record, dict[str, Any]]:
    """The record of the recovery, and figures."""
    ppo, recovery, about = scaled_to_device(settings, device), RecoverySettings(), mined.explanation
    tasks = [start.task for start in mined.starts]
    net, figures = train_recovery(
        tasks, about.relevant, rig, seed, workers, ppo, recovery, checkpoint, progress, device
    )
    data = _roll_out(net, tasks, about.relevant, rig, recovery, seed, workers)
    done, accuracy = train_terminal(*data["done"], seed)
    failed, failed_accuracy = train_terminal(*data["failed"], seed + 1)
    tensors = {f"policy.{k}": v for k, v in net.to_tensors().items()}
    for name, terminal in (("terminal", done), ("failed", failed)):
        tensors |= {f"{name}.{k}": v for k, v in terminal.to_record().tensors.items()}
    meta = {
        "policy": net.shape,
        "terminal": done.to_record().meta,
        "failed": failed.to_record().meta,
        "signature": [o.type.name for o in about.parameters],
        "sees": len(about.projected),
        "failed_skill": about.skill,
        "arguments": [about.parameters.index(o) for o in about.objects],
        "horizon": recovery.horizon,
        "sure": 0.5,
    }
    found = {
        "curve": figures["curve"],
        "steps": figures["curve"]["steps"][-1],
        "attempts": 0,
        "verdicts": 0,
        "terminal_accuracy": round(accuracy, 4),
        "failure_detector_accuracy": round(failed_accuracy, 4),
    }
    return Record(meta, tensors), found


def _roll_out(
    net: ActorCritic,
    tasks: list[Task],
    block: Object,
    rig: Rig,
    s: RecoverySettings,
    seed: int,
    workers: int,
) -> dict[str, tuple[torch.Tensor, torch.Tensor]]:
    """States before and at the goal, on past the first success, so that beta also knows what comes after."""
    seen, labels, begun = [], [], []
    with RecoveryScenes(tasks, block, rig, 64, workers) as scenes:
        env = RecoveryEnv(scenes, rig, s, 0.98, seed + 7, rebuild=0.5)
        for _ in range(3):
            env.reset(np.arange(scenes.count))
            begun.append(view.observe(env.x))
            for _ in range(20):
                still = draw_still(env.x, env.random)
                seen.append(view.observe(still))
                labels.append(is_recovered(still, still, s))
            for _ in range(s.horizon):
                with torch.no_grad():
                    action = net.act(view.observe(env.x))
                previous = env.x
                env.step(action + 0.15 * torch.randn(action.shape, generator=env.random))
                success = is_recovered(env.x, previous, s)
                seen.append(view.observe(env.x))
                labels.append(success)
    features, done = torch.cat(seen), torch.cat(labels)
    # The failure detector: D^F is where the skill failed, recovered states are where it would not have.
    failure = torch.cat([features[done], *begun])
    failed = torch.cat([torch.zeros(int(done.sum())), torch.ones(sum(map(len, begun)))])
    return {"done": (features, done.long()), "failed": (failure, failed.long())}
