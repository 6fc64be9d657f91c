"""A state: objects and their named continuous features, with a covariance where they were estimated."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from resync_robot.core.errors import ResyncError, UnknownNameError
from resync_robot.core.symbols import Object, Type

Vector = Float[np.ndarray, " n"]


class State:
    """Objects -> feature vectors (x in the paper). Immutable: `with_features` returns a changed copy.

    Args:
        features: for each object a vector of length len(object.type.features), SI units, world frame.
        covariance: for objects that were estimated, an (n, n) covariance of that vector.
    """

    __slots__ = ("_covariance", "_features")

    def __init__(self, features: Mapping[Object, Vector], covariance: Mapping[Object, np.ndarray] | None = None):
        self._features: dict[Object, np.ndarray] = {}
        for obj in sorted(features):
            vector = np.array(features[obj], dtype=np.float64)
            if vector.shape != (len(obj.type.features),):
                raise ResyncError(
                    f"state of {obj.name} has shape {vector.shape}, its type '{obj.type.name}' has "
                    f"{len(obj.type.features)} features: {', '.join(obj.type.features)}"
                )
            vector.flags.writeable = False
            self._features[obj] = vector
        self._covariance = {o: np.asarray(c, dtype=np.float64) for o, c in (covariance or {}).items()}

    def __getitem__(self, obj: Object) -> Vector:
        try:
            return self._features[obj]
        except KeyError:
            raise UnknownNameError("object", obj.name, [o.name for o in self._features]) from None

    def __contains__(self, obj: object) -> bool:
        return obj in self._features

    def __iter__(self) -> Iterator[Object]:
        return iter(self._features)

    def __len__(self) -> int:
        return len(self._features)

    def get(self, obj: Object, *names: str) -> Vector:
        """The named features of one object, in the order asked for."""
        vector = self[obj]
        try:
            return vector[[obj.type.features.index(n) for n in names]]
        except ValueError:
            unknown = next(n for n in names if n not in obj.type.features)
            raise UnknownNameError(f"feature of {obj.type.name}", unknown, obj.type.features) from None

    def covariance(self, obj: Object) -> np.ndarray | None:
        """(n, n) covariance of the object's features, or None where they are exact."""
        return self._covariance.get(obj)

    @property
    def objects(self) -> tuple[Object, ...]:
        return tuple(self._features)

    def of_type(self, kind: Type) -> tuple[Object, ...]:
        return tuple(o for o in self._features if o.type == kind)

    def with_features(self, obj: Object, **values: float) -> State:
        """A copy with some features of one object replaced."""
        vector = self[obj].copy()
        for name, value in values.items():
            if name not in obj.type.features:
                raise UnknownNameError(f"feature of {obj.type.name}", name, obj.type.features)
            vector[obj.type.features.index(name)] = value
        return State({**self._features, obj: vector}, self._covariance)

    def project(self, objects: Iterable[Object]) -> State:
        """Only the given objects: proj(x) in the paper."""
        kept = list(objects)
        return State({o: self[o] for o in kept}, {o: self._covariance[o] for o in kept if o in self._covariance})

    def renamed(self, names: Mapping[Object, Object]) -> State:
        """The same of other objects of the same types; those that are not named keep their names."""
        features = {names.get(o, o): values for o, values in self._features.items()}
        return State(features, {names.get(o, o): values for o, values in self._covariance.items()})

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, for files. `from_json` is the inverse."""
        return {
            o.name: {
                "type": o.type.name,
                "features": [float(v) for v in self._features[o]],
                **({"covariance": self._covariance[o].tolist()} if o in self._covariance else {}),
            }
            for o in self._features
        }

    @staticmethod
    def from_json(data: Mapping[str, Any], types: Mapping[str, Type]) -> State:
        """Rebuild a state; `types` maps type names to types. Raises UnknownNameError on a strange type."""
        features, covariance = {}, {}
        for name, record in data.items():
            if record["type"] not in types:
                raise UnknownNameError("type", record["type"], list(types))
            obj = types[record["type"]](name)
            features[obj] = np.asarray(record["features"], dtype=np.float64)
            if "covariance" in record:
                covariance[obj] = np.asarray(record["covariance"], dtype=np.float64)
        return State(features, covariance)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, State) or self.objects != other.objects:
            return False
        return all(np.array_equal(self[o], other[o]) for o in self)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"State({', '.join(o.name for o in self)})"
