"""Neural classifiers of predicates (theta_psi): numpy at use, a record on disk. `fit` trains them.

A classifier is its layers and its normaliser, batch normalisation folded in, so that judging a scene is a handful of
small matrix products and needs no torch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from resync_robot.core.errors import LibraryError
from resync_robot.core.library import RETRAIN, Record
from resync_robot.core.relations import DEFAULTS, Relations, Rows, blank
from resync_robot.core.state import State
from resync_robot.core.symbols import Object, Type
from resync_robot.learning.features import gather, relative_features

KIND = "neural"


@dataclass(frozen=True)
class NeuralClassifier:
    """A multilayer perceptron over canonical features, with its normaliser.

    Attributes:
        types: of the predicate's arguments; with `relations` they decide the features.
        mean, scale: (d,) normaliser; features enter as (x - mean) / scale.
        layers: (weight (out, in), bias (out,)) of each layer, GELU (tanh form) between them, one logit at the end.
        relations: those that the domain declares; they are no part of a record.
    """

    types: tuple[Type, ...]
    mean: Float[np.ndarray, " d"]
    scale: Float[np.ndarray, " d"]
    layers: tuple[tuple[np.ndarray, np.ndarray], ...]
    relations: Relations = field(default_factory=dict)

    def __call__(self, state: State, objects: tuple[Object, ...]) -> float:
        return float(self.batch(state, [objects])[0])

    def batch(self, state: State, groundings: Sequence[tuple[Object, ...]]) -> Float[np.ndarray, " n"]:
        """(n,) probabilities that the predicate holds of each tuple of objects."""
        return self.probabilities(gather([state] * len(groundings), groundings)) if groundings else np.zeros(0)

    def probabilities(self, rows: Sequence[Rows]) -> Float[np.ndarray, " n"]:
        """(n,) probabilities for gathered object features, one array for each argument."""
        x = ((relative_features(self.types, rows, self.relations) - self.mean) / self.scale).astype(np.float32)
        for i, (weight, bias) in enumerate(self.layers):
            x = x @ weight.T + bias
            if i < len(self.layers) - 1:
                x = _gelu(x)
        return 1.0 / (1.0 + np.exp(-np.clip(x[:, 0].astype(np.float64), -30.0, 30.0)))

    def to_record(self, meta: Mapping[str, object] | None = None) -> Record:
        """Weights as tensors; `meta` adds what else is worth keeping (effects, losses)."""
        tensors = {"normaliser.mean": self.mean, "normaliser.scale": self.scale}
        for i, (weight, bias) in enumerate(self.layers):
            tensors |= {f"layer{i}.weight": weight, f"layer{i}.bias": bias}
        described = {**(meta or {}), "kind": KIND, "types": [t.name for t in self.types], "layers": len(self.layers)}
        return Record(described, {k: np.asarray(v, dtype=np.float32) for k, v in tensors.items()})

    @staticmethod
    def from_record(
        name: str, record: Record, types: Mapping[str, Type], relations: Relations = DEFAULTS
    ) -> NeuralClassifier:
        """The inverse of `to_record`, for the relations that it was trained with.

        Raises:
            LibraryError: the normaliser or a layer is missing, or shapes do not fit each other or the features.
        """

        def tensor(key: str, *shape: int | None) -> np.ndarray:
            if key not in record.tensors:
                raise LibraryError(f"the classifier of {name} has no tensor '{key}'", RETRAIN)
            array = record.tensors[key]
            fits = array.ndim == len(shape) and all(s in (None, a) for s, a in zip(shape, array.shape, strict=True))
            if not fits:
                raise LibraryError(f"tensor '{key}' of {name} has shape {array.shape}, expected {shape}", RETRAIN)
            if not np.all(np.isfinite(array)):
                raise LibraryError(f"tensor '{key}' of {name} holds numbers that are not finite", RETRAIN)
            return array

        kinds, count = record.meta.get("types"), record.meta.get("layers")
        if not isinstance(kinds, list) or not set(kinds) <= set(types) or not isinstance(count, int) or count < 1:
            raise LibraryError(f"the record of {name} names types {kinds} and layers {count}", RETRAIN)
        signature = tuple(types[k] for k in kinds)
        width = relative_features(signature, [blank(t) for t in signature], relations).shape[1]
        mean, scale = tensor("normaliser.mean", width), tensor("normaliser.scale", width)
        layers: list[tuple[np.ndarray, np.ndarray]] = []
        inputs: int = width
        for i in range(count):
            outputs = 1 if i == count - 1 else None
            weight = tensor(f"layer{i}.weight", outputs, inputs)
            inputs = weight.shape[0]
            layers.append((weight, tensor(f"layer{i}.bias", inputs)))
        return NeuralClassifier(signature, mean, scale, tuple(layers), relations)


def _gelu(x: np.ndarray) -> np.ndarray:
    return 0.5 * x * (1.0 + np.tanh(np.float32(0.7978845608) * (x + np.float32(0.044715) * x * x * x)))
