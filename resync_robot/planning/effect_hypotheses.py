"""The last resort where no plan exists: suppose that one step also ends a relation that nobody has said it ends.

Operators learned from few situations leave effects out. That a thing which is lifted off another no longer lies on it,
and that the lower one is bare from then on, is such an effect where training never lifted one off. The planner then
sees no way on, though there is one. So it asks of each step that it could take now: would there be a plan if what the
step moves were no longer related to things that the step does not name? The step is taken, and the next look at the
scene says what is true.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import replace

from resync_robot.core.errors import PlanningError
from resync_robot.core.symbols import Atoms, Object, Operator, Predicate
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.outcome_costs import OutcomeCosts
from resync_robot.planning.search import Plan, ground_all, plan


def plan_or_suppose(
    operators: Sequence[Operator],
    abstraction: Abstraction,
    objects: Iterable[Object],
    atoms: Atoms,
    goal: Atoms,
    heuristic: str = "lmcut",
    disproved: Container[str] = (),
    costs: OutcomeCosts | None = None,
) -> tuple[Plan, str]:
    """A plan by the operators as they are, or else the shortest one that begins with a supposition.

    Args:
        disproved: suppositions, in the words that were returned, that are not made again.
        costs: of the steps.

    Returns:
        The plan, and what it supposes: empty, or words such as "Pick(r, b2) ends On".

    Raises:
        PlanningError: there is neither.
    """
    objects = tuple(objects)
    try:
        return plan(operators, objects, atoms, goal, heuristic, costs=costs), ""
    except PlanningError as error:
        supposed = _suppose(operators, abstraction, objects, atoms, goal, heuristic, disproved)
        if supposed is None:
            raise error
        return supposed


def with_relaxed_recoveries(operators: Iterable[Operator], learned: Container[str]) -> tuple[Operator, ...]:
    """The operators, those of recoveries without what was given of their preconditions: a recovery that was only ever
    practised with an empty hand need not need one.

    Args:
        learned: names of the learned predicates. A recovery brings about nothing else.
    """
    return tuple(
        replace(o, preconditions=frozenset(a for a in o.preconditions if a.predicate.name in learned))
        if o.add | o.delete and all(a.predicate.name in learned for a in o.add | o.delete)
        else o
        for o in operators
    )


def check_goal(
    operators: Sequence[Operator], abstraction: Abstraction, objects: Iterable[Object], atoms: Atoms, goal: Atoms
) -> None:
    """Refuse a goal that no plan reaches from `atoms`, with the fewest of its atoms that cannot be had together.

    Raises:
        PlanningError: says which, and why.
    """
    objects = tuple(objects)

    def failure(wanted: Atoms) -> PlanningError | None:
        try:
            plan_or_suppose(operators, abstraction, objects, atoms, wanted)
        except PlanningError as error:
            return error
        return None

    error, least = failure(goal), goal
    for atom in sorted(goal):
        # Without it no plan either: it is not what stands in the way.
        if error is not None and len(least) > 1 and (fewer := failure(least - {atom})) is not None:
            error, least = fewer, least - {atom}
    if error is None:
        return
    if len(least) == 1:
        raise error
    words = " and ".join(map(str, sorted(least)))
    raise PlanningError(f"no plan reaches {words} together, and one reaches any fewer of them", "leave out one of them")


def _suppose(
    operators: Sequence[Operator],
    abstraction: Abstraction,
    objects: tuple[Object, ...],
    atoms: Atoms,
    goal: Atoms,
    heuristic: str,
    disproved: Container[str],
) -> tuple[Plan, str] | None:
    best: tuple[Plan, str] | None = None
    for step in ground_all(operators, objects):
        if not step.applicable(atoms):
            continue
        after = step.apply(atoms)
        for relation in _relations(abstraction, after, step.objects):
            words = f"{step} ends {relation.name}"
            if words in disproved:
                continue
            changed = abstraction.derive(_without(after, relation, step.objects), objects)
            if changed == after:
                continue
            try:
                rest = plan(operators, objects, changed, goal, heuristic)
            except PlanningError:
                continue
            if best is None or len(rest.steps) + 1 < len(best[0].steps):
                whole = Plan((step, *rest.steps), rest.nodes_created, rest.seconds, atoms)
                best = whole, words
    return best


def _relations(abstraction: Abstraction, atoms: Atoms, moved: Sequence[Object]) -> list[Predicate]:
    """The predicates, none of them derived, that relate something in `moved` to something that is not."""
    found = {a.predicate for a in atoms if _crosses(a.args, moved) and not abstraction.is_derived(a.predicate)}
    return sorted(found)


def _without(atoms: Atoms, relation: Predicate, moved: Sequence[Object]) -> Atoms:
    return frozenset(a for a in atoms if a.predicate != relation or not _crosses(a.args, moved))


def _crosses(args: Sequence[object], moved: Sequence[Object]) -> bool:
    return any(a in moved for a in args) and any(a not in moved for a in args)
