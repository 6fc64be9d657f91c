"""Plan_f: ground, plan, run a skill until its beta or its time limit, ground again, replan. The only such loop.

Training, evaluation and deployment run this very function; they differ in the world and the model they hand in.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

from resync_robot.core.errors import InterruptedMotionError, PlanningError, UnknownNameError
from resync_robot.core.joints import JointTarget
from resync_robot.core.skill import Ending, GroundSkill, Outcome, Skill
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Atoms, GroundOperator, Object, Operator
from resync_robot.core.trajectory import Transition
from resync_robot.core.world import Observation, World
from resync_robot.planning.abstract import HOLDS, Abstraction
from resync_robot.planning.risk import Risk
from resync_robot.planning.search import Plan
from resync_robot.planning.suppose import find_plan


@dataclass(frozen=True)
class Affordance:
    """A learned atom that a skill relies on: after a failure of the skill it is held false until restored; where a
    skill relies on several, the least certain of them.

    Where restoring it fails again and again, it is held true and the skill tried after all: what was learned may be
    wrong about this object.

    Attributes:
        predicate: its name.
        argument: which of the skill's arguments the atom is about.
    """

    predicate: str
    argument: int


@dataclass(frozen=True)
class Model:
    """What Plan_f plans with: skills, abstraction, operators (the paper's C, Psi, Op), and what experience adds."""

    skills: Mapping[str, Skill]
    abstraction: Abstraction
    operators: tuple[Operator, ...]
    affordances: Mapping[str, tuple[Affordance, ...]] = field(default_factory=dict)
    risk: Risk | None = None

    def skill(self, name: str) -> Skill:
        if name not in self.skills:
            raise UnknownNameError("skill", name, list(self.skills))
        return self.skills[name]


class Reaction(Protocol):
    """What a reactive method does about a failed skill (Recovery Chaining); the default does nothing."""

    def __call__(self, failed: GroundSkill, state: State) -> GroundSkill | None: ...


class End(Enum):
    GOAL = "goal"
    NO_PLAN = "no plan"
    STUCK = "stuck"
    """The same skill failed too often."""
    EXHAUSTED = "exhausted"
    """Too many skills were run."""
    PLANNED = "planned"
    """A plan was found, and none of it was to be run."""
    STOPPED = "stopped"
    """The user declined a step, or ended the program."""
    FAULT = "fault"
    """The scene could not be perceived, or a motion was refused."""


@dataclass(frozen=True)
class Result:
    """How an episode of Plan_f ended, and every attempt it made."""

    end: End
    reason: str
    transitions: tuple[Transition, ...]
    plans: tuple[Plan, ...]
    final: State

    @property
    def success(self) -> bool:
        return self.end is End.GOAL


class Listener:
    """Hears what happens; recorders override what they need."""

    def on_perceived(self, state: State, atoms: Mapping[Atom, float]) -> None: ...

    def on_plan(self, plan: Plan, reason: str) -> None: ...

    def on_step_of_plan(self, index: int) -> None: ...

    def on_skill_start(self, skill: GroundSkill) -> None: ...

    def on_control(self, observation: Observation, target: JointTarget) -> None: ...

    def on_skill_end(self, skill: GroundSkill, outcome: Outcome) -> None: ...

    def on_effects_missing(self, step: GroundOperator) -> None:
        """What was perceived after the step says that it did not do what it should, whatever its skill said."""

    def on_end(self, end: End, reason: str) -> None: ...

    def confirm(self, step: GroundOperator) -> bool:
        """May this step run? Asked before each one."""
        return True


@dataclass(frozen=True, kw_only=True)
class ExecuteSettings:
    max_skills: int = 24
    """One more try with a block that had to be put down takes four."""
    max_failures: int = 5
    """Failures of one ground skill after which the episode is given up. A skill that breaks off in time often leaves
    things better than they were, and the next attempt begins from there."""
    give_up_restoring: int = 4
    """Failures of a ground skill that should restore a learned atom, from which on the atom is taken for granted. One
    after which the skill itself says that it is done counts twice: it and what was learned cannot both be right."""
    heuristic: str = "lmcut"
    plan_only: bool = False
    """End with the first plan, and run none of it."""


def plan_f(
    world: World,
    model: Model,
    goal: Atoms,
    settings: ExecuteSettings | None = None,
    listener: Listener | None = None,
    reaction: Reaction | None = None,
) -> Result:
    """Reach `goal` in `world` with what `model` knows."""
    s, listener = settings or ExecuteSettings(), listener or Listener()
    transitions: list[Transition] = []
    plans: list[Plan] = []
    failures: Counter[str] = Counter()
    in_vain: Counter[str] = Counter()
    taught: dict[Atom, bool] = {}
    """What attempts say of learned atoms, against what is seen."""
    relied_on = {affordance.predicate for of in model.affordances.values() for affordance in of}
    supposed_before: set[str] = set()
    state, atoms = _look(world, model, taught, listener)
    reason = "start"

    def ended(end: End, why: str = "") -> Result:
        listener.on_end(end, why)
        return Result(end, why, tuple(transitions), tuple(plans), state)

    while True:
        if goal <= atoms:
            return ended(End.GOAL)
        try:
            found, supposed = find_plan(
                model.operators, model.abstraction, state.objects, atoms, goal, s.heuristic, supposed_before, model.risk
            )
        except PlanningError as error:
            # Doubt that leaves no way to act is no use: believe what is most likely, and try once more.
            likely = model.abstraction.likely_atoms(state)
            if likely == atoms:
                return ended(End.NO_PLAN, error.what)
            atoms, reason = likely, "nothing else is left to try than to believe what is most likely"
            taught.clear()
            if goal <= atoms:
                return ended(End.GOAL, "as far as can be told: not all of it is certain")
            continue
        plans.append(found)
        supposed_before.add(supposed)
        listener.on_plan(found, f"{reason}; no plan otherwise, perhaps {supposed}" if supposed else reason)
        if s.plan_only:
            return ended(End.PLANNED, f"{len(found.steps)} steps")
        for index, step in enumerate(found.steps):
            if not step.applicable(atoms):
                missing = ", ".join(map(str, sorted(step.preconditions - atoms)))
                reason = f"{step} needs {missing}"
                break
            if len(transitions) >= s.max_skills:
                return ended(End.EXHAUSTED, f"{len(transitions)} skills were run")
            listener.on_step_of_plan(index)
            if not listener.confirm(step):
                return ended(End.STOPPED, f"{step} was declined")
            ground = model.skill(step.name).ground(step.objects)
            before = state
            outcome = run_skill(world, ground, listener)
            for atom in step.add:
                taught.pop(atom, None)
            state, atoms = _look(world, model, taught, listener)
            came_true = step.add <= atoms and not (step.delete & atoms)
            transitions.append(Transition(before, step.name, step.objects, state, came_true))
            if came_true:
                continue
            listener.on_effects_missing(step)
            reason = f"{step} did not do what it should ({outcome.ending.value}: {outcome.reason or 'effects missing'})"
            failures[str(step)] += 1
            in_vain[str(step)] += 2 if outcome.done else 1
            if failures[str(step)] >= s.max_failures:
                return ended(End.STUCK, reason)
            if in_vain[str(step)] >= s.give_up_restoring:
                granted = {a for a in step.add - atoms if a.predicate.name in relied_on}
                if granted:
                    reason += f"; {', '.join(sorted(map(str, granted)))} taken for granted now"
                taught |= dict.fromkeys(granted, True)
                atoms |= granted
            distrust = _distrust(model, ground, before)
            if distrust is not None:
                taught[distrust] = False
                atoms = atoms - {distrust}
            recovery = reaction(ground, state) if reaction else None
            if recovery is not None:
                before = state
                outcome = run_skill(world, recovery, listener)
                state, atoms = _look(world, model, taught, listener)
                transitions.append(Transition(before, recovery.name, recovery.objects, state, outcome.done))
            break
        else:
            reason = "the plan ended short of the goal"


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


def run_skill(world: World, ground: GroundSkill, listener: Listener | None = None) -> Outcome:
    """Run one ground skill to its end or its time limit.

    The limit counts control steps: a robot that runs at a fraction of full speed stretches them on its own clock, and
    a skill is not to fail for that.
    """
    listener = listener or Listener()
    skill = ground.skill
    listener.on_skill_start(ground)
    world.limit_effort(skill.effort_limit)
    observation = world.observe(skill.live_state)
    policy = skill.start(ground.objects, observation)
    steps = 0
    while True:
        answer = policy.step(observation)
        if isinstance(answer, Outcome):
            break
        listener.on_control(observation, answer)
        try:
            world.act(answer, 1.0 / skill.rate_hz)
        except InterruptedMotionError as error:
            answer = Outcome(Ending.BLOCKED, error.what)
            break
        steps += 1
        observation = world.observe(skill.live_state)
        if steps > skill.time_limit_s * skill.rate_hz:
            answer = Outcome(Ending.TIMEOUT, f"not done after {skill.time_limit_s:.0f} s")
            break
    world.limit_effort(None)
    listener.on_skill_end(ground, answer)
    return answer


def _look(world: World, model: Model, taught: Mapping[Atom, bool], listener: Listener) -> tuple[State, Atoms]:
    state = world.perceive()
    probabilities = {atom: float(taught.get(atom, p)) for atom, p in model.abstraction.abstract(state).items()}
    listener.on_perceived(state, probabilities)
    return state, frozenset(a for a, p in probabilities.items() if p > HOLDS)


def _distrust(model: Model, failed: GroundSkill, before: State) -> Atom | None:
    """Of the learned atoms that a failed skill relies on the one that was the least certain before it."""
    named = {p.name: p for p in model.abstraction.predicates}
    atoms = [
        named[a.predicate](failed.objects[a.argument])
        for a in model.affordances.get(failed.name, ())
        if a.predicate in named
    ]
    if len(atoms) < 2:
        return atoms[0] if atoms else None
    seen = model.abstraction.abstract(before)
    return min(atoms, key=lambda atom: seen[atom])
