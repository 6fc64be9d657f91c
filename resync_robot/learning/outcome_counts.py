"""How the practised skills went, by what held of their arguments: what preconditions do not say."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from itertools import product
from typing import Any

from resync_robot.core.symbols import Atom, Operator, Predicate
from resync_robot.core.trajectory import Trajectory
from resync_robot.planning.abstract import Abstraction, Exists, ForAll, Not, form_to_json


def experience(
    trajectories: Iterable[Trajectory],
    abstraction: Abstraction,
    operators: Sequence[Operator],
    given: Collection[Predicate] = (),
) -> dict[str, list[dict[str, Any]]]:
    """Skill name -> tallies of its attempts, those only whose preconditions held.

    Args:
        given: what was not learned. Of these it is counted whether they hold of one argument and anything else: that a
            hand holds something may never have been tried. Of what was learned of one thing it is counted whether it
            holds of all: what bars one thing may be in the way to another.

    Returns:
        Plain data: for each predicate of some arguments of the skill, or of none, negations left out, `predicate`,
        `arguments` (their positions), and [successes, attempts] where the atom `held`, and `otherwise`; `form` and
        `over` where the predicate that is counted follows from that one.
    """
    by_name = {o.name: o for o in operators}
    forms = _forms(abstraction, given)
    grounded = Abstraction(
        (*abstraction.predicates, *forms), {**abstraction.classifiers, **{p.name: f for p, f in forms.items()}}
    )
    plain = [p for p in grounded.predicates if not isinstance(grounded.classifiers[p.name], Not)]
    counts: dict[str, dict[tuple[Predicate, tuple[int, ...]], dict[bool, list[int]]]] = {
        o.name: {(p, i): {True: [0, 0], False: [0, 0]} for p in plain for i in _places(p, o)} for o in operators
    }
    for trajectory in trajectories:
        for t in trajectory.transitions:
            operator = by_name.get(t.skill)
            if operator is None:
                continue
            atoms = grounded.true_atoms(t.before)
            if not operator.ground(t.objects).applicable(atoms):
                continue
            for (predicate, places), by in counts[t.skill].items():
                count = by[Atom(predicate, tuple(t.objects[i] for i in places)) in atoms]
                count[0] += t.succeeded
                count[1] += 1
    return {
        skill: [
            {**_named(p, forms), "arguments": list(places), "held": by[True], "otherwise": by[False]}
            for (p, places), by in sorted(tallies.items(), key=lambda item: (item[0][0].name, item[0][1]))
        ]
        for skill, tallies in counts.items()
    }


def _forms(abstraction: Abstraction, given: Collection[Predicate]) -> dict[Predicate, Exists | ForAll]:
    """What is counted though the model does not know it."""
    found: list[Exists | ForAll] = []
    for predicate in given:
        places = range(len(predicate.types))
        if len(places) > 1:
            found += [Exists(predicate, tuple(i for i in places if i != kept)) for kept in places]
    for predicate in abstraction.predicates:
        negation = isinstance(abstraction.classifiers[predicate.name], Not)
        if predicate not in given and len(predicate.types) == 1 and not negation:
            found.append(ForAll(predicate, (0,)))
    return {form.predicate: form for form in found if form.predicate not in abstraction.predicates}


def _places(predicate: Predicate, operator: Operator) -> list[tuple[int, ...]]:
    """Which of the operator's parameters it can be about."""
    of_type = [[i for i, v in enumerate(operator.parameters) if v.type == t] for t in predicate.types]
    return [places for places in product(*of_type) if len(set(places)) == len(places)]


def _named(predicate: Predicate, forms: dict[Predicate, Exists | ForAll]) -> dict[str, Any]:
    form = forms.get(predicate)
    if form is None:
        return {"predicate": predicate.name}
    described = form_to_json(form)
    return {"predicate": form.base.name, "form": described["form"], "over": described["over"]}
