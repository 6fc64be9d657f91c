"""How the practised skills went, by what held of their arguments: what preconditions do not say."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Any

from resync_robot.core.symbols import Operator, Predicate
from resync_robot.core.trajectory import Trajectory
from resync_robot.planning.abstract import Abstraction, Exists, Not


def experience(
    trajectories: Iterable[Trajectory],
    abstraction: Abstraction,
    operators: Sequence[Operator],
    given: Collection[Predicate] = (),
) -> dict[str, list[dict[str, Any]]]:
    """Skill name -> tallies of its attempts, those only whose preconditions held.

    Args:
        given: predicates of several arguments of which it is counted, too, whether they hold of one of them and
            anything else: that a hand holds something may never have been tried.

    Returns:
        Plain data: for each argument and each predicate of that argument alone, negations left out, `predicate`,
        `argument` (its position), and [successes, attempts] where the atom `held`, and `otherwise`; `over` where it is
        the arguments of the predicate that anything may stand for.
    """
    by_name = {o.name: o for o in operators}
    forms = {f.predicate: f for f in _of_one(given) if f.predicate not in abstraction.predicates}
    plain = [p for p in abstraction.predicates if not isinstance(abstraction.classifiers[p.name], Not)]
    grounded = Abstraction(
        (*abstraction.predicates, *forms), {**abstraction.classifiers, **{p.name: f for p, f in forms.items()}}
    )
    counts = {
        o.name: {
            (p, i): {True: [0, 0], False: [0, 0]}
            for p in (*plain, *forms)
            for i, v in enumerate(o.parameters)
            if p.types == (v.type,)
        }
        for o in operators
    }
    for trajectory in trajectories:
        for t in trajectory.transitions:
            operator = by_name.get(t.skill)
            if operator is None:
                continue
            atoms = grounded.true_atoms(t.before)
            if not operator.ground(t.objects).applicable(atoms):
                continue
            for (predicate, argument), by in counts[t.skill].items():
                count = by[predicate(t.objects[argument]) in atoms]
                count[0] += t.succeeded
                count[1] += 1
    return {
        skill: [
            {"predicate": p.name, "argument": i, "held": by[True], "otherwise": by[False]}
            if (form := forms.get(p)) is None
            else {
                "predicate": form.base.name,
                "over": list(form.over),
                "argument": i,
                "held": by[True],
                "otherwise": by[False],
            }
            for (p, i), by in sorted(tallies.items(), key=lambda item: (item[0][0].name, item[0][1]))
        ]
        for skill, tallies in counts.items()
    }


def _of_one(predicates: Iterable[Predicate]) -> Iterator[Exists]:
    """Each predicate of several arguments as one of each argument alone."""
    for predicate in predicates:
        places = range(len(predicate.types))
        if len(places) > 1:
            yield from (Exists(predicate, tuple(i for i in places if i != kept)) for kept in places)
