"""Failure mining in any domain: attempt tasks until a skill fails, and keep where it failed and what it ran into."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from resync_robot.core.embodiment import Embodiment, Stage, TrainingSimulator
from resync_robot.core.errors import TrainingError
from resync_robot.core.skill import GroundSkill, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.task import Domain, Task
from resync_robot.learning.failures import spread_beside
from resync_robot.planning.execute import ExecuteSettings, Listener, Model, plan_and_execute
from resync_robot.planning.outcome_costs import JitteredCosts
from resync_robot.planning.skill_run import run_skill

LATELY = 5
"""Last moments of an attempt with contacts that count, and moments without any after which earlier ones do not: what
stops a skill is what it runs into last."""
CLEARER = 0.5
"""Share of the spread beside an argument of the failed skill, below which another object tells better where the culprit
lies."""
MOST_BLAMED = 0.5
"""Share of the failures in which an object has to be run into, to be blamed for them."""


@dataclass(frozen=True)
class FailedAttempt:
    """A state in D^F.

    Attributes:
        task: in which it happened.
        before: the state in which the skill was begun.
        state: where the skill left everything.
        skill, objects: C^F, by its name, and what it was applied to.
        run_into: what the robot, or what it held, met last, and how hard: N, or 1.
    """

    task: Task
    before: State
    state: State
    skill: str
    objects: tuple[Object, ...]
    run_into: Mapping[Object, float]


@dataclass(frozen=True)
class Explanation:
    """What the failures of a stage have in common.

    Attributes:
        skill, objects: C^F and what it was applied to.
        relevant: o^R, the object that the failure is about: mostly one of these.
        culprits: o^F, the objects that were run into.
    """

    skill: str
    objects: tuple[Object, ...]
    relevant: Object
    culprits: tuple[Object, ...]

    @property
    def projected(self) -> tuple[Object, ...]:
        """proj(x): the robot, o^R and every o^F; what the recovery sees."""
        return tuple(dict.fromkeys((self.objects[0], self.relevant, *self.culprits)))

    @property
    def parameters(self) -> tuple[Object, ...]:
        """What the recovery is applied to: what it sees, and what else the failed skill needs that it begins with."""
        return tuple(dict.fromkeys((*self.projected, *self.objects)))


class _LastContacts(Listener):
    """What was run into just before each skill ended."""

    def __init__(self, simulator: TrainingSimulator[Any, Any]) -> None:
        self._simulator = simulator
        self._recent: list[Mapping[Object, float]] = []
        self._clear = 0
        self.begun: Any = None
        self.ended: tuple[GroundSkill, Mapping[Object, float]] | None = None

    def on_skill_start(self, skill: GroundSkill) -> None:
        self._recent, self._clear = [], 0
        if skill.first != skill:
            self.begun = self._simulator.save()

    def on_control(self, observation: Any, action: Any) -> None:
        self._touch()

    def _touch(self) -> None:
        # A hand that ran into something may have drawn back from it since; what it touched on its way counts no more.
        if contacts := self._simulator.contacts():
            before = self._recent if self._clear <= LATELY else []
            self._recent, self._clear = [*before, contacts][-LATELY:], 0
        else:
            self._clear += 1

    def on_skill_end(self, skill: GroundSkill, outcome: SkillOutcome) -> None:
        self._touch()
        hardest: dict[Object, float] = {}
        for contacts in self._recent:
            for obj, force in contacts.items():
                hardest[obj] = max(force, hardest.get(obj, 0.0))
        self.ended = skill, hardest


def attempt(embodiment: Embodiment, task: Task, model: Model) -> FailedAttempt | None:
    """Plan and execute up to the first failure. None where nothing fails, or the scene does not stand still.

    Where something was learned already, a skill that fails once may have failed of what is known, as a punch against a
    crate does that nobody had wiggled aside, and the next plan gets past it. So it has to fail twice. A recovery of an
    earlier stage begins with the skill that it mends. Where that fails in a new way, in which the
    recovery does not help, it is that skill which failed.
    """
    simulator = embodiment.simulate(task)
    if not simulator.reset(task.initial):
        return None
    heard = _LastContacts(simulator)
    model = replace(model, costs=JitteredCosts(model.costs, task.seed))
    settings = ExecuteSettings(max_failures=2 if model.learned else 1)
    result = plan_and_execute(simulator, model, task.goal, settings, heard)
    if not result.transitions or result.transitions[-1].succeeded or heard.ended is None:
        return None
    skill, run_into = heard.ended
    if skill.first != skill:
        after = simulator.save()
        simulator.restore(heard.begun)
        if not run_skill(simulator, skill.first, heard).done:
            skill, run_into = heard.ended
        else:
            simulator.restore(after)
    return FailedAttempt(task, result.transitions[-1].before, simulator.perceive(), skill.name, skill.objects, run_into)


def mine_stage(
    domain: Domain, embodiment: Embodiment, stage: Stage, model: Model, first_seed: int, count: int
) -> list[FailedAttempt]:
    """`count` failures of the stage's scenario, from as many tasks as that takes.

    Raises:
        TrainingError: hardly any task fails, so there is nothing to learn from.
    """
    found: list[FailedAttempt] = []
    scenario, most = domain.scenario(stage.scenario), 10 * count + 20
    for seed in range(first_seed, first_seed + most):
        task = scenario.sample_practice(np.random.default_rng(seed), seed)
        failed = attempt(embodiment, task, model)
        if failed is not None:
            found.append(failed)
        if len(found) == count:
            return found
    raise TrainingError(
        f"{len(found)} of {most} tasks of {stage.scenario} failed, {count} failures are needed",
        "train on a scenario that fails, and see what check-domain says of it",
    )


def explain(domain: Domain, failures: Sequence[FailedAttempt]) -> Explanation:
    """Who is to blame, by what the robot ran into.

    Raises:
        TrainingError: nothing was run into in at least half of the failures.
    """
    (skill, objects), _ = Counter((f.skill, f.objects) for f in failures).most_common(1)[0]
    alike = [f for f in failures if (f.skill, f.objects) == (skill, objects)]
    met = Counter(obj for f in alike for obj, force in f.run_into.items() if force > 0 and obj != objects[0])
    blamed = [obj for obj, times in met.most_common() if times >= MOST_BLAMED * len(alike)]
    if not blamed:
        often = ", ".join(f"{obj} in {times}" for obj, times in met.most_common(3)) or "nothing at all"
        raise TrainingError(
            f"no object explains why {skill} failed {len(alike)} times: it ran into {often}",
            "let the simulator's contacts() name what stops a skill",
        )
    return Explanation(skill, objects, _relevant(domain, alike, objects, blamed), tuple(blamed))


def as_explained(failure: FailedAttempt, explanation: Explanation) -> dict[Object, Object] | None:
    """Other names for the objects of a failure, by which it is the one that was explained: the same skill ran into the
    same culprits on its way to something else. Empty where it is that one anyway; None where there are none."""
    if failure.skill != explanation.skill or not all(failure.run_into.get(o, 0.0) > 0 for o in explanation.culprits):
        return None
    pairs = [(a, b) for a, b in zip(failure.objects, explanation.objects, strict=True) if a != b]
    names = {**dict(pairs), **{b: a for a, b in pairs}}
    consistent = all(names[a] == b and names[b] == a and a.type == b.type for a, b in pairs)
    return names if consistent and names.keys().isdisjoint(explanation.culprits) else None


def _relevant(
    domain: Domain, failures: Sequence[FailedAttempt], objects: Sequence[Object], blamed: Sequence[Object]
) -> Object:
    """What the failure is about: the argument of the failed skill that is nearest to the culprit, or another object
    that tells much better where the culprit lies when the skill fails, as the doorway does in which a stone lies."""
    arguments = [o for o in objects[1:] if o not in blamed] or list(objects[1:]) or [objects[0]]
    nearest = min(arguments, key=lambda o: np.mean([_apart(f.state, o, blamed[0]) for f in failures]))
    states = [f.before for f in failures]
    everywhere = [o for o in states[0].objects if all(o in s for s in states)]
    others = [o for o in everywhere if o.type.pose is not None and o not in (*objects, *blamed)]
    if nearest.type.pose is None or not others:
        return nearest
    best = min(others, key=lambda o: (spread_beside(domain, states, blamed[0], o), o.name))
    known = spread_beside(domain, states, blamed[0], nearest)
    return best if spread_beside(domain, states, blamed[0], best) < CLEARER * known else nearest


def _apart(state: State, a: Object, b: Object) -> float:
    """m in the plane; objects without a place are infinitely far away."""
    if a.type.pose is None or b.type.pose is None:
        return float("inf")
    return float(np.linalg.norm(state[a][:2] - state[b][:2]))
