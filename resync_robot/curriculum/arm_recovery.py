"""The recovery of an arm's domain, by the learner that knows no domain, as the library record that all else uses."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from resync_robot.arm_embodiment import arm_embodiment, arm_stage
from resync_robot.core.library import Record
from resync_robot.core.relations import between, seen
from resync_robot.core.rig import Rig
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import ROBOT
from resync_robot.curriculum.stage_files import Mined
from resync_robot.learning.failures import PairGaussian
from resync_robot.library_models import initial_model
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.failure_mining import Explanation
from resync_robot.sim_training.learn_recovery import RecoverySettings, learn_recovery
from resync_robot.sim_training.ppo import PpoSettings, Progress
from resync_robot.sim_training.recovery_env import JudgedSettings
from resync_robot.sim_training.recovery_problem import Problem, Start, pose_problem

RECOVERY = RecoverySettings(
    attempts=200,
    # A run of a skill takes as long as a hundred actions.
    judged=JudgedSettings(verdicts=0.01),
    ppo=PpoSettings(
        scenes=32, total_steps=400_000, least_steps=30_000, stop_at=0.95, minibatch=256, anneal_steps=80_000
    ),
    # All blocks look alike to it.
    elsewhere=0,
    roll_outs=60,
    width=256,
    depth=4,
)


def arm_problem(domain: str, rig: Rig, mined: Mined) -> Problem:
    """What an arm's domain has to learn, from its mined failures; made anew in each process."""
    found = find_domain(domain)
    operator = next(o for o in found.operators if o.name == mined.culprit.skill)
    tasks = mined.tasks(found)
    robot = next(o for o in tasks[0].objects if o.type == ROBOT)
    objects: list[Object] = [robot if v.type == ROBOT else mined.relevant for v in operator.parameters]
    explanation = Explanation(operator.name, tuple(objects), mined.relevant, (mined.culprit.failure_object,))
    starts = tuple(Start(task, task.initial) for task in tasks)
    return pose_problem(
        found, arm_embodiment(rig), arm_stage(found, rig), initial_model(found, rig), explanation, starts
    )


def learn_arm_recovery(
    domain: str,
    rig: Rig,
    mined: Mined,
    seed: int,
    workers: int,
    checkpoint: Path,
    progress: Progress,
    settings: RecoverySettings,
) -> tuple[Record, PairGaussian, dict[str, Any]]:
    """The record of the recovery, the Gaussian of how its object lies in the end, and figures."""
    pose = partial(arm_problem, domain, rig, mined)
    problem = pose()
    learned = learn_recovery(problem, seed, checkpoint, progress, settings, workers=workers, pose=pose)
    pair = mined.relevant, mined.culprit.failure_object
    relations = problem.domain.relations
    relation = between(pair[0].type, pair[1].type, relations)
    after = PairGaussian.fit([seen(state, *pair, relations) for state in learned.after], relation.resolution)
    figures = {
        **learned.figures,
        "stop_at": settings.ppo.stop_at,
        # Only then all episodes count, and not just those that end early.
        "first_time_limit": settings.ppo.scenes * problem.stage.horizon,
    }
    return learned.to_record(), after, figures
