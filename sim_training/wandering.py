"""Skills in an order that no plan has: what a robot learns about its own model by doing things for no reason.

Who acts by plans only begins nothing that the plan does not finish. So dreams never show that a hand which is ready to
grasp one block no longer is once it has gone to another, or that a push loses what was held. A planner that does not
know this makes plans that begin with what they then undo.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np

from resync_robot.core.skill import GroundSkill
from resync_robot.core.state import State
from resync_robot.core.symbols import Atoms, GroundOperator
from resync_robot.core.task import Task
from resync_robot.core.trajectory import Transition
from resync_robot.core.world import World
from resync_robot.planning.execute import Model
from resync_robot.planning.search import ground_all
from resync_robot.planning.skill_run import looks, run_skill

LONGEST = 6
"""Skills in a wandering at most."""


def wander(
    world: World,
    model: Model,
    task: Task,
    recovery: Callable[[State], GroundSkill],
    recoveries: Collection[str],
    rng: np.random.Generator,
) -> tuple[Transition, ...]:
    """Given skills that the model says could be done next, and one recovery somewhere among them.

    Each skill is as likely as any other, however many objects it could be done to. A hand that could go to any of many
    blocks would seldom hold one, and what is lost with it would not be seen.

    It ends with the first skill that does not do what it should. That one is not told: it may have failed of where the
    robot came from, which nobody will ask of it.

    Args:
        world: in its initial state.
        recovery: the one that is to be among them, for the objects of a state.
        recoveries: names of all learned skills, which are not drawn.
    """
    steps = [s for s in ground_all(model.operators, task.objects) if s.name not in recoveries]
    recover_at = int(rng.integers(LONGEST))
    done: list[Transition] = []
    before = world.perceive()
    atoms = model.abstraction.true_atoms(before)
    for i in range(LONGEST):
        wanted: Atoms = frozenset()
        possible = [s for s in steps if s.applicable(atoms) and not s.add <= atoms]
        if i == recover_at:
            ground = recovery(before)
        elif possible:
            step = _drawn(possible, rng)
            ground, wanted = model.skill(step.name).ground(step.objects), step.add
        else:
            break
        outcome = run_skill(world, ground)
        for after in looks(world, outcome):
            atoms = model.abstraction.true_atoms(after)
            if wanted <= atoms:
                break
        if not outcome.done or not wanted <= atoms:
            break
        done.append(Transition(before, ground.name, ground.objects, after, True))
        before = after
    return tuple(done)


def _drawn(possible: Sequence[GroundOperator], rng: np.random.Generator) -> GroundOperator:
    """First a skill, then what it is done to."""
    names = sorted({s.name for s in possible})
    chosen = names[int(rng.integers(len(names)))]
    ways = [s for s in possible if s.name == chosen]
    return ways[int(rng.integers(len(ways)))]
