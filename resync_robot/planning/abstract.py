"""State -> ground atoms, each with the probability that it holds.

A predicate's classifier is a function of (state, objects), or a form derived from another predicate: `Not`,
`ForAll`, `Exists`. A derived form is a positive symbol of its own, because the planner takes neither negative
preconditions nor quantifiers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from resync_robot.core.errors import PlanningError, UnknownNameError
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Atoms, Object, Predicate, distinct_products

Classifier = Callable[[State, tuple[Object, ...]], float]
"""(state, objects) -> probability in [0, 1]."""

HOLDS = 0.5
"""An atom counts as true above this probability."""


@runtime_checkable
class BatchClassifier(Protocol):
    """A classifier that judges all groundings of its predicate in one forward pass."""

    def __call__(self, state: State, objects: tuple[Object, ...]) -> float: ...

    def batch(self, state: State, groundings: Sequence[tuple[Object, ...]]) -> np.ndarray:
        """(n,) probabilities, one for each tuple of objects."""
        ...


@dataclass(frozen=True, slots=True)
class Not:
    """The negation of `base`, over the same arguments."""

    base: Predicate

    @property
    def predicate(self) -> Predicate:
        return Predicate(f"not-{self.base.name}", self.base.types)

    def combine(self, values: Sequence[float]) -> float:
        return 1.0 - values[0]

    def keeps(self, args: tuple[Object, ...]) -> tuple[Object, ...]:
        """The arguments of the derived atom that a grounding of the base counts towards."""
        return args


@dataclass(frozen=True, slots=True)
class _Quantified:
    """A predicate over the arguments of `base` that are not in `over` (positions, ascending)."""

    base: Predicate
    over: tuple[int, ...]

    def __post_init__(self) -> None:
        if not self.over or sorted(set(self.over)) != list(self.over) or self.over[-1] >= len(self.base.types):
            raise PlanningError(f"cannot quantify {self.base.name} over its arguments {self.over}")

    @property
    def word(self) -> str:
        return type(self).__name__.lower()

    @property
    def predicate(self) -> Predicate:
        kept = tuple(t for i, t in enumerate(self.base.types) if i not in self.over)
        types = self.base.types
        # With its position where the predicate has several arguments of the type: exists-block0 is not exists-block1.
        gone = "-".join(f"{types[i].name}{i if types.count(types[i]) > 1 else ''}" for i in self.over)
        return Predicate(f"{self.base.name}-{self.word}-{gone}", kept)

    def keeps(self, args: tuple[Object, ...]) -> tuple[Object, ...]:
        """The arguments of the derived atom that a grounding of the base counts towards."""
        return tuple(a for i, a in enumerate(args) if i not in self.over)


class ForAll(_Quantified):
    """True where `base` holds for every choice of the arguments `over`; true where there is none to choose."""

    __slots__ = ()

    def combine(self, values: Sequence[float]) -> float:
        # The least of them, not the product: so it holds exactly where each grounding holds.
        return min(values, default=1.0)


class Exists(_Quantified):
    """True where `base` holds for at least one choice of the arguments `over`."""

    __slots__ = ()

    def combine(self, values: Sequence[float]) -> float:
        return max(values, default=0.0)


Form = Not | ForAll | Exists

_Values = dict[str, dict[tuple[Object, ...], float]]
"""Name of a predicate -> grounding -> probability."""


def form_to_json(form: Form) -> dict[str, object]:
    """Plain data for a library record; `form_from_json` is the inverse."""
    over = list(form.over) if isinstance(form, ForAll | Exists) else []
    return {"form": type(form).__name__, "base": form.base.name, "over": over}


def form_from_json(data: Mapping[str, object], predicates: Mapping[str, Predicate]) -> Form:
    """Rebuild a form over one of `predicates`. Raises UnknownNameError on a strange form or base."""
    kind, base, over = data.get("form"), data.get("base"), data.get("over", [])
    if base not in predicates:
        raise UnknownNameError("base predicate", str(base), list(predicates))
    predicate = predicates[str(base)]
    if kind == "Not":
        return Not(predicate)
    if kind not in ("ForAll", "Exists") or not isinstance(over, list) or not all(isinstance(i, int) for i in over):
        raise UnknownNameError("form of a predicate", f"{kind} over {over}", ["Not", "ForAll", "Exists"])
    return (ForAll if kind == "ForAll" else Exists)(predicate, tuple(over))


class Abstraction:
    """Grounds predicates over states.

    Args:
        predicates: those to ground.
        classifiers: predicate name -> classifier or derived form; may name more predicates than are grounded.

    Raises:
        UnknownNameError: a predicate, or the base of a form, has no classifier.
    """

    def __init__(self, predicates: Iterable[Predicate], classifiers: Mapping[str, Classifier | Form]) -> None:
        self.predicates = tuple(sorted(predicates))
        self.classifiers = dict(classifiers)
        for predicate in self.predicates:
            name: str | None = predicate.name
            while name is not None:
                if name not in self.classifiers:
                    raise UnknownNameError("predicate (no classifier for it)", name, list(self.classifiers))
                found = self.classifiers[name]
                name = found.base.name if isinstance(found, Form) else None

    def abstract(self, state: State) -> dict[Atom, float]:
        """Every ground atom over the state's objects with the probability that it holds."""
        return self._abstract(state, {})

    def abstract_each(self, states: Sequence[State]) -> list[dict[Atom, float]]:
        """`abstract` of several states of the same objects; a batch classifier judges them all in one pass."""
        known: list[_Values] = [{} for _ in states]
        # Side by side in one state, each under names of its own.
        aliases = [{o: Object(f"{o.name}/{i}", o.type) for o in state.objects} for i, state in enumerate(states)]
        together = State({alias[o]: s[o] for s, alias in zip(states, aliases, strict=True) for o in s.objects})
        for predicate in self.predicates:
            classifier = self.classifiers[predicate.name]
            groundings = _groundings(predicate, states[0].objects) if states else []
            if isinstance(classifier, Form) or not isinstance(classifier, BatchClassifier) or not groundings:
                continue
            renamed = [tuple(alias[o] for o in args) for alias in aliases for args in groundings]
            values = classifier.batch(together, renamed).reshape(len(states), -1)
            for judged, row in zip(known, values, strict=True):
                judged[predicate.name] = dict(zip(groundings, map(float, row), strict=True))
        return [self._abstract(state, judged) for state, judged in zip(states, known, strict=True)]

    def _abstract(self, state: State, known: _Values) -> dict[Atom, float]:
        return {
            Atom(predicate, args): value
            for predicate in self.predicates
            for args, value in self._values(predicate, state, known).items()
        }

    def true_atoms(self, state: State) -> Atoms:
        """The atoms that hold: those above `HOLDS`."""
        return frozenset(a for a, p in self.abstract(state).items() if p > HOLDS)

    def shares(self, state: State) -> dict[Atom, float]:
        """Every ground atom with the share of the states that there may be in which it holds; here of one, 0 or 1."""
        return {a: float(p > HOLDS) for a, p in self.abstract(state).items()}

    def is_derived(self, predicate: Predicate) -> bool:
        """Does the predicate follow from another one, rather than from the state?"""
        return isinstance(self.classifiers[predicate.name], Form)

    def derive(self, atoms: Atoms, objects: Iterable[Object]) -> Atoms:
        """`atoms` with those of derived predicates put in order: what follows from the others holds, nothing else.

        A derived predicate whose base is not grounded itself cannot be judged from atoms, and keeps its own.
        """
        pool = tuple(objects)
        grounded = {p.name for p in self.predicates}
        known = {p: {a.args for a in atoms if a.predicate == p} for p in self.predicates}
        judged: set[str] = {p.name for p in self.predicates if not self.is_derived(p)}
        waiting = [p for p in self.predicates if p.name not in judged]
        while ready := [p for p in waiting if self._base(p).name in judged or self._base(p).name not in grounded]:
            for predicate in ready:
                form = self.classifiers[predicate.name]
                judged.add(predicate.name)
                waiting.remove(predicate)
                if not isinstance(form, Form) or form.base.name not in grounded:
                    continue
                groups: dict[tuple[Object, ...], list[float]] = {args: [] for args in _groundings(predicate, pool)}
                for args in _groundings(form.base, pool):
                    groups[form.keeps(args)].append(float(args in known[form.base]))
                known[predicate] = {args for args, values in groups.items() if form.combine(values) > HOLDS}
        return frozenset(Atom(p, args) for p, holding in known.items() for args in holding)

    def _base(self, predicate: Predicate) -> Predicate:
        form = self.classifiers[predicate.name]
        return form.base if isinstance(form, Form) else predicate

    def _values(self, predicate: Predicate, state: State, known: _Values) -> dict[tuple[Object, ...], float]:
        if predicate.name in known:
            return known[predicate.name]
        groundings = _groundings(predicate, state.objects)
        classifier = self.classifiers[predicate.name]
        if isinstance(classifier, Form):
            groups: dict[tuple[Object, ...], list[float]] = {args: [] for args in groundings}
            for args, value in self._values(classifier.base, state, known).items():
                groups[classifier.keeps(args)].append(value)
            values = [classifier.combine(groups[args]) for args in groundings]
        elif isinstance(classifier, BatchClassifier):
            values = [float(v) for v in classifier.batch(state, groundings)] if groundings else []
        else:
            values = [float(classifier(state, args)) for args in groundings]
        known[predicate.name] = dict(zip(groundings, values, strict=True))
        return known[predicate.name]


def _groundings(predicate: Predicate, objects: Sequence[Object]) -> list[tuple[Object, ...]]:
    return distinct_products([[o for o in objects if o.type == t] for t in predicate.types])
