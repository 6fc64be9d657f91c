"""Icy Transport keeps the contract of domains; failures name ice and mud; cargo and target look alike to a learner."""

import numpy as np
import pytest

from resync_robot.core.relations import features, seen
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.execute import ExecuteSettings, Model, plan_and_execute
from resync_robot.sim_training.domain_checks import examine
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.domains.icy_transport import ICY_TRANSPORT
from resync_robot.sim_training.domains.icy_transport.layouts import O1, O2, TARGET
from resync_robot.sim_training.domains.icy_transport.vocabulary import CAR, ICE, ITEM, MUD
from resync_robot.sim_training.failure_mining import explain, mine_stage

BODY = ICY_TRANSPORT.embodiment
assert BODY is not None
MODEL = Model(
    {s.name: s for s in BODY.skills()},
    Abstraction(ICY_TRANSPORT.predicates, ICY_TRANSPORT.classifiers),
    ICY_TRANSPORT.operators,
)


def test_it_is_in_the_catalogue_and_keeps_the_contract() -> None:
    assert find_domain("icy-transport") is ICY_TRANSPORT
    found = list(examine(ICY_TRANSPORT, 2))
    assert [f for f in found if f.status != "ok"] == []
    detail = {f.name: f.detail for f in found}
    assert detail["given model: 0"] == "fails in 2 of 2, on ice"
    assert detail["given model: 6"] == "fails in 2 of 2, on mud"


@pytest.mark.parametrize(("stage", "culprit"), [(0, "ice"), (1, "mud")])
def test_failures_name_what_caught_the_car(stage: int, culprit: str) -> None:
    body = ICY_TRANSPORT.embodiment
    assert body is not None
    found = explain(ICY_TRANSPORT, mine_stage(ICY_TRANSPORT, body, ICY_TRANSPORT.stages[stage], MODEL, 0, 5))
    assert (found.skill, found.relevant) == ("GoToPickObject", O1)
    assert [o.name for o in found.projected] == ["robot", "o1", culprit]


@pytest.mark.parametrize("name", [n for n, s in ICY_TRANSPORT.scenarios.items() if not s.training])
def test_the_given_model_fails_in_every_other_scenario_too(name: str) -> None:
    task = ICY_TRANSPORT.scenario(name).sample(np.random.default_rng(7), 7)
    result = plan_and_execute(BODY.simulate(task), MODEL, task.goal, ExecuteSettings(max_failures=1))
    assert not result.success and "is caught in" in result.reason


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_in_the_way_where_tasks_are_free(seed: int) -> None:
    assert ICY_TRANSPORT.free is not None
    task = ICY_TRANSPORT.free(np.random.default_rng(seed), seed, {ICE: 4, MUD: 4})
    assert plan_and_execute(BODY.simulate(task), MODEL, task.goal, ExecuteSettings(max_failures=1)).success


@pytest.mark.parametrize("guarded", [O1, TARGET])
def test_a_region_can_be_put_before_the_door_of_another(guarded) -> None:  # type: ignore[no-untyped-def]
    """As dreams do it, by what was seen of the failure."""
    rng, ice = np.random.default_rng(0), ICE("ice")
    state = ICY_TRANSPORT.scenario("1").sample(rng, 0).initial
    relative = seen(state, ice, O2, ICY_TRANSPORT.relations)
    task = ICY_TRANSPORT.free(rng, 0, {ICE: 1}) if ICY_TRANSPORT.free else None
    assert task is not None
    dreamed = ICY_TRANSPORT.relocate(task, ice, guarded, relative, rng).initial
    np.testing.assert_allclose(seen(dreamed, ice, guarded, ICY_TRANSPORT.relations), relative, atol=1e-9)
    assert np.linalg.norm(dreamed[ice][:2] - dreamed[guarded][:2]) == pytest.approx(2.1)
    assert BODY.simulate(task).reset(dreamed)


def test_the_way_to_cargo_and_to_the_target_looks_the_same() -> None:
    state = ICY_TRANSPORT.scenario("0").sample(np.random.default_rng(0), 0).initial
    as_cargo, as_target = state[O1][None], np.array([[*state[O1][:4], *state[TARGET][4:]]])
    ice, car = state[ICE("ice")][None], state[CAR("robot")][None]
    for other, rows in ((ICE, ice), (CAR, car)):
        seen = [features(ITEM, item, other, rows, ICY_TRANSPORT.relations) for item in (as_cargo, as_target)]
        np.testing.assert_array_equal(*seen)
    before = as_cargo.copy()
    features(ITEM, as_target, ICE, ice, ICY_TRANSPORT.relations)
    np.testing.assert_array_equal(as_cargo, before)
