"""The recovery problem of a stage (section 3.1): where episodes begin, what is seen and done, and who judges it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from resync_robot.core.embodiment import Embodiment, RecoveryInterface, Stage, TrainingSimulator
from resync_robot.core.skill import GroundSkill
from resync_robot.core.state import State
from resync_robot.core.symbols import Atoms, Object, Type
from resync_robot.core.task import Domain, Task
from resync_robot.core.trajectory import Transition
from resync_robot.core.world import World
from resync_robot.learning.failures import lies_beside, place_beside
from resync_robot.learning.relational_view import RelationalView
from resync_robot.planning.execute import ExecuteSettings, Model, plan_and_execute
from resync_robot.planning.skill_run import looks, run_skill
from resync_robot.sim_training.failure_mining import Explanation

AS_BEFORE = ExecuteSettings(max_skills=4, max_failures=1)
"""Of a verdict that plans: what earlier stages learned takes a skill or two each."""


@dataclass(frozen=True)
class Judge:
    """Says whether the failed skill succeeds now; leaves the simulator as it was.

    Attributes:
        failed: the skill that failed, with its objects.
        needs: what has to hold for it to be begun, as far as was given.
        effects: what holds once it has succeeded.
        true_atoms: the atoms of a state.
        plan_with: all that earlier stages learned, if anything: what else is in the way they deal with, so the effects
            are planned for, and the failed skill is not just run. None to run it.
        wherever: it has to succeed from where the robot set out, too. To be asked for where there are scenes in which
            it does: those in which nothing obstructs.
        leave: what the finished recovery ends with, if anything. It comes first, and then another look: what is pressed
            on moves when the hand lets go of it, so a skill that begins with the look of before misses it.
    """

    failed: GroundSkill
    needs: Atoms
    effects: Atoms
    true_atoms: Callable[[State], Atoms]
    plan_with: Model | None = None
    wherever: bool = False
    leave: GroundSkill | None = None

    def __call__(self, simulator: TrainingSimulator[Any, Any], begun: State) -> bool:
        """Whether it succeeds once the recovery ends here, and, where that is asked for, would, were the robot where it
        set out.

        Only then is the failure mended, and not just passed by: what is learned of the objects has to hold wherever
        the robot comes from.

        Args:
            begun: the state in which the robot set out.
        """
        before = simulator.save()
        if self.leave is not None:
            run_skill(simulator, self.leave)
        state = simulator.perceive()
        succeeded = self._succeeds(simulator)
        simulator.restore(before)
        if succeeded and self.wherever:
            robot = self.failed.objects[0]
            there = dict(zip(robot.type.features, begun[robot].tolist(), strict=True))
            # With something in its hand, or where it would stand in something, it cannot have begun there.
            if simulator.reset(state.with_features(robot, **there)) and self.needs <= self.true_atoms(
                simulator.perceive()
            ):
                succeeded = self._succeeds(simulator)
            simulator.restore(before)
        return succeeded

    def makes_ready(self, simulator: TrainingSimulator[Any, Any], model: Model, task: Task) -> None:
        """Bring a fresh scene of the task to where the failed skill would be begun, for only there it fails as it did:
        a lid may lie over what it is about, or something that an earlier stage knows may be in the way as well.

        What cannot be brought about of all that is known to be needed is tried with what was given alone, and left as
        it was in the end.
        """
        operator = next((o for o in model.operators if o.name == self.failed.name), None)
        known = operator.ground(self.failed.objects).preconditions if operator is not None else self.needs
        for needs in (known, self.needs):
            if brought_about(simulator, model, needs)[0]:
                return
            simulator.reset(task.initial)

    def _succeeds(self, simulator: TrainingSimulator[Any, Any]) -> bool:
        if self.plan_with is None:
            after = looks(simulator, run_skill(simulator, self.failed))
            return any(self.effects <= self.true_atoms(state) for state in after)
        plan_and_execute(simulator, self.plan_with, self.effects, AS_BEFORE)
        return self.effects <= self.true_atoms(simulator.perceive())


def brought_about(simulator: World[Any, Any], model: Model, atoms: Atoms) -> tuple[bool, tuple[Transition, ...]]:
    """Whether these atoms hold, planned for where they do not, and what was done for that."""
    if atoms <= model.abstraction.true_atoms(simulator.perceive()):
        return True, ()
    result = plan_and_execute(simulator, model, atoms, AS_BEFORE)
    return result.success, result.transitions


@dataclass(frozen=True)
class Start:
    """Where an episode may begin: a task, and a state of it."""

    task: Task
    state: State


@dataclass(frozen=True)
class Direct:
    """The interface of a stage that declares none: sees all relations, and acts in the embodiment's own actions."""

    view: RelationalView
    features: int
    embodiment: Embodiment
    approach: None = None
    leave: None = None
    effort_limit: None = None

    @property
    def actions(self) -> int:
        return len(self.embodiment.actions)

    @property
    def rate_hz(self) -> float:
        return self.embodiment.rate_hz

    def begin(self, objects: tuple[Object, ...], state: State, rng: np.random.Generator) -> None:
        """It remembers nothing."""

    def see(self, runs: Sequence[None], states: Sequence[State]) -> Float[np.ndarray, "n d"]:
        return self.view.each(states)

    def act(self, runs: Sequence[None], states: Sequence[State], actions: Float[np.ndarray, "n k"]) -> list[np.ndarray]:
        limits = np.array(list(self.embodiment.actions.values()))
        return list(limits.mean(1) + (limits[:, 1] - limits[:, 0]) / 2 * actions)


@dataclass(frozen=True)
class Problem:
    """The recovery problem of one stage.

    Attributes:
        domain: whose relations tell how o^R lies beside each o^F.
        starts: D^F, the states from which the skill fails.
        judge: whether it succeeds now.
        interface: how the recovery begins, sees and acts.
    """

    domain: Domain
    embodiment: Embodiment
    stage: Stage
    explanation: Explanation
    starts: tuple[Start, ...]
    judge: Judge
    interface: RecoveryInterface

    @property
    def objects(self) -> tuple[Object, ...]:
        """The robot, o^R and every o^F."""
        return self.explanation.projected

    def free(self, seed: int) -> Start | None:
        """A state in which nothing obstructs anything, with everything in it that the recovery is about; None where the
        domain knows of none."""
        if self.domain.free is None:
            return None
        counts: dict[Type, int] = {}
        for obj in self.objects[1:]:
            counts[obj.type] = counts.get(obj.type, 0) + 1
        task = self.domain.free(np.random.default_rng(seed), seed, counts)
        return Start(task, task.initial) if set(self.objects) <= set(task.objects) else None

    def between(self, failed: Start, free: Start, rng: np.random.Generator) -> Start:
        """The state of a failure with o^R moved towards how it lies beside an o^F where nothing obstructs: by another
        share in each column of their relation, and half of the time by small ones, for nobody knows how little it
        takes."""
        relevant = self.explanation.relevant
        culprit = self.explanation.culprits[int(rng.integers(len(self.explanation.culprits)))]
        near, far = (lies_beside(self.domain, start.state, culprit, relevant) for start in (failed, free))
        if not len(near):
            return failed
        shares = rng.uniform(0, 1, len(near)) ** (3 if rng.random() < 0.5 else 1)
        relative = near + shares * (far - near)
        return Start(failed.task, place_beside(self.domain, failed.state, culprit, relevant, relative, rng))


def judge_of(domain: Domain, model: Model, explanation: Explanation) -> Judge:
    """Who says whether the failure is mended."""
    operator = next(o for o in model.operators if o.name == explanation.skill)
    given = next((o for o in domain.operators if o.name == explanation.skill), None)
    return Judge(
        model.skill(explanation.skill).ground(explanation.objects),
        given.ground(explanation.objects).preconditions if given is not None else frozenset(),
        operator.ground(explanation.objects).add,
        model.abstraction.true_atoms,
        plan_with=model if model.learned else None,
        wherever=domain.free is not None,
    )


def pose_problem(
    domain: Domain,
    embodiment: Embodiment,
    stage: Stage,
    model: Model,
    explanation: Explanation,
    starts: Sequence[Start],
) -> Problem:
    """What is to be learned, from states from which the skill fails."""
    judge = judge_of(domain, model, explanation)
    if stage.interface is not None and stage.interface.leave is not None:
        judge = replace(judge, leave=stage.interface.leave.ground(explanation.projected))
    view = RelationalView(explanation.projected, domain.relations)
    interface = stage.interface or Direct(view, view.size, embodiment)
    return Problem(domain, embodiment, stage, explanation, tuple(starts), judge, interface)
