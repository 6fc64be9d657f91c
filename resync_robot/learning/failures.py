"""Failures as data: the Gaussians of relative poses that new failures are drawn from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from resync_robot.core.errors import LibraryError, TrainingError
from resync_robot.core.library import RETRAIN, LearnedFailure
from resync_robot.core.relations import Relation, between
from resync_robot.core.state import State
from resync_robot.core.symbols import Object, Type
from resync_robot.core.task import Domain


@dataclass(frozen=True)
class PairGaussian:
    """A Gaussian over how one object lies beside another, in the columns that `Relation.see` gives."""

    mean: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]

    def sample(self, rng: np.random.Generator) -> Float[np.ndarray, " k"]:
        """Columns for `Relation.place`, which takes them for the nearest that can be seen."""
        return rng.multivariate_normal(self.mean, self.covariance, method="cholesky")

    def to_json(self) -> dict[str, Any]:
        return {"mean": self.mean.tolist(), "covariance": self.covariance.tolist()}

    @staticmethod
    def from_json(data: Mapping[str, Any], size: int | None = None) -> PairGaussian:
        """The inverse of `to_json`. Raises ValueError or KeyError where the data is no Gaussian of `size` numbers."""
        mean, covariance = (np.asarray(data[name], dtype=float) for name in ("mean", "covariance"))
        k = mean.size if size is None else size
        if k == 0 or mean.shape != (k,) or covariance.shape != (k, k):
            raise ValueError(f"a Gaussian has {k} and {k} x {k} numbers, not {mean.shape} and {covariance.shape}")
        if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
            raise ValueError("a Gaussian has numbers that are none")
        # It raises where nothing can be drawn.
        np.linalg.cholesky(covariance)
        return PairGaussian(mean, covariance)

    @staticmethod
    def fit(relative: Sequence[np.ndarray], resolution: Sequence[float]) -> PairGaussian:
        """From (n, k) columns as they were seen. Raises TrainingError for fewer than three.

        Args:
            resolution: that of the relation. It keeps a direction in which all samples agree (sin 4a, say) from being
                drawn with no spread.
        """
        if len(relative) < 3:
            raise TrainingError(f"a Gaussian needs three relative poses, got {len(relative)}")
        samples = np.asarray(relative)
        return PairGaussian(samples.mean(0), np.cov(samples.T) + np.diag(resolution) ** 2)


@dataclass(frozen=True, kw_only=True)
class FailureModel:
    """What a stage knows about its failure: enough to dream of it.

    Attributes:
        recovery: the skill that mends it.
        skill: the skill that failed (C^F).
        argument: which of its arguments the failure is about (o^R); None where that is another object.
        relevant: the type of o^R.
        causes: o^F.
        before, after: for each cause the Gaussian of how the two lie beside each other when the skill fails, and once
            the recovery is done; in the columns of the relation of what `Domain.moving` moves to its anchor.
        changed: for each cause its features beside the pose that the recovery changes, with their values before and
            after.
    """

    recovery: str
    skill: str
    argument: int | None
    relevant: Type
    causes: tuple[Object, ...]
    before: Mapping[Object, PairGaussian]
    after: Mapping[Object, PairGaussian]
    changed: Mapping[Object, Mapping[str, tuple[float, float]]] = field(default_factory=dict)

    def to_learned(self) -> LearnedFailure:
        """As a library keeps it."""
        return LearnedFailure(
            skill=self.skill,
            argument=self.argument,
            relevant=self.relevant.name,
            objects={o.name: o.type.name for o in self.causes},
            before={o.name: {**g.to_json(), "features": self._values(o, 0)} for o, g in self.before.items()},
            after={o.name: {**g.to_json(), "features": self._values(o, 1)} for o, g in self.after.items()},
        )

    def _values(self, cause: Object, when: int) -> dict[str, float]:
        return {name: values[when] for name, values in self.changed.get(cause, {}).items()}

    @staticmethod
    def from_learned(recovery: str, learned: LearnedFailure, domain: Domain) -> FailureModel:
        """The inverse. Raises LibraryError where it does not fit the domain."""
        try:
            types = {t.name: t for t in domain.types}
            relevant = types[learned.relevant] if learned.relevant else _argument(domain, learned)
            causes = tuple(types[kind](name) for name, kind in learned.objects.items())
            sizes = {o: _columns(domain, o, relevant) for o in causes}
            before, after = (
                {o: PairGaussian.from_json(saved[o.name], sizes[o]) for o in causes}
                for saved in (learned.before, learned.after)
            )
            told = [{o: saved[o.name].get("features", {}) for o in causes} for saved in (learned.before, learned.after)]
            changed = {o: {n: (float(v), float(told[1][o][n])) for n, v in told[0][o].items()} for o in causes}
        except (IndexError, KeyError, StopIteration, ValueError, np.linalg.LinAlgError) as error:
            what = f"what the library knows of the failure that {recovery} mends does not fit {domain.name}: {error!r}"
            raise LibraryError(what, RETRAIN) from None
        return FailureModel(
            recovery=recovery,
            skill=learned.skill,
            argument=learned.argument,
            relevant=relevant,
            causes=causes,
            before=before,
            after=after,
            changed=changed,
        )


def _argument(domain: Domain, learned: LearnedFailure) -> Type:
    """The type of o^R in libraries that do not name it."""
    operator = next(o for o in domain.operators if o.name == learned.skill)
    return operator.parameters[learned.argument or 0].type


def _columns(domain: Domain, cause: Object, relevant: Type) -> int:
    moved, anchor = domain.moving(cause, relevant("any"))
    return len(resampling(domain, moved.type, anchor.type).names)


def resampling(domain: Domain, moved: Type, anchor: Type) -> Relation:
    """How states are resampled: the relation that the domain declares, else the plain relative pose.

    A round thing looks the same from all sides, and the scene around it does not: what is folded away for classifiers
    has to be kept here, or a wall that stands behind a ball would be dreamed before it.
    """
    if (moved, anchor) in domain.relations or (anchor, moved) in domain.relations:
        return between(moved, anchor, domain.relations)
    return between(replace(moved, symmetry=1), replace(anchor, symmetry=1))


def fit_beside(domain: Domain, states: Sequence[State], cause: Object, relevant: Object) -> PairGaussian:
    """Where the cause of a failure lies beside what it is about, over these states. Raises TrainingError."""
    moved, anchor = domain.moving(cause, relevant)
    relation = resampling(domain, moved.type, anchor.type)
    rows = relation.see(np.stack([s[moved] for s in states]), np.stack([s[anchor] for s in states]))
    return PairGaussian.fit(list(rows), relation.resolution)


def changed_features(cause: Object, before: Sequence[State], after: Sequence[State]) -> dict[str, tuple[float, float]]:
    """The features of a cause beside its pose that differ in most of these pairs of states, with their means: that a
    region is not active any more, say."""
    rows = [np.stack([state[cause] for state in states]) for states in (before, after)]
    first, kind = len(cause.type.pose or ()), cause.type
    differ = (np.abs(rows[1] - rows[0]) > 1e-6).mean(0) > 0.5
    means = [r.mean(0) for r in rows]
    return {
        n: (float(means[0][i]), float(means[1][i])) for i, n in enumerate(kind.features) if i >= first and differ[i]
    }


def lies_beside(domain: Domain, state: State, cause: Object, relevant: Object) -> np.ndarray:
    """How the cause of a failure lies beside what it is about, in the columns of `fit_beside`."""
    moved, anchor = domain.moving(cause, relevant)
    return resampling(domain, moved.type, anchor.type).see(state[moved][None], state[anchor][None])[0]


def spread_beside(domain: Domain, states: Sequence[State], cause: Object, relevant: Object) -> float:
    """How little the one tells of where the other lies: the mean standard deviation of the columns of `fit_beside`, in
    units of their resolution."""
    moved, anchor = domain.moving(cause, relevant)
    relation = resampling(domain, moved.type, anchor.type)
    rows = relation.see(np.stack([s[moved] for s in states]), np.stack([s[anchor] for s in states]))
    return float(np.mean(rows.std(0) / np.array(relation.resolution)))


def place_beside(
    domain: Domain, state: State, cause: Object, relevant: Object, relative: np.ndarray, rng: np.random.Generator
) -> State:
    """The state with the cause of a failure beside what it is about, in the columns of `fit_beside`."""
    moved, anchor = domain.moving(cause, relevant)
    row = resampling(domain, moved.type, anchor.type).place(state[moved], state[anchor], relative, rng)
    return state.with_features(moved, **dict(zip(moved.type.features, row.tolist(), strict=True)))
