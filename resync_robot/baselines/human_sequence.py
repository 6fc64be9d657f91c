"""Human-sequenced skills, the paper's reference: a person gives the right skills in order, the robot runs them.

The learned recovery is among the skills. Nothing is planned, and nothing is tried twice: what is left to fail is the
skills themselves, and the poses that they are given.
"""

from __future__ import annotations

from collections.abc import Callable

from resync_robot.core.state import State
from resync_robot.core.symbols import Atoms, Object
from resync_robot.core.trajectory import Transition
from resync_robot.core.world import World
from resync_robot.planning.atom_beliefs import AtomBeliefs
from resync_robot.planning.execute import EpisodeEnd, EpisodeResult, Listener, Model
from resync_robot.planning.skill_run import run_skill

Expert = Callable[[State, Atoms], tuple[tuple[str, tuple[Object, ...]], ...]]
"""(the state as first perceived, goal) -> (skill name, objects) in order; a domain's `expert`."""


def run_human_sequence(
    world: World, model: Model, goal: Atoms, expert: Expert, listener: Listener | None = None
) -> EpisodeResult:
    """Run every skill of the expert's sequence once; look before the first and after each.

    The sequence is that for the scene as it is first perceived. A skill that does not end done ends the episode. As
    with `plan_and_execute`, the atoms seen at the end decide: the goal may hold although the last skill was cut short.

    Args:
        model: its skills are run, its abstraction judges the goal; its operators are not used.

    Returns:
        A result without plans: GOAL, or STUCK with the reason. A transition has succeeded where its skill was done.

    Raises:
        UnknownNameError: the sequence names a skill that the model does not have.
    """
    listener = listener or Listener()
    transitions: list[Transition] = []
    state, atoms = _look(world, model, listener)
    reason = "the sequence ended short of the goal"
    for name, objects in expert(state, goal):
        ground, before = model.skill(name).ground(objects), state
        outcome = run_skill(world, ground, listener)
        state, atoms = _look(world, model, listener)
        transitions.append(Transition(before, name, objects, state, outcome.done))
        if not outcome.done:
            reason = f"{ground} did not do what it should ({outcome.ending.value}: {outcome.reason})"
            break
    end, reason = (EpisodeEnd.GOAL, "") if goal <= atoms else (EpisodeEnd.STUCK, reason)
    listener.on_end(end, reason)
    return EpisodeResult(end, reason, tuple(transitions), (), state)


def _look(world: World, model: Model, listener: Listener) -> tuple[State, Atoms]:
    state = world.perceive()
    beliefs = AtomBeliefs(model.learned)
    beliefs.perceived(model.abstraction.shares(state))
    listener.on_perceived(state, beliefs.shown())
    return state, beliefs.certain()
