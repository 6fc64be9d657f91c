"""Skills in an order that no plan has: what a robot learns about its own model by doing things for no reason.

Who acts by plans only begins nothing that the plan does not finish. So dreams never show that a hand which is ready to
grasp one block no longer is once it has gone to another, or that a push loses what was held. A planner that does not
know this makes plans that begin with what they then undo.

What a skill ends shows only where there was something to end: that a block which is picked stands on nothing any more,
where it stood on another. Such situations come about by several skills in a row. So a wandering does first what it has
not done yet in a situation like this one, rather than open and close a drawer five times.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np

from resync_robot.core.skill import GroundSkill
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Atoms, GroundOperator, Object
from resync_robot.core.task import Task
from resync_robot.core.trajectory import Transition
from resync_robot.core.world import Simulator
from resync_robot.planning.execute import Model
from resync_robot.planning.search import ground_all
from resync_robot.planning.skill_run import looks, run_skill

LONGEST, TAKEN_BACK = 12, 4
"""Skills in a wandering at most, and those that may be tried in vain beside them."""
EARLY = 6
"""The recovery is one of so many that come first."""

Situation = tuple[str, frozenset[tuple[str, ...]]]
"""A skill, and the lifted atoms about what it is done to."""


def wander(
    world: Simulator[Any, Any],
    model: Model,
    task: Task,
    recovery: Callable[[State], GroundSkill],
    recoveries: Collection[str],
    rng: np.random.Generator,
) -> tuple[Transition, ...]:
    """Given skills that the model says could be done next, and one recovery somewhere among them.

    What does not do what it should is taken back, and something else is done. It is not told: it may have failed of
    where the robot came from, which nobody will ask of it.

    Args:
        world: in its initial state.
        recovery: the one that is to be among them, for the objects of a state.
        recoveries: names of all learned skills, which are not drawn.
    """
    steps = [s for s in ground_all(model.operators, task.objects) if s.name not in recoveries]
    recover_at = int(rng.integers(EARLY))
    done: list[Transition] = []
    in_vain = False
    seen: set[Situation] = set()
    before = world.perceive()
    atoms = model.abstraction.true_atoms(before)
    for _ in range(LONGEST + TAKEN_BACK):
        ground, wanted = recovery(before), frozenset[Atom]()
        if len(done) != recover_at or in_vain:
            possible = [s for s in steps if s.applicable(atoms) and not s.add <= atoms]
            if not possible:
                break
            step = drawn(possible, atoms, seen, rng)
            seen.add(situation(step, atoms))
            ground, wanted = model.skill(step.name).ground(step.objects), step.add
        snapshot = world.save()
        outcome = run_skill(world, ground)
        for after in looks(world, outcome):
            found = model.abstraction.true_atoms(after)
            if wanted <= found:
                break
        in_vain = not outcome.done or not wanted <= found
        if in_vain:
            world.restore(snapshot)
            continue
        done.append(Transition(before, ground.name, ground.objects, after, True))
        before, atoms = after, found
        if len(done) == LONGEST:
            break
    return tuple(done)


def situation(step: GroundOperator, atoms: Atoms) -> Situation:
    """A skill and what holds of the objects that it is done to, whichever these and all others are."""
    places = {o: f"{i}" for i, o in enumerate(step.objects)}
    about = [a for a in atoms if any(o in places for o in a.args)]
    lifted = ((a.predicate.name, *(places.get(o, o.type.name) for o in a.args if isinstance(o, Object))) for a in about)
    return step.name, frozenset(lifted)


def drawn(
    possible: Sequence[GroundOperator], atoms: Atoms, seen: Collection[Situation], rng: np.random.Generator
) -> GroundOperator:
    """First a skill, then what it is done to, of those whose situation was not seen yet, if there are any.

    Each skill is as likely as any other, however many objects it could be done to. A hand that could go to any of many
    blocks would seldom hold one, and what is lost with it would not be seen.
    """
    choice = [s for s in possible if situation(s, atoms) not in seen] or possible
    names = sorted({s.name for s in choice})
    chosen = names[int(rng.integers(len(names)))]
    ways = [s for s in choice if s.name == chosen]
    return ways[int(rng.integers(len(ways)))]
