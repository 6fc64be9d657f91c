"""The library of Cornered Insertion-L that comes with the program: what it plans, and that its plans work."""

from __future__ import annotations

import pytest

from resync_robot.core.library import load_library
from resync_robot.core.rig import load_rig
from resync_robot.library_models import learned_model, shipped_library
from resync_robot.planning.execute import Model, plan_and_execute
from resync_robot.planning.search import plan
from resync_robot.sim_training.domains import find_domain, world_task
from resync_robot.sim_training.physics.world import SimWorld

RIG, DOMAIN = load_rig(), find_domain("cornered-insertion-l")
BUILD = "Recover Pick Insert OpenDrawer PickTower PlaceTower CloseDrawer"
PLANS = {
    "l0": f"RemoveLid {BUILD}",
    "l1": f"RemoveLid {BUILD}",
    "l2": f"RemoveLid Recover {BUILD}",
    "l3": f"RemoveLid {BUILD.replace('OpenDrawer ', '')}",
    "l4": BUILD,
    "l6": f"RemoveLid {BUILD}",
}


@pytest.fixture(scope="module")
def model() -> Model:
    return learned_model(DOMAIN, RIG, load_library(shipped_library(DOMAIN.name)))


def skills(model: Model, scenario: str, episode: int) -> list[str]:
    task = world_task(DOMAIN, scenario, 1500, episode)
    found = plan(
        model.operators, task.objects, model.abstraction.true_atoms(task.initial), task.goal, costs=model.costs
    )
    return [s.name for s in found.steps]


@pytest.mark.parametrize("scenario", sorted(PLANS))
def test_cornered_blocks_are_freed_before_they_are_touched_otherwise(model: Model, scenario: str) -> None:
    as_expected = sum(skills(model, scenario, episode) == PLANS[scenario].split() for episode in range(5))
    # Where a block stands decides whether it can be picked, and the classifier may err at the edge.
    assert as_expected >= 4


def test_a_tower_of_three_is_built_before_it_is_put_away(model: Model) -> None:
    for episode in range(3):
        steps = skills(model, "l5", episode)
        assert steps.count("Insert") == 2 and "Insert" not in steps[steps.index("PlaceTower") :]


def test_its_recovery_and_its_eyes_are_those_of_the_smaller_domain() -> None:
    own, small = (load_library(shipped_library(name)) for name in (DOMAIN.name, "cornered-insertion-s"))
    assert own.provenance["library"] == f"{small.domain} {small.content_hash}"
    assert own.policies["Recover"] == small.policies["Recover"]
    assert own.skills["Recover"].tensors.keys() == small.skills["Recover"].tensors.keys()


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["l1", "l5"])
def test_its_plans_work(model: Model, scenario: str) -> None:
    reached = 0
    for episode in range(3):
        task = world_task(DOMAIN, scenario, 1500, episode)
        world = SimWorld(task, RIG)
        assert world.reset(task.initial)
        reached += plan_and_execute(world, model, task.goal).success
    assert reached >= 2
