"""Icy Transport: a car brings two cargoes through doorways to a target, and ice and mud before a doorway catch it.

The scenarios bear the numbers of the paper. What the car has to learn is to drive through: a region that it has crossed
does nothing any more.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from resync_robot.core.embodiment import Embodiment, Stage
from resync_robot.core.relations import Relation, Rows, between, features
from resync_robot.core.symbols import Type
from resync_robot.core.task import Domain, Scenario
from resync_robot.sim_training.domains.icy_transport.layouts import GOAL, UNSEEN, draw, free
from resync_robot.sim_training.domains.icy_transport.simulator import MOST_FORCE, MOST_STEER, Floor
from resync_robot.sim_training.domains.icy_transport.skills import RATE_HZ, skills
from resync_robot.sim_training.domains.icy_transport.vocabulary import (
    CAR,
    DELIVERED,
    HAND_EMPTY,
    HOLDING,
    ICE,
    ITEM,
    MUD,
    PICK,
    PLACE,
    delivered,
    hand_empty,
    holding,
)


def _blind_to_targets(a: Type, b: Type) -> Relation:
    """The default, but what learns from it cannot tell cargo from a target: the way to either is the same."""
    return replace(between(a, b), features=partial(_look, a, b))


def _look(a: Type, b: Type, rows: Rows, others: Rows) -> Rows:
    return features(a, _as_cargo(a, rows), b, _as_cargo(b, others))


def _as_cargo(kind: Type, rows: Rows) -> Rows:
    if kind is not ITEM:
        return rows
    rows = rows.copy()
    rows[:, ITEM.features.index("fixed")] = 0.0
    return rows


def _scenario(name: str, stage: int, ice: str = "", mud: str = "", training: bool = False) -> Scenario:
    where = [f"{what} before the door of {whose}" for what, whose in (("ice", ice), ("mud", mud)) if whose]
    return Scenario(
        name,
        f"{'training' if training else 'test'}: {', '.join(where)}",
        lambda _domain: GOAL,
        partial(draw, ice=ice, mud=mud),
        sample_unseen=partial(draw, ice=ice, mud=mud, physics=UNSEEN),
        training=training,
        after_stage=stage,
    )


SCENARIOS = (
    _scenario("0", 1, ice="o1", training=True),
    _scenario("1", 1, ice="o2"),
    _scenario("2", 1, ice="target"),
    _scenario("3", 2, mud="o1"),
    _scenario("4", 2, mud="o2"),
    _scenario("5", 2, ice="o1", mud="o2"),
    _scenario("6", 2, ice="o2", mud="o1", training=True),
    _scenario("7", 2, mud="target"),
    _scenario("8", 2, ice="o1", mud="target"),
    _scenario("9", 2, ice="o2", mud="target"),
    _scenario("10", 2, ice="target", mud="o1"),
    _scenario("11", 2, ice="target", mud="o2"),
)

ICY_TRANSPORT = Domain(
    name="icy-transport",
    types=(CAR, ITEM, ICE, MUD),
    predicates=(HAND_EMPTY, HOLDING, DELIVERED),
    classifiers={"HandEmpty": hand_empty, "Holding": holding, "Delivered": delivered},
    operators=(PICK, PLACE),
    scenarios={s.name: s for s in SCENARIOS},
    embodiment=Embodiment(
        actions={
            "forward": (-MOST_FORCE, MOST_FORCE),
            "sideways": (-MOST_FORCE, MOST_FORCE),
            "steer": (-MOST_STEER, MOST_STEER),
        },
        rate_hz=RATE_HZ,
        simulate=Floor,
        skills=skills,
    ),
    stages=(
        Stage(recovery="IcyDrive", scenario="0", horizon=30),
        Stage(recovery="MuddyDrive", scenario="6", horizon=30),
    ),
    free=free,
    instruction="Drive through the ice or mud that lies before the doorway.",
    relations={pair: _blind_to_targets(*pair) for pair in ((CAR, ITEM), (ITEM, ICE), (ITEM, MUD), (ITEM, ITEM))},
)
