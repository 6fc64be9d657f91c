"""Domains: those that come with the program by name, all others by file or module."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from resync_robot.core.task import Domain, Task
from resync_robot.sim_training.domains.blocked_stacking import BLOCKED_STACKING
from resync_robot.sim_training.domains.cornered_insertion_l.domain import CORNERED_INSERTION_L
from resync_robot.sim_training.domains.cornered_insertion_s.domain import CORNERED_INSERTION_S
from resync_robot.sim_training.domains.finding import load_domain
from resync_robot.sim_training.domains.icy_transport import ICY_TRANSPORT
from resync_robot.sim_training.physics.lights import HARD, draw_lighting
from resync_robot.sim_training.physics.solver import SHIPPED, Solver, with_solver

DOMAINS: dict[str, Domain] = {
    d.name: d for d in (CORNERED_INSERTION_S, CORNERED_INSERTION_L, BLOCKED_STACKING, ICY_TRANSPORT)
}


def find_domain(spec: str) -> Domain:
    """The domain of NAME, path.py[:NAME] or package.module:NAME; a NAME is one of `DOMAINS` or of the entry points
    `resync_robot.domains`.

    Raises:
        UnknownNameError: there is none of that name; the message lists those that there are.
        ConfigError: what a file or module holds cannot be used; the message says why.
    """
    return load_domain(spec, DOMAINS)


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
    found = domain.scenario(scenario)
    rng = np.random.default_rng([EVALUATION_WORLDS, domain.world_number(scenario), seed, episode])
    task = (found.sample_unseen if worlds == "unseen" else found.sample)(rng, int(rng.integers(2**31)))
    if worlds == "hard":
        task = replace(task, physics={**task.physics, **draw_lighting(rng, HARD)})
    return task if solver == SHIPPED else with_solver(task, solver)
