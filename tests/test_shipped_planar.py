"""The libraries of planar domains that come with the program: whole, small, and good for an episode of each stage."""

from __future__ import annotations

from pathlib import Path

import pytest

from resync_robot.core.library import load_library
from resync_robot.library_models import learned_model, shipped_library
from resync_robot.planning.execute import ExecuteSettings, plan_and_execute
from resync_robot.sim_training.domains import find_domain, world_task

SHIPPED = [p.name for p in sorted((Path(__file__).parents[1] / "resync_robot" / "shipped").iterdir())]
PLANAR = [name for name in SHIPPED if find_domain(name).embodiment is not None]
MOST_MB = 5


@pytest.mark.parametrize("name", PLANAR)
def test_it_holds_every_stage_and_reaches_the_goals_that_those_are_about(name: str) -> None:
    domain, path = find_domain(name), shipped_library(name)
    library = load_library(path)
    assert [s.recovery for s in library.stages] == [s.recovery for s in domain.stages]
    assert sum(p.stat().st_size for p in path.rglob("*") if p.is_file()) < MOST_MB * 1e6
    assert library.provenance["git"] and library.provenance["preset"] == "quick"
    model = learned_model(domain, None, library)
    for stage in domain.stages:
        reached = 0
        for episode in range(3):
            task = world_task(domain, stage.scenario, 1500, episode)
            simulator = domain.embodiment.simulate(task)
            assert simulator.reset(task.initial)
            reached += plan_and_execute(simulator, model, task.goal, ExecuteSettings()).success
        assert reached >= 2, f"{stage.scenario}: {reached} of 3"
