"""Plan and execute (the paper's Plan_f): look, plan, run a skill until its beta or its time limit, look again, replan.

The only such loop. Training, evaluation and deployment run this very function; they differ in the world and the model
they hand in.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

from resync_robot.core.errors import PlanningError, UnknownNameError
from resync_robot.core.skill import GroundSkill, Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Atoms, GroundOperator, Object, Operator
from resync_robot.core.trajectory import Transition
from resync_robot.core.world import World
from resync_robot.planning.abstract import HOLDS, Abstraction
from resync_robot.planning.atom_beliefs import AtomBeliefs, BeliefSettings
from resync_robot.planning.effect_hypotheses import plan_or_suppose, with_relaxed_recoveries
from resync_robot.planning.failures import Failures
from resync_robot.planning.outcome_costs import OutcomeCosts
from resync_robot.planning.search import Plan, plan
from resync_robot.planning.skill_run import SkillListener, looks, run_for, run_skill, what_was_done


@dataclass(frozen=True)
class Model:
    """What is planned with: skills, abstraction, operators (the paper's C, Psi, Op), and what experience adds.

    Attributes:
        learned: name of each learned predicate -> held-out error of its classifier, None where nobody measured it.
            Outcomes of skills may contradict what such a classifier sees.
        costs: of steps, by the outcomes of practice.
    """

    skills: Mapping[str, Skill]
    abstraction: Abstraction
    operators: tuple[Operator, ...]
    learned: Mapping[str, float | None] = field(default_factory=dict)
    costs: OutcomeCosts = field(default_factory=OutcomeCosts)

    def skill(self, name: str) -> Skill:
        if name not in self.skills:
            raise UnknownNameError("skill", name, list(self.skills))
        return self.skills[name]


UNLIKELY = 0.01
"""Probability of an atom, at least, for a plan that relies on it all the same."""


class Reaction(Protocol):
    """What a reactive method does about a failed skill (Recovery Chaining); the default does nothing."""

    def __call__(self, failed: GroundSkill, state: State) -> GroundSkill | None: ...


class EpisodeEnd(Enum):
    GOAL = "goal"
    NO_PLAN = "no plan"
    STUCK = "stuck"
    """The same skill failed too often, and its objects are where they were."""
    EXHAUSTED = "exhausted"
    """Too many skills were run."""
    PLANNED = "planned"
    """A plan was found, and none of it was to be run."""
    STOPPED = "stopped"
    """The user declined a step, or ended the program."""
    FAULT = "fault"
    """The scene could not be perceived, or a motion was refused."""


@dataclass(frozen=True)
class EpisodeResult:
    """How an episode ended, every attempt it made, and the control steps of all skills together."""

    end: EpisodeEnd
    reason: str
    transitions: tuple[Transition, ...]
    plans: tuple[Plan, ...]
    final: State
    steps: int = 0

    @property
    def success(self) -> bool:
        return self.end is EpisodeEnd.GOAL


class Listener(SkillListener):
    """Hears what happens; recorders override what they need."""

    def on_perceived(self, state: State, atoms: Mapping[Atom, float]) -> None: ...

    def on_plan(self, plan: Plan, reason: str) -> None: ...

    def on_step_of_plan(self, index: int) -> None: ...

    def on_effects_missing(self, step: GroundOperator) -> None:
        """What was perceived after the step says that it did not do what it should, whatever its skill said."""

    def on_end(self, end: EpisodeEnd, reason: str) -> None: ...

    def confirm(self, step: GroundOperator) -> bool:
        """May this step run? Asked before each one."""
        return True


@dataclass(frozen=True, kw_only=True)
class ExecuteSettings:
    max_skills: int = 24
    """One more try with a block that had to be put down takes four."""
    max_failures: int = 5
    """Failures of one ground skill, with its objects where they were, after which the episode is given up. A skill that
    breaks off in time often leaves things better than they were, and the next attempt begins from there."""
    horizon: int | None = None
    """Control steps, of all skills together, after which the episode is given up; None for no such limit."""
    heuristic: str = "lmcut"
    suppose: bool = True
    """Where no plan exists by all that is likely: suppose, as a last resort, that a step ends a relation that no
    operator says it ends. Needed as long as operators are learned that leave out such effects."""
    retry: bool = False
    """What a reaction has mended is tried again at once, whatever is believed of it."""
    plan_only: bool = False
    """End with the first plan, and run none of it."""
    beliefs: BeliefSettings = BeliefSettings()


def plan_and_execute(
    world: World,
    model: Model,
    goal: Atoms,
    settings: ExecuteSettings | None = None,
    listener: Listener | None = None,
    reaction: Reaction | None = None,
) -> EpisodeResult:
    """Reach `goal` in `world` with what `model` knows: the paper's Plan_f."""
    s, listener = settings or ExecuteSettings(), listener or Listener()
    run = _Episode(world, model, goal, s, listener)
    failures = Failures()
    reason = "start"
    run.look()
    while True:
        if goal <= run.beliefs.certain():
            return run.ended(EpisodeEnd.GOAL)
        try:
            found = run.plan(reason)
        except PlanningError as error:
            return run.ended(EpisodeEnd.NO_PLAN, error.what)
        if not found.steps:
            return run.ended(EpisodeEnd.GOAL, "as far as can be told: not all of it is certain")
        if s.plan_only:
            return run.ended(EpisodeEnd.PLANNED, f"{len(found.steps)} steps")
        reason = "the plan ended short of the goal"
        for index, step in enumerate(found.steps):
            if found.goes_without(index, run.atoms, goal):
                continue
            if lack := run.spoilt(found, index):
                reason = f"{lack[0]} needs {', '.join(map(str, sorted(lack[1])))}"
                break
            if limit := run.limit_reached():
                return run.ended(EpisodeEnd.EXHAUSTED, limit)
            listener.on_step_of_plan(index)
            if not listener.confirm(step):
                return run.ended(EpisodeEnd.STOPPED, f"{step} was declined")
            before = run.state
            outcome, came_true = run.attempt(step)
            if came_true:
                run.in_vain.clear()
                continue
            listener.on_effects_missing(step)
            words = outcome.reason or "effects missing"
            reason = f"{step} did not do what it should ({outcome.ending.value}: {words})"
            run.in_vain[str(step)] += 1
            if failures.count(step, before, run.state) >= s.max_failures:
                return run.ended(EpisodeEnd.STUCK, reason)
            failed = model.skill(step.name).ground(step.objects)
            if reaction and (recovery := reaction(failed, run.state)) is not None:
                mended = run.react(recovery)
                before = run.state
                if s.retry and mended and not run.limit_reached() and not run.attempt(step)[1]:
                    failures.count(step, before, run.state)
            break


class _Episode:
    """One run of `plan_and_execute`: what is seen and believed, what was planned, and what was done."""

    def __init__(self, world: World, model: Model, goal: Atoms, settings: ExecuteSettings, listener: Listener) -> None:
        self._world, self._model, self._goal, self._settings, self._listener = world, model, goal, settings, listener
        self.beliefs = AtomBeliefs(model.learned, model.costs, settings.beliefs)
        self.state = State({})
        self.atoms: Atoms = frozenset()
        """What plans may build on now: what is certain, and what the current plan relies on as long as it is likely."""
        self.in_vain: Counter[str] = Counter()
        """Steps that failed since the last one that did not, in words, and how often."""
        self._plans: list[Plan] = []
        self._transitions: list[Transition] = []
        self._supposed: set[str] = set()
        self._steps = 0
        """Of control, so far."""

    def look(self) -> None:
        self.state = self._world.perceive()
        self.beliefs.perceived(self._model.abstraction.shares(self.state))
        self._looked()

    def _looked(self) -> None:
        likely = self.beliefs.likely()
        relied_on = self._plans[-1].relies_on if self._plans else frozenset()
        self.atoms = self.beliefs.certain() | {a for a in relied_on if a in likely}
        self._listener.on_perceived(self.state, self.beliefs.shown())

    def plan(self, reason: str) -> Plan:
        """A plan by what is certain; else by what is likely, too; else by a supposition. Raises PlanningError."""
        model, s, objects = self._model, self._settings, self.state.objects
        certain, likely = self.beliefs.certain(), self.beliefs.likely()
        try:
            found = plan(
                model.operators,
                objects,
                certain,
                self._goal,
                s.heuristic,
                costs=model.costs,
                failed=self.in_vain,
            )
        except PlanningError as error:
            found, trust = self._plan_on_trust(error, certain, likely)
            reason = f"{reason}; no plan otherwise, {trust}"
        self.atoms = found.atoms
        self._plans.append(found)
        if found.steps:
            self._listener.on_plan(found, reason)
        return found

    def _plan_on_trust(self, error: PlanningError, certain: Atoms, likely: Mapping[Atom, float]) -> tuple[Plan, str]:
        """A plan, and what it trusts in; `error` says why there is no other. Raises PlanningError."""
        model, s, objects = self._model, self._settings, self.state.objects
        operators, goal, heuristic, costs = model.operators, self._goal, s.heuristic, model.costs
        if likely:
            try:
                found = plan(
                    operators,
                    objects,
                    certain,
                    goal,
                    heuristic,
                    costs=costs,
                    likely=likely,
                    failed=self.in_vain,
                )
                return found, "relying on " + ", ".join(f"{a} ({likely[a]:.2f})" for a in sorted(found.relies_on))
            except PlanningError:
                pass
        if not s.suppose:
            raise error
        most_likely = certain | {a for a, p in likely.items() if p > HOLDS}
        try:
            found, supposed = plan_or_suppose(
                operators, model.abstraction, objects, most_likely, goal, heuristic, self._supposed, costs
            )
        except PlanningError:
            return self._plan_regardless(error, certain)
        self._supposed.add(supposed)
        return found, f"perhaps {supposed}"

    def _plan_regardless(self, error: PlanningError, certain: Atoms) -> tuple[Plan, str]:
        """A plan that relies on what is unlikely, too, and in which a recovery needs nothing of what was given: perhaps
        it was just never tried otherwise. Raises `error` where there is none."""
        model, heuristic = self._model, self._settings.heuristic
        relaxed = with_relaxed_recoveries(model.operators, model.learned)
        unlikely = {a: max(p, UNLIKELY) for a, p in self.beliefs.doubted().items()}
        try:
            found = plan(
                relaxed,
                self.state.objects,
                certain,
                self._goal,
                heuristic,
                costs=model.costs,
                likely=unlikely,
                failed=self.in_vain,
            )
        except PlanningError:
            raise error from None
        return found, "against what is known"

    def spoilt(self, found: Plan, index: int) -> tuple[GroundOperator, Atoms] | None:
        """The step of a plan that cannot be run any more, from that of `index` on, and what is not there for it.

        Of a later one only what is believed to be false counts, for what is in doubt may be seen by then: that a block
        which a lid hid is in a corner is to be known before something is built for it.
        """
        lack = found.lacks(index, self.atoms)
        if lack is None or lack[0] is found.steps[index]:
            return lack
        foreseen = found.reaches(self._goal) and not lack[1] <= self.beliefs.likely().keys()
        return lack if foreseen else None

    def limit_reached(self) -> str:
        """Which limit of the loop is reached, in words; "" for none."""
        s = self._settings
        if len(self._transitions) >= s.max_skills:
            return f"{len(self._transitions)} skills were run"
        if s.horizon is not None and self._steps >= s.horizon:
            return f"{self._steps} control steps were taken"
        return ""

    def attempt(self, step: GroundOperator) -> tuple[SkillOutcome, bool]:
        """Run a step, look, and learn from the outcome; also whether its effects came true."""
        before, ground = self.state, self._model.skill(step.name).ground(step.objects)
        outcome = self._run(ground)
        done, well = what_was_done(ground, outcome)
        if done != ground and (other := self._operator(done)) is not None:
            # A recovery that nothing called for: what it mends works, so what that needs is there.
            mended = SkillOutcome(SkillEnd.DONE)
            well = self.beliefs.attempted(other, mended, self._seen_after(other, mended))
            came_true = step.add <= self.beliefs.certain()
        else:
            well = came_true = self.beliefs.attempted(step, outcome, self._seen_after(step, outcome))
        self._looked()
        self._transitions.append(Transition(before, done.name, done.objects, self.state, well))
        return outcome, came_true

    def _seen_after(self, step: GroundOperator, outcome: SkillOutcome) -> dict[Atom, float]:
        """Look, and again as long as the skill's word and the sight of given atoms disagree. Of learned ones beliefs
        weigh the word against the classifier."""
        seen: dict[Atom, float] = {}
        for state in looks(self._world, outcome):
            self.state, seen = state, self._model.abstraction.shares(state)
            given = {a: share > HOLDS for a, share in seen.items() if a.predicate.name not in self._model.learned}
            if all(given.get(a, True) for a in step.add) and not any(given.get(a, False) for a in step.delete):
                break
        return seen

    def _operator(self, ground: GroundSkill) -> GroundOperator | None:
        lifted = next((op for op in self._model.operators if op.name == ground.name), None)
        return None if lifted is None else lifted.ground(ground.objects, tuple(self.state.objects))

    def react(self, recovery: GroundSkill) -> bool:
        """Run what a reactive method wants; whether it says that it is done."""
        before = self.state
        outcome = self._run(recovery)
        self.look()
        done, well = what_was_done(recovery, outcome)
        self._transitions.append(Transition(before, done.name, done.objects, self.state, well))
        return outcome.done

    def _run(self, ground: GroundSkill) -> SkillOutcome:
        horizon = self._settings.horizon
        outcome, steps = run_for(
            self._world, ground, self._listener, None if horizon is None else horizon - self._steps
        )
        self._steps += steps
        return outcome

    def ended(self, end: EpisodeEnd, why: str = "") -> EpisodeResult:
        self._listener.on_end(end, why)
        return EpisodeResult(end, why, tuple(self._transitions), tuple(self._plans), self.state, self._steps)


def begin_after(
    world: World,
    model: Model,
    steps: Sequence[tuple[str, tuple[str, ...]]],
    objects: Sequence[Object],
    listener: Listener | None = None,
) -> bool:
    """Run the skills that a scenario begins after, by their names and those of their objects.

    Returns:
        Whether each of them said that it is done; the first that does not is the last that was run.
    """
    if not steps:
        return True
    named = {o.name: o for o in objects}
    # A skill needs to know where things are.
    world.perceive()
    return all(
        run_skill(world, model.skill(name).ground(tuple(named[o] for o in of)), listener).done for name, of in steps
    )
