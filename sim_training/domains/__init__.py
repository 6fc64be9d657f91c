"""Domains by name. To add one, write its file and name it here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from resync_robot.core.errors import UnknownNameError
from resync_robot.core.task import Domain, Task
from resync_robot.sim_training.domains.cornered_insertion_s import CORNERED_INSERTION_S
from resync_robot.sim_training.lights import HARD, draw_lighting
from resync_robot.sim_training.solver import SHIPPED, Solver, with_solver

DOMAINS: dict[str, Domain] = {CORNERED_INSERTION_S.name: CORNERED_INSERTION_S}


def find_domain(name: str) -> Domain:
    """The domain of that name. Raises UnknownNameError, which lists the valid ones."""
    if name not in DOMAINS:
        raise UnknownNameError("domain", name, list(DOMAINS))
    return DOMAINS[name]


EVALUATION_WORLDS = 20_261_122
"""Entropy that sets the worlds of evaluation apart from those of every training seed.

Seeds below 1000 are for figures that are reported; whoever develops looks at worlds of seeds from 1000 on.
"""


def world_task(
    domain: Domain, scenario: str, seed: int, episode: int, worlds: str = "usual", solver: Solver = SHIPPED
) -> Task:
    """The world of one evaluation episode: a pure function of its arguments, drawn apart from all training.

    Args:
        worlds: "unseen" has friction, masses, sizes and looks beyond what training draws; "hard" is "usual" but for a
            single lamp that casts dark shadows.
        solver: how finely its physics is solved.
    """
    place = list(domain.scenarios).index(scenario)
    rng = np.random.default_rng([EVALUATION_WORLDS, place, seed, episode])
    found = domain.scenario(scenario)
    task = (found.sample_unseen if worlds == "unseen" else found.sample)(rng, int(rng.integers(2**31)))
    if worlds == "hard":
        task = replace(task, physics={**task.physics, **draw_lighting(rng, HARD)})
    return task if solver == SHIPPED else with_solver(task, solver)
