"""A robot that exists on paper only: cups that are opened, cleaned and filled, and skills that do as they are told."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from resync_robot.core.joints import JointTarget
from resync_robot.core.skill import GroundSkill, Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Atoms, GroundOperator, Object, Operator, Predicate, Type
from resync_robot.core.symbols import Variable as V
from resync_robot.core.world import Observation
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.execute import EpisodeEnd, Listener, Model
from resync_robot.planning.search import Plan

CUP = Type("cup", ("open", "full", "clean"))
"""A cup is opened, cleaned and filled; each feature is 0 or 1, and each predicate reads one."""
A, B = CUP("a"), CUP("b")
PREDICATES = tuple(Predicate(name, (CUP,)) for name in ("Open", "Full", "Clean"))
OPEN, FULL, CLEAN = PREDICATES
X = V("?x", CUP)
UNLID = Operator("Unlid", (X,), add=frozenset({OPEN(X)}))
FILL = Operator("Fill", (X,), frozenset({OPEN(X), CLEAN(X)}), frozenset({FULL(X)}))
WIPE = Operator("Wipe", (X,), add=frozenset({CLEAN(X)}))
LIMIT = (1.0,) * 6


@dataclass
class Kitchen:
    """A `World` of cups. Skills write to `wanted`; each control step makes it true."""

    state: State
    time: float = 0.0
    pace: float = 1.0
    """Share of full speed; each control step takes the longer."""
    log: list[str] = field(default_factory=list)
    wanted: Callable[[State], State] | None = None

    def observe(self, live: bool = False) -> Observation:
        self.log.append(f"observe live={live}")
        return Observation(time=self.time, state=self.state)

    def act(self, target: JointTarget, duration: float) -> None:
        self.time += duration / self.pace
        self.log.append(f"act {duration}")
        if self.wanted:
            self.state, self.wanted = self.wanted(self.state), None

    def perceive(self) -> State:
        return self.state

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        self.log.append(f"limit {limit}")


@dataclass
class Toy:
    """A policy: `change` the world in its second step, then end with `outcome`; None goes on for ever."""

    kitchen: Kitchen
    change: Callable[[State], State]
    outcome: SkillOutcome | None
    steps: int = 0

    def step(self, observation: Observation) -> JointTarget | SkillOutcome:
        self.steps += 1
        if self.steps == 2:
            self.kitchen.wanted = self.change
        return self.outcome if self.outcome and self.steps > 2 else JointTarget(np.zeros(6), 0.0)


def setting(feature: str, value: float = 1.0) -> Callable[[Object], Callable[[State], State]]:
    return lambda cup: lambda state: state.with_features(cup, **{feature: value})


def nothing(cup: Object) -> Callable[[State], State]:
    return lambda state: state


def kitchen(**true: str) -> Kitchen:
    """Cups a and b; keywords say of which cup a feature holds, such as open="ab"."""
    return Kitchen(State({cup: np.array([float(cup.name in true.get(f, "")) for f in CUP.features]) for cup in (A, B)}))


def model(world: Kitchen, **changes: object) -> Model:
    """All three skills; a keyword replaces what one does: (object -> change of the state, outcome)."""
    done = SkillOutcome(SkillEnd.DONE)
    does = {"Unlid": (setting("open"), done), "Fill": (setting("full"), done), "Wipe": (setting("clean"), done)}
    does |= {k: v for k, v in changes.items() if k in does}

    def skill(name: str) -> Skill:
        change, outcome = does[name]
        return Skill(name, (CUP,), lambda objects, first: Toy(world, change(objects[0]), outcome), 10.0, 2.0)

    def reader(feature: str) -> Callable[[State, tuple[Object, ...]], float]:
        return lambda state, objects: float(state.get(objects[0], feature)[0])

    classifiers = {p.name: reader(p.name.lower()) for p in PREDICATES}
    return Model(
        {name: skill(name) for name in does},
        Abstraction(PREDICATES, classifiers),
        changes.get("operators", (UNLID, FILL, WIPE)),
        changes.get("learned", {}),
    )


class Notes(Listener):
    """Writes down what it hears."""

    def __init__(self, decline: str = "") -> None:
        self.heard: list[str] = []
        self.reasons: list[str] = []
        self.failed: list[str] = []
        self.seen: list[Mapping[Atom, float]] = []
        self.decline = decline

    def on_perceived(self, state: State, atoms: Mapping[Atom, float]) -> None:
        self.heard.append("perceived")
        self.seen.append(atoms)

    def on_plan(self, plan: Plan, reason: str) -> None:
        self.heard.append(f"plan {plan}")
        self.reasons.append(reason)

    def on_step_of_plan(self, index: int) -> None:
        self.heard.append(f"step {index}")

    def on_skill_start(self, skill: GroundSkill) -> None:
        self.heard.append(f"start {skill}")

    def on_control(self, observation: Observation, target: JointTarget) -> None:
        self.heard.append("control")

    def on_skill_end(self, skill: GroundSkill, outcome: SkillOutcome) -> None:
        self.heard.append(f"end {skill} {outcome.ending.value}")

    def on_effects_missing(self, step: GroundOperator) -> None:
        self.failed.append(str(step))

    def on_end(self, end: EpisodeEnd, reason: str) -> None:
        self.heard.append(f"over: {end.value}")

    def confirm(self, step: GroundOperator) -> bool:
        self.heard.append(f"may {step}?")
        return str(step) != self.decline

    @property
    def plans(self) -> list[str]:
        return [h.removeprefix("plan ") for h in self.heard if h.startswith("plan ")]


GOAL: Atoms = frozenset({FULL(A)})
