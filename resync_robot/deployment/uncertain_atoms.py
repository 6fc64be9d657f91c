"""Atoms with doubt: in what share of all that the poses may be a predicate holds.

A classifier's own probability says how the concept blurs; what is asked here is another thing, how much of the answer
hangs on poses that are not known better. Another look helps with the second only.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from resync_robot.core.state import State
from resync_robot.core.symbols import SE3, Atom, Atoms, Object
from resync_robot.planning.abstract import HOLDS, Abstraction
from resync_robot.planning.execute import Model


@dataclass(frozen=True, kw_only=True)
class SamplingSettings:
    """Attributes: `samples` of every pose; an atom is certain that holds in a share of them up to `low`, or from `high`
    on."""

    samples: int = 40
    low: float = 0.1
    high: float = 0.9


class SampledAbstraction(Abstraction):
    """Grounds predicates over samples of the poses that a state's covariance allows.

    States without a covariance, such as those of a simulator, are judged as they are.

    Args:
        given: whose predicates and classifiers to use.
        settings: how many samples, and when to be sure.
    """

    def __init__(self, given: Abstraction, settings: SamplingSettings | None = None) -> None:
        super().__init__(given.predicates, given.classifiers)
        self._settings = settings or SamplingSettings()
        self._last: tuple[State, dict[Atom, float]] | None = None

    def shares(self, state: State) -> dict[Atom, float]:
        """Every ground atom with the share of samples in which it holds."""
        if not _is_estimated(state):
            return super().shares(state)
        if self._last is None or self._last[0] is not state:
            held: Counter[Atom] = Counter()
            for judged in self.abstract_each(samples(state, self._settings.samples)):
                held.update({a: int(p > HOLDS) for a, p in judged.items()})
            self._last = state, {a: n / self._settings.samples for a, n in held.items()}
        return self._last[1]

    def true_atoms(self, state: State) -> Atoms:
        """The atoms that surely hold: neither one in doubt nor its negation is among them."""
        open_atoms = self.doubtful(state)
        return frozenset(a for a, p in self.shares(state).items() if p > HOLDS and a not in open_atoms)

    def doubtful(self, state: State) -> dict[Atom, float]:
        """The atoms that are neither surely true nor surely false, with the share of samples in which each holds."""
        if not _is_estimated(state):
            return {}
        s = self._settings
        return {a: p for a, p in self.shares(state).items() if s.low < p < s.high}


@dataclass(frozen=True)
class SampledModel(Model):
    """A model for states that are estimated."""

    abstraction: SampledAbstraction


def with_sampled_atoms(model: Model) -> SampledModel:
    """The same model, for states that are estimated."""
    return SampledModel(
        model.skills, SampledAbstraction(model.abstraction), model.operators, model.learned, model.costs
    )


def samples(state: State, count: int) -> list[State]:
    """States that the covariance of each object allows, errors of different objects independent.

    An object's draws hang on its name alone and vary smoothly with its covariance, so that two looks at the same thing
    are judged alike.
    """
    drawn: list[dict[Object, np.ndarray]] = [{} for _ in range(count)]
    for obj in state.objects:
        covariance = state.covariance(obj)
        if covariance is None:
            for one in drawn:
                one[obj] = state[obj]
            continue
        values, axes = np.linalg.eigh(covariance)
        normal = np.random.default_rng([*obj.name.encode(), 17]).standard_normal((count, len(values)))
        # The symmetric root: the axes of equal values, and the signs of all, are the eigensolver's whim.
        features = state[obj] + normal @ ((axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T)
        if obj.type.pose == SE3:
            features[:, 3:7] /= np.linalg.norm(features[:, 3:7], axis=1, keepdims=True)
        for one, row in zip(drawn, features, strict=True):
            one[obj] = row
    return [State(one) for one in drawn]


def objects_in(atoms: Mapping[Atom, float]) -> tuple[Object, ...]:
    """The objects that ground atoms speak of, in order."""
    return tuple(dict.fromkeys(o for atom in sorted(atoms) for o in atom.args if isinstance(o, Object)))


def _is_estimated(state: State) -> bool:
    return any(state.covariance(o) is not None for o in state.objects)
