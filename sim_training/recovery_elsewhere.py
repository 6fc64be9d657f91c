"""A recovery is planned for every object that the failed skill can be applied to, and not only for the one that failed.

So what is learned of where that skill succeeds is learned of the others too: where nothing obstructs, and where what
was run into lies beside them as it lay beside the first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from resync_robot.core.symbols import Object, Term, Type
from resync_robot.core.task import Task
from resync_robot.learning.failures import lies_beside, place_beside
from resync_robot.sim_training.recovery_env import Tried, Try
from resync_robot.sim_training.recovery_episodes import Episodes
from resync_robot.sim_training.recovery_problem import Direct, Problem, Start


def tried_elsewhere(problem: Problem, seed: int, count: int) -> Tried:
    """Runs of the failed skill applied to each other object of the type that a free scene has; nothing of those that
    it cannot be applied to anyway.

    Args:
        count: runs for each, half of them where nothing obstructs.
    """
    found: Tried = []
    for other in applied_elsewhere(problem, seed):
        tasks = [t for i in range(count // 2) if (t := _free(other, seed + i)) is not None]
        free = _tried(other, [Start(t, t.initial) for t in tasks])
        if any(run.succeeded for run in free):
            found += [*free, *_tried(other, list(_obstructed(problem, other, tasks, seed)))]
    return found


def applied_elsewhere(problem: Problem, seed: int) -> list[Problem]:
    """The same problem about each other object of the type, as free tasks have them."""
    task, about = _free(problem, seed), problem.explanation.relevant
    if task is None or about not in problem.explanation.objects:
        return []
    taken = {*problem.explanation.objects, *problem.explanation.culprits}
    return [_about(problem, o) for o in sorted(task.objects) if o.type == about.type and o not in taken]


def _free(problem: Problem, seed: int) -> Task | None:
    """A scene in which nothing obstructs anything, with one more object that the failure could be about; None where
    the domain knows of none that has all."""
    if problem.domain.free is None:
        return None
    counts: Counter[Type] = Counter([o.type for o in problem.objects[1:]] + [problem.explanation.relevant.type])
    task = problem.domain.free(np.random.default_rng(seed), seed, counts)
    return task if set(problem.objects) <= set(task.objects) else None


def _obstructed(problem: Problem, other: Problem, tasks: list[Task], seed: int) -> Iterator[Start]:
    rng, domain = np.random.default_rng(seed), problem.domain
    about, instead = problem.explanation.relevant, other.explanation.relevant
    for task in tasks:
        failed, state = problem.starts[int(rng.integers(len(problem.starts)))].state, task.initial
        for culprit in problem.explanation.culprits:
            state = place_beside(domain, state, culprit, instead, lies_beside(domain, failed, culprit, about), rng)
        yield Start(task, state)


def _tried(problem: Problem, starts: list[Start]) -> Tried:
    episodes, found = Episodes(problem, starts, np.random.default_rng(0), 0.0, 0), []
    for start in starts:
        scene = episodes.begin_in(start.task, start.state)
        if scene is not None:
            features = episodes.see([scene])[0]
            found.append(Try(scene.state, features, problem.judge(scene.simulator, start.task.initial)))
    return found


def _about(problem: Problem, other: Object) -> Problem:
    """The same problem about another object."""
    about, judge = problem.explanation.relevant, problem.judge
    binding: dict[Term, Term] = {about: other}
    objects = tuple(other if o == about else o for o in problem.explanation.objects)
    explanation = replace(problem.explanation, objects=objects, relevant=other)
    interface = problem.interface
    if isinstance(interface, Direct):
        interface = replace(interface, view=replace(interface.view, objects=explanation.projected))
    return replace(
        problem,
        explanation=explanation,
        judge=replace(
            judge,
            failed=judge.failed.skill.ground(objects),
            needs=frozenset(a.substitute(binding) for a in judge.needs),
            effects=frozenset(a.substitute(binding) for a in judge.effects),
        ),
        interface=interface,
    )
