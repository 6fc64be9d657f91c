"""How the practised skills went, by what held of their arguments: what preconditions do not say."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from resync_robot.core.symbols import Operator
from resync_robot.core.trajectory import Trajectory
from resync_robot.planning.abstract import Abstraction, Not


def experience(
    trajectories: Iterable[Trajectory], abstraction: Abstraction, operators: Sequence[Operator]
) -> dict[str, list[dict[str, Any]]]:
    """Skill name -> tallies of its attempts, those only whose preconditions held.

    Returns:
        Plain data: for each argument and each predicate of that argument alone, negations left out, `predicate`,
        `argument` (its position), and [successes, attempts] where the atom `held`, and `otherwise`.
    """
    by_name = {o.name: o for o in operators}
    counts = {
        o.name: {
            (p, i): {True: [0, 0], False: [0, 0]}
            for p in abstraction.predicates
            if not isinstance(abstraction.classifiers[p.name], Not)
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
            atoms = abstraction.true_atoms(t.before)
            if not operator.ground(t.objects).applicable(atoms):
                continue
            for (predicate, argument), by in counts[t.skill].items():
                count = by[predicate(t.objects[argument]) in atoms]
                count[0] += t.succeeded
                count[1] += 1
    return {
        skill: [
            {"predicate": p.name, "argument": i, "held": by[True], "otherwise": by[False]}
            for (p, i), by in sorted(tallies.items(), key=lambda item: (item[0][0].name, item[0][1]))
        ]
        for skill, tallies in counts.items()
    }
