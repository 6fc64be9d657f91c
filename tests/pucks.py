"""The domain of the guide, and a library of it that nobody learned: a recovery at random, and the given model."""

from __future__ import annotations

from pathlib import Path

import torch

from resync_robot.core.library import LearnedStage, Library, Record
from resync_robot.learning.failures import FailureModel, fit_beside
from resync_robot.learning.learned_recovery import LearnedRecovery
from resync_robot.learning.model import known_model
from resync_robot.learning.recovery_policy import ActorCritic
from resync_robot.learning.relational_view import view_size
from resync_robot.learning.terminals import Terminal
from resync_robot.library_models import make_library
from resync_robot.sim_training.domains import find_domain, world_task

PUCKS = str(Path(__file__).parents[1] / "docs" / "puck_behind_a_door.py")
DOMAIN = find_domain(PUCKS)
ROBOT, PUCK, PAD, DOOR, STONE = DOMAIN.types


def random_library() -> Library:
    """Of one stage, OpenDoor."""
    torch.manual_seed(0)
    types, stage = (ROBOT, PUCK, DOOR), DOMAIN.stages[0]
    features = view_size(types, DOMAIN.relations)
    recovery = LearnedRecovery(
        name=stage.recovery,
        types=types,
        sees=3,
        failed_skill="Fetch",
        arguments=(0, 1),
        horizon=stage.horizon,
        policy=ActorCritic(16, 1, features, 3),
        done=Terminal(features).eval(),
    )
    record, failed = recovery.to_record(), Terminal(features).eval().to_record()
    tensors = {**record.tensors, **{f"failed.{k}": v for k, v in failed.tensors.items()}}
    states = [world_task(DOMAIN, "door", 0, i).initial for i in range(5)]
    door, puck = DOOR("door"), PUCK("p0")
    lies = {door: fit_beside(DOMAIN, states, door, puck)}
    failure = FailureModel(
        recovery=stage.recovery, skill="Fetch", argument=1, relevant=PUCK, causes=(door,), before=lies, after=lies
    )
    learned = LearnedStage(recovery=stage.recovery, scenario=stage.scenario, failure=failure.to_learned())
    model = known_model(DOMAIN, None)
    return make_library(DOMAIN, None, learned, Record({**record.meta, "failed": failed.meta}, tensors), model, {})
