"""The recovery problem of Cornered Insertion-S, posed without mining: Pick fails, for the box is in the way."""

from __future__ import annotations

import numpy as np

from resync_robot.arm_embodiment import arm_embodiment, arm_stage
from resync_robot.core.rig import load_rig
from resync_robot.core.vocabulary import BOX, ROBOT
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.execute import Model
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.failure_mining import Explanation
from resync_robot.sim_training.recovery_problem import Problem, Start, pose_problem
from tests.scenes import B0


def pose_cornered(count: int) -> Problem:
    """With so many of the scenario's worlds to begin in."""
    rig = load_rig()
    domain = find_domain("cornered-insertion-s")
    embodiment = arm_embodiment(rig, domain.operators)
    scenario = domain.scenario("s0")
    tasks = [scenario.sample(np.random.default_rng(seed), seed) for seed in range(count)]
    robot, box = (next(o for o in tasks[0].objects if o.type == kind) for kind in (ROBOT, BOX))
    skills = {s.name: s for s in embodiment.skills()}
    model = Model(skills, Abstraction(domain.predicates, domain.classifiers), domain.operators)
    about = Explanation(skill="Pick", objects=(robot, B0), relevant=B0, culprits=(box,))
    starts = [Start(task, task.initial) for task in tasks]
    return pose_problem(domain, embodiment, arm_stage(domain.stages[0], rig), model, about, starts)
