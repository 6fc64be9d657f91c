"""Dreaming in any domain: tasks before and after each recovery, around every object it could be about (section 3.2).

A dream begins with a scene in which nothing obstructs anything, and places the causes of the failures that are known so
far: each of them not at all, as before its recovery, or as after it, beside one of the objects that the failure could
be about. The task is then solved with all that is known. Only with every such combination do the data tell "this one
is free" from "all are free", and the causes of one failure from those of another.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count as count_from
from itertools import product

import numpy as np

from resync_robot.core.embodiment import Embodiment
from resync_robot.core.errors import TrainingError
from resync_robot.core.skill import GroundSkill
from resync_robot.core.state import State
from resync_robot.core.symbols import Atoms, Object, Term, Type
from resync_robot.core.task import Domain, Task
from resync_robot.core.trajectory import Trajectory, Transition
from resync_robot.learning.dataset import ATTEMPT
from resync_robot.learning.failures import FailureModel, place_beside
from resync_robot.planning.execute import ExecuteSettings, Model, plan_and_execute
from resync_robot.planning.outcome_costs import JitteredCosts
from resync_robot.planning.skill_run import run_skill, what_was_done
from resync_robot.sim_training.recovery_problem import brought_about
from resync_robot.sim_training.wandering import wander

WHEN = ("before", "after")
BEYOND = 1.5
"""How far attempts are spread: from where a skill fails (0) over where its recovery leads (1) to further on."""
UNPLACED = 0.5
"""Share of dreams in which the causes of a failure that takes no part are there all the same."""
REDRAWN = 20
"""Scenes that are drawn until one stands."""
WANDERED = 0.2
"""Wanderings for each attempt: of what a skill ends a handful of cases has to be seen."""


@dataclass(frozen=True)
class Placement:
    """What is done with the causes of one failure.

    Attributes:
        failure: whose; its place in the order learned.
        when: "before" or "after".
        reference: beside which of the objects that the failure could be about, by their order.
    """

    failure: int
    when: str
    reference: int


@dataclass(frozen=True)
class Dream:
    """Which dream to have.

    Attributes:
        placements: for each known failure that takes part, where its causes are.
        attempt: a single attempt with the causes anywhere between before and after, and no recovery.
        wander: skills in an order that no plan has.
    """

    placements: tuple[Placement, ...]
    seed: int
    attempt: bool = False
    wander: bool = False

    @property
    def source(self) -> str:
        """What its trajectories are named after."""
        aimless = self.attempt or self.wander
        return ATTEMPT if aimless else " ".join(f"{p.when}{p.failure + 1}@{p.reference}" for p in self.placements)


@dataclass(frozen=True)
class Dreamer:
    """What dreams are made of.

    Attributes:
        failures: all that are known, in the order learned; the newest last.
        model: what is planned with; its skills hold every recovery.
        usual: objects of each type in the training scenes.
    """

    domain: Domain
    embodiment: Embodiment
    failures: tuple[FailureModel, ...]
    model: Model
    usual: Mapping[Type, int]

    def references(self, failure: FailureModel) -> int:
        """Objects that its causes are put beside: those of a training scene, and one more, which has no part in the
        goal; where a scene can have so many."""
        wanted = self.usual.get(failure.relevant, 0) + 1
        scene = self._free({**self.usual, failure.relevant: wanted}, np.random.default_rng(0), 0)
        return min(wanted, len(_others(scene.initial, failure)))

    def combinations(self) -> list[tuple[Placement, ...]]:
        """Every failure absent, or before or after its recovery beside each reference; all absent left out."""
        ways = [
            [None, *(Placement(i, when, k) for when in WHEN for k in range(self.references(f)))]
            for i, f in enumerate(self.failures)
        ]
        return [found for way in product(*ways) if (found := tuple(p for p in way if p is not None))]

    def dreams(self, count: int, attempts: int, first_seed: int) -> list[Dream]:
        """An equal quota for every combination, then the attempts, half of them about the newest failure, and then the
        wanderings, all about that."""
        every = self.combinations()
        order = np.random.default_rng(first_seed).permutation(len(every))
        shared = [every[order[i % len(every)]] for i in range(count)]
        dreams = [Dream(placements, first_seed + i) for i, placements in enumerate(shared)]
        singles = [c for c in every if len(c) == 1 and c[0].when == "before"]
        newest = [c for c in singles if c[0].failure == len(self.failures) - 1]
        older = [c for c in singles if c not in newest] or newest
        tried = [(of := (newest, older)[i % 2])[i // 2 % len(of)] for i in range(attempts)]
        wandered = [newest[i % len(newest)] for i in range(round(WANDERED * attempts))]
        seeds = count_from(first_seed + count)
        return [
            *dreams,
            *(Dream(p, next(seeds), attempt=True) for p in tried),
            *(Dream(p, next(seeds), wander=True) for p in wandered),
        ]

    # -- one dream -----------------------------------------------------------------------------------------------------

    def task(self, dream: Dream, again: int = 0) -> Task:
        """The counterfactual initial state; another one for each number `again`."""
        rng = np.random.default_rng([dream.seed, again])
        if dream.attempt and self.domain.practice is not None:
            return self.domain.practice(rng, dream.seed)
        task = self._free(self._counts(dream, rng), rng, dream.seed)
        state = task.initial
        for p in dream.placements:
            state = self._placed(state, self.failures[p.failure], p, dream.attempt, rng)
        return replace(task, initial=state)

    def _free(self, counts: Mapping[Type, int], rng: np.random.Generator, seed: int) -> Task:
        """A scene in which nothing obstructs anything."""
        if self.domain.free is None:
            raise TrainingError(
                f"the domain {self.domain.name} has no scene to dream in", "give it free=, see docs/own-domain.md"
            )
        return self.domain.free(rng, seed, counts)

    def _counts(self, dream: Dream, rng: np.random.Generator) -> dict[Type, int]:
        """How many objects of each type a dream has at least. Causes that take no part are sometimes there, unplaced:
        that something is there is not yet that it obstructs."""
        counts = Counter(self.usual)
        parts = {p.failure: p for p in dream.placements}
        for i, failure in enumerate(self.failures):
            if i in parts:
                counts[failure.relevant] = max(counts[failure.relevant] + int(rng.integers(2)), parts[i].reference + 1)
            if i in parts or rng.random() < UNPLACED:
                for kind, n in Counter(o.type for o in failure.causes).items():
                    counts[kind] = max(counts[kind], n)
        return dict(counts)

    def _placed(
        self, state: State, failure: FailureModel, p: Placement, spread: bool, rng: np.random.Generator
    ) -> State:
        reference = reference_of(state, failure, p.reference)
        for known, cause in zip(failure.causes, causes_of(state, failure), strict=True):
            before, after = failure.before[known].sample(rng), failure.after[known].sample(rng)
            share = _somewhere(rng) if spread else float(p.when == "after")
            state = place_beside(self.domain, state, cause, reference, before + share * (after - before), rng)
            # What is there or not, as a region that is active, has nothing in between.
            recovered = int(rng.random() < share)
            values = {name: pair[recovered] for name, pair in failure.changed.get(known, {}).items()}
            state = state.with_features(cause, **values)
        return state

    def live(self, dream: Dream) -> list[Trajectory]:
        """Live through one dream; empty where no scene of it stands.

        A failure that a recovery is known for is followed by it at once. One that leaves the robot in no condition for
        it, with something in its hand, say, begins again with the recovery first, which only a resettable world allows.
        Failed attempts are kept: they tell a classifier where its boundary lies.
        """
        for again in range(REDRAWN):
            task = self.task(dream, again)
            simulator = self.embodiment.simulate(task)
            if simulator.reset(task.initial):
                break
        else:
            return []
        # Of plans that are as good each dream has its own: else it would always be the same thing that is done first.
        model = replace(self.model, costs=JitteredCosts(self.model.costs, dream.seed))
        if dream.attempt:
            result = plan_and_execute(simulator, model, task.goal, ExecuteSettings(max_failures=1))
            return [Trajectory(result.transitions, task.goal, result.success, dream.source)]
        if dream.wander:
            rng = np.random.default_rng([dream.seed, REDRAWN])  # no scene is drawn with it
            recoveries, placement = {f.recovery for f in self.failures}, dream.placements[0]
            walk = wander(simulator, model, task, lambda s: self._recovery(placement, s), recoveries, rng)
            return [Trajectory(walk, task.goal, False, dream.source)] if walk else []
        # The newest first: the older ones are planned for.
        wanted = [p for p in reversed(dream.placements) if p.when == "before"]
        left = list(wanted)

        def react(failed: GroundSkill, state: State) -> GroundSkill | None:
            for p in left:
                failure = self.failures[p.failure]
                about = reference_of(state, failure, p.reference)
                first = failed.first
                if failure.skill == first.name and (failure.argument is None or about in first.objects):
                    left.remove(p)
                    return self._recovery(p, state, first.objects)
            return None

        # What is known of the other failures may be wrong after a recovery that it has never seen. Only to try says so.
        settings = ExecuteSettings(max_failures=1 + len(wanted), retry=True)
        result = plan_and_execute(simulator, model, task.goal, settings, reaction=react)
        found = [self._until_in_vain(Trajectory(result.transitions, task.goal, result.success, dream.source))]
        done = {(t.skill, t.objects) for t in result.transitions if t.succeeded}
        missed = [p for p in wanted if (g := self._recovery(p, task.initial)) and (g.name, g.objects) not in done]
        if not result.success and missed:
            found.append(self._recovered_first(dream, task, missed))
        return found

    def _until_in_vain(self, lived: Trajectory) -> Trajectory:
        """Up to the first recovery that failed, and that another one did not follow: what fails behind it may fail of
        the mess that it left."""
        tried = [t.skill in {f.recovery for f in self.failures} for t in lived.transitions]
        for i, (t, recovery) in enumerate(zip(lived.transitions, tried, strict=True)):
            if recovery and not t.succeeded and not any(tried[i + 1 : i + 2]):
                return replace(lived, transitions=lived.transitions[: i + 1], solved=False)
        return lived

    def _recovered_first(self, dream: Dream, task: Task, placements: Sequence[Placement]) -> Trajectory:
        simulator = self.embodiment.simulate(task)
        simulator.reset(task.initial)
        done: list[Transition] = []
        for p in placements:
            ready, prepared = brought_about(simulator, self.model, self._needs(p, task.initial))
            done += prepared
            if not ready:
                return Trajectory(tuple(done), task.goal, False, dream.source)
            before = simulator.perceive()
            ground = self._recovery(p, before)
            ran, well = what_was_done(ground, run_skill(simulator, ground))
            done.append(Transition(before, ran.name, ran.objects, simulator.perceive(), well))
        rest = plan_and_execute(simulator, self.model, task.goal, ExecuteSettings(max_failures=1))
        solved = rest.success and all(t.succeeded for t in done)
        return Trajectory((*done, *rest.transitions), task.goal, solved, dream.source)

    def _needs(self, p: Placement, state: State) -> Atoms:
        """What has to hold of the world for the failed skill to be begun, as far as was given and is about nothing else
        than the failure is. The recovery was only ever begun there. Not what holds of the robot: it may be its full
        hand that leaves no room."""
        failure = self.failures[p.failure]
        operator = next((o for o in self.domain.operators if o.name == failure.skill), None)
        if operator is None:
            return frozenset()
        bound: dict[Term, Object] = {}
        if failure.argument is not None:
            bound[operator.parameters[failure.argument]] = reference_of(state, failure, p.reference)
        known = (a for a in operator.preconditions if all(term in bound for term in a.args))
        return frozenset(a.substitute(bound) for a in known)

    def _recovery(self, p: Placement, state: State, failed: Sequence[Object] = ()) -> GroundSkill:
        """The recovery for a placement.

        Args:
            failed: the objects of the skill that failed, for what else the recovery takes.
        """
        failure = self.failures[p.failure]
        skill = self.model.skill(failure.recovery)
        robot = state.of_type(skill.types[0])[0]
        about = reference_of(state, failure, p.reference), *causes_of(state, failure)
        objects = list(dict.fromkeys((robot, *about)))
        for kind in skill.types[len(objects) :]:
            others = [o for o in (*failed, *sorted(state.of_type(kind), key=_by_name)) if o.type == kind]
            objects.append(next(o for o in others if o not in objects))
        return skill.ground(tuple(objects))


def _somewhere(rng: np.random.Generator) -> float:
    """A share of the way from before to after, or beyond; half of the time a small one, for nobody knows how little it
    takes."""
    return float(BEYOND * rng.random() ** (3 if rng.random() < 0.5 else 1))


def reference_of(state: State, failure: FailureModel, number: int) -> Object:
    """The so manieth object that the failure could be about. Raises TrainingError."""
    there = _others(state, failure)
    if number >= len(there):
        raise TrainingError(
            f"a scene to dream in has {len(there)} objects of type {failure.relevant.name}, {number + 1} are needed",
            "let the domain's free() draw as many as it is asked for",
        )
    return there[number]


def _others(state: State, failure: FailureModel) -> list[Object]:
    """All that the failure could be about, by name."""
    return sorted((o for o in state.of_type(failure.relevant) if o not in failure.causes), key=_by_name)


def causes_of(state: State, failure: FailureModel) -> tuple[Object, ...]:
    """The causes of a failure in a scene: by name, else others of their type. Raises TrainingError."""
    found: list[Object] = []
    for cause in failure.causes:
        others = [o for o in sorted(state.of_type(cause.type), key=_by_name) if o not in found]
        if not others:
            raise TrainingError(
                f"a scene to dream in has no {cause.type.name} that could stand in the way",
                "let the domain's free() draw as many objects of each type as it is asked for",
            )
        found.append(cause if cause in others else others[0])
    return tuple(found)


def _by_name(obj: Object) -> tuple[int, str]:
    """b2 before b10."""
    return len(obj.name), obj.name


def tally(trajectories: Sequence[Trajectory]) -> dict[str, dict[str, int]]:
    """By source: what was dreamed, and solved."""
    counts: dict[str, dict[str, int]] = {}
    for t in trajectories:
        row = counts.setdefault(t.source, {"dreamed": 0, "solved": 0})
        row["dreamed"] += 1
        row["solved"] += t.solved
    return counts
