"""One episode of an evaluation: a method in a world that is a pure function of scenario, seed and number."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from resync_robot.core.options import MOST_EPISODES
from resync_robot.evaluation.report import EpisodeRow

if TYPE_CHECKING:
    from resync_robot.core.rig import Rig
    from resync_robot.core.skill import GroundSkill
    from resync_robot.core.symbols import Atoms
    from resync_robot.core.task import Domain, Task
    from resync_robot.core.world import World
    from resync_robot.deployment.uncertain_atoms import SampledAbstraction
    from resync_robot.planning.execute import EpisodeResult, Listener, Model
    from resync_robot.planning.search import Plan
    from resync_robot.sim_training.physics.solver import Solver

METHODS = ("resync", "rc", "initial", "human")
"""This project's, Recovery Chaining, the given model alone, and the right sequence of skills given by a person."""


@dataclass(frozen=True)
class Job:
    """One episode to run."""

    library: int
    method: str
    scenario: str
    seed: int
    episode: int


class _Method(Protocol):
    def __call__(self, world: World, *, goal: Atoms, listener: Listener) -> EpisodeResult: ...


@dataclass(frozen=True)
class Context:
    """The methods that are compared, and in which worlds.

    Attributes:
        rig: None for a domain with a robot of its own.
        methods: (index of the library, method) -> how it grounds atoms, and how it runs.
    """

    domain: Domain
    rig: Rig | None
    perception: str
    worlds: str
    solver: Solver
    given: Model
    methods: dict[tuple[int, str], tuple[SampledAbstraction, _Method]]


def methods_context(
    domain_name: str,
    paths: tuple[str, ...],
    perception: str,
    skills: str,
    worlds: str,
    reference: bool,
    horizon: int | None,
    rig: Rig | None,
) -> Context:
    """All that episodes need, made anew in each process."""
    from resync_robot.baselines.human_sequence import run_human_sequence
    from resync_robot.baselines.recovery_chaining import chaining
    from resync_robot.core.library import load_library
    from resync_robot.deployment.uncertain_atoms import with_sampled_atoms
    from resync_robot.library_models import camera_recovery, initial_model, learned_model
    from resync_robot.planning.execute import ExecuteSettings, plan_and_execute
    from resync_robot.sim_training.domains import find_domain
    from resync_robot.sim_training.physics.solver import REFERENCE, SHIPPED

    domain = find_domain(domain_name)
    initial, settings = with_sampled_atoms(initial_model(domain, rig)), ExecuteSettings(horizon=horizon)
    methods: dict[tuple[int, str], tuple[SampledAbstraction, _Method]] = {}
    for i, path in enumerate(paths):
        library = load_library(Path(path))
        # First, for it says what a library lacks.
        recovery = camera_recovery(domain, rig, library) if skills == "camera" and rig is not None else None
        learned = with_sampled_atoms(learned_model(domain, rig, library, [recovery] if recovery else []))
        methods[i, "resync"] = learned.abstraction, partial(plan_and_execute, model=learned, settings=settings)
        with_skill = with_sampled_atoms(replace(initial, skills=learned.skills))
        reaction = chaining(domain, library, learned.skills)
        given = initial.abstraction
        methods[i, "rc"] = given, partial(plan_and_execute, model=with_skill, settings=settings, reaction=reaction)
        methods[i, "initial"] = given, partial(plan_and_execute, model=initial, settings=settings)
        if domain.expert is not None:
            methods[i, "human"] = given, partial(run_human_sequence, model=with_skill, expert=domain.expert)
    solver = REFERENCE if reference else SHIPPED
    return Context(domain, rig, perception, worlds, solver, initial, methods)


def _open(context: Context, task: Task) -> tuple[World, bool]:
    """The world of a task, and whether it stands still."""
    from resync_robot.library_models import embodiment_of

    if context.rig is not None:
        from resync_robot.sim_training.physics.world import SimWorld

        arm = SimWorld(task, context.rig)
        return arm, arm.settles()
    own = embodiment_of(context.domain, None).simulate(task)
    return own, own.reset(task.initial)


def run_job(context: Context, job: Job) -> EpisodeRow:
    """Run one episode, and tell how it went."""
    import time

    from resync_robot.planning.execute import EpisodeEnd, EpisodeResult, Listener, begin_after
    from resync_robot.sim_training.domains import world_task

    class Notes(Listener):
        """Of an episode that ends in a fault it is all there is."""

        def __init__(self) -> None:
            self.skills: list[str] = []
            self.planning_s = 0.0

        def on_plan(self, plan: Plan, reason: str) -> None:
            self.planning_s = max(self.planning_s, plan.seconds)

        def on_skill_start(self, skill: GroundSkill) -> None:
            self.skills.append(str(skill))

    abstraction, method = context.methods[job.library, job.method]
    before = context.domain.scenario(job.scenario).begins_after
    notes = Notes()
    begun = time.monotonic()
    # A scene that does not stand still is not a task, nor one in which the episode cannot begin as it should; the next
    # one takes its place.
    for attempt in range(20):
        episode = job.episode + MOST_EPISODES * attempt
        task = world_task(context.domain, job.scenario, job.seed, episode, context.worlds, context.solver)
        world, stands = _open(context, task)
        if stands and begin_after(world, context.given, before, task.objects):
            break
    rig = context.rig
    if context.perception == "oracle" or rig is None:
        result = method(world, goal=task.goal, listener=notes)
        reached = result.success
    else:
        from resync_robot.core.errors import MotionError, PerceptionError
        from resync_robot.deployment.devices import open_simulated
        from resync_robot.deployment.world import DeployedWorld
        from resync_robot.hardware.base import RobotError

        with open_simulated(task, rig) as devices:
            seen = DeployedWorld(
                devices.robot, devices.cameras, rig, task.objects, devices.truth, abstraction=abstraction
            )
            try:
                if begin_after(seen, context.given, before, task.objects):
                    result = method(seen, goal=task.goal, listener=notes)
                else:
                    result = EpisodeResult(
                        EpisodeEnd.FAULT, "the episode could not begin as its scenario says", (), (), task.initial
                    )
                # What the robot believes at the end does not count; what is true does.
                reached = task.goal <= context.given.abstraction.true_atoms(devices.truth())
            except (PerceptionError, MotionError, RobotError) as error:
                result, reached = EpisodeResult(EpisodeEnd.FAULT, error.what, (), (), devices.truth()), False
    return EpisodeRow(
        **vars(job),
        success=reached,
        end=result.end.value,
        reason=result.reason,
        skills=len(notes.skills),
        planning_s=notes.planning_s,
        seconds=time.monotonic() - begun,
        skills_run=tuple(notes.skills),
        steps=result.steps,
    )
