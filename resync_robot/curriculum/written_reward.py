"""The recovery of the cornered block by a reward written by hand: in processes, or by the thousand on a GPU."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from resync_robot.core.library import Record
from resync_robot.core.relations import Relation, between
from resync_robot.core.rig import Rig
from resync_robot.core.task import Domain, Task
from resync_robot.curriculum.stage_files import Mined
from resync_robot.learning import recovery_policy as view
from resync_robot.learning.failures import PairGaussian
from resync_robot.learning.recovery_policy import ActorCritic
from resync_robot.learning.terminals import train_terminal
from resync_robot.sim_training.block_recovery import RecoveryEnv, scaled_to_device, train_recovery
from resync_robot.sim_training.ppo import PpoSettings, Progress
from resync_robot.sim_training.recovery import RecoverySettings, draw_still, is_recovered
from resync_robot.sim_training.vector_env import RecoveryScenes


def learn_by_written_reward(
    domain: Domain,
    rig: Rig,
    mined: Mined,
    seed: int,
    workers: int,
    checkpoint: Path,
    progress: Progress,
    settings: PpoSettings,
    device: str,
) -> tuple[Record, PairGaussian, dict[str, Any]]:
    """The record of the recovery, the Gaussian of how its object lies in the end, and figures."""
    ppo, recovery = scaled_to_device(settings, device), RecoverySettings()
    relation = between(mined.relevant.type, mined.culprit.failure_object.type, domain.relations)
    tasks = mined.tasks(domain)
    net, figures = train_recovery(
        tasks, mined.relevant, rig, seed, workers, ppo, recovery, checkpoint, progress, device
    )
    data, after = _roll_out(net, tasks, mined, relation, rig, recovery, seed, workers)
    done, accuracy = train_terminal(*data["done"], seed)
    failed, failed_accuracy = train_terminal(*data["failed"], seed + 1)
    tensors = {f"policy.{k}": v for k, v in net.to_tensors().items()}
    for name, terminal in (("terminal", done), ("failed", failed)):
        tensors |= {f"{name}.{k}": v for k, v in terminal.to_record().tensors.items()}
    meta = {
        "policy": net.shape,
        "terminal": done.to_record().meta,
        "failed": failed.to_record().meta,
        "signature": ["robot", mined.relevant.type.name, mined.culprit.failure_object.type.name],
        "failed_skill": mined.culprit.skill,
    }
    found = {
        "curve": figures["curve"],
        "steps": figures["curve"]["steps"][-1],
        "stop_at": ppo.stop_at,
        # Only then all episodes count, and not just those that end early.
        "first_time_limit": ppo.scenes * recovery.horizon,
        "terminal_accuracy": round(accuracy, 4),
        "failure_detector_accuracy": round(failed_accuracy, 4),
    }
    return Record(meta, tensors), after, found


def _roll_out(
    net: ActorCritic,
    tasks: list[Task],
    mined: Mined,
    relation: Relation,
    rig: Rig,
    s: RecoverySettings,
    seed: int,
    workers: int,
) -> tuple[dict[str, tuple[torch.Tensor, torch.Tensor]], PairGaussian]:
    """States before and at the goal, on past the first success, so that beta also knows what comes after."""
    seen, labels, relative, begun = [], [], [], []
    with RecoveryScenes(tasks, mined.relevant, rig, 64, workers) as scenes:
        env = RecoveryEnv(scenes, rig, s, 0.98, seed + 7, rebuild=0.5)
        for _ in range(3):
            env.reset(np.arange(scenes.count))
            begun.append(view.observe(env.x))
            for _ in range(20):
                still = draw_still(env.x, env.random)
                seen.append(view.observe(still))
                labels.append(is_recovered(still, still, s))
            reached = torch.zeros(scenes.count, dtype=torch.bool)
            for _ in range(s.horizon):
                with torch.no_grad():
                    action = net.act(view.observe(env.x))
                previous = env.x
                env.step(action + 0.15 * torch.randn(action.shape, generator=env.random))
                success = is_recovered(env.x, previous, s)
                seen.append(view.observe(env.x))
                labels.append(success)
                first = env.x[success & ~reached].double().numpy()
                relative += list(relation.see(first[:, view.BLOCK], first[:, view.BOX]))
                reached |= success
    features, done = torch.cat(seen), torch.cat(labels)
    # The failure detector: D^F is where the skill failed, recovered states are where it would not have.
    failure = torch.cat([features[done], *begun])
    failed = torch.cat([torch.zeros(int(done.sum())), torch.ones(sum(map(len, begun)))])
    return {"done": (features, done.long()), "failed": (failure, failed.long())}, PairGaussian.fit(
        relative, relation.resolution
    )
