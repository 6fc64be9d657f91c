"""The symbolic vocabulary: types, objects, predicates, atoms, operators.

`ground` and `lift` mirror each other; an atom whose arguments have the wrong number or type cannot be built.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

from resync_robot.core.errors import PlanningError

SE2 = ("x", "y", "theta")
"""Features of a pose in the plane: m, m, rad."""
SE3 = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Features of a pose in space: m, and a unit quaternion."""
ROUND = 0
"""The symmetry of what looks the same in every heading."""


@dataclass(frozen=True, slots=True, order=True)
class Type:
    """A kind of object and the names of its continuous features (x_o in the paper, SI units).

    Types with the same name and features are equal. The rest says what the features mean.

    Attributes:
        pose: SE3 or SE2, with which the features then begin; None for what has no place.
        extents: the features that are its full extents along its own axes, x first; empty for what has no body.
        symmetry: the number of headings, about its own z axis, in which it looks the same: 1, 2 for a bar, 4 for a
            square (whose extents along x and y are then equal), ROUND for all.
        exact: its features carry no error of perception, as those of a robot, which it knows from its joints.

    Raises:
        PlanningError: the declarations contradict the features.
    """

    name: str
    features: tuple[str, ...] = ()
    pose: tuple[str, ...] | None = field(default=None, compare=False, kw_only=True)
    extents: tuple[str, ...] = field(default=(), compare=False, kw_only=True)
    symmetry: int = field(default=1, compare=False, kw_only=True)
    exact: bool = field(default=False, compare=False, kw_only=True)

    def __post_init__(self) -> None:
        if self.pose not in (None, SE2, SE3):
            raise PlanningError(f"type '{self.name}' has the pose {self.pose}", "declare pose=SE2, SE3 or None")
        if self.pose is not None and self.features[: len(self.pose)] != self.pose:
            raise PlanningError(
                f"the features of type '{self.name}' are ({', '.join(self.features)}) and do not begin with its pose",
                f"begin them with {', '.join(self.pose)}",
            )
        if self.extents and (len(self.extents) != self.dimensions or not set(self.extents) <= set(self.features)):
            raise PlanningError(
                f"type '{self.name}' has the extents ({', '.join(self.extents)})",
                "name one of its features for each axis of its pose, or none",
            )
        if self.symmetry < 0 or (self.extents and self.symmetry not in (ROUND, 1, 2, 4)):
            raise PlanningError(
                f"type '{self.name}' has the symmetry {self.symmetry}", "declare 1, 2, 4 or ROUND for a body"
            )

    @property
    def dimensions(self) -> int:
        """Of the space that its pose is in: 3, 2, or 0 for what has no place. So many features are its position."""
        return 0 if self.pose is None else 3 if self.pose == SE3 else 2

    def to_json(self) -> dict[str, Any]:
        """Plain values, for files. `from_json` is the inverse."""
        return {
            "features": list(self.features),
            "pose": None if self.pose is None else list(self.pose),
            "extents": list(self.extents),
            "symmetry": self.symmetry,
            "exact": self.exact,
        }

    @staticmethod
    def from_json(name: str, data: Mapping[str, Any]) -> Type:
        """Raises KeyError, TypeError, ValueError or PlanningError where these are no such values."""
        pose = data["pose"]
        return Type(
            name,
            tuple(map(str, data["features"])),
            pose=None if pose is None else tuple(pose),
            extents=tuple(data["extents"]),
            symmetry=int(data["symmetry"]),
            exact=bool(data["exact"]),
        )

    def __call__(self, name: str) -> Object:
        return Object(name, self)

    def __hash__(self) -> int:
        # Atoms are hashed by the million in learning and planning; the names of features would be most of that work.
        return hash(self.name)


@dataclass(frozen=True, slots=True, order=True)
class Object:
    """A named thing of one type."""

    name: str
    type: Type

    def __hash__(self) -> int:
        return hash(self.name)

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True, order=True)
class Variable:
    """A placeholder for an object of one type; its name starts with '?'."""

    name: str
    type: Type

    def __post_init__(self) -> None:
        if not self.name.startswith("?"):
            raise PlanningError(f"variable '{self.name}' must start with '?'")

    def __str__(self) -> str:
        return self.name


Term = Object | Variable


@dataclass(frozen=True, slots=True, order=True)
class Predicate:
    """A relation over typed arguments (psi). Its classifier is looked up by name elsewhere."""

    name: str
    types: tuple[Type, ...]

    def __hash__(self) -> int:
        return hash(self.name)

    def __call__(self, *args: Term) -> Atom:
        return Atom(self, tuple(args))

    def groundings(self, objects: Iterable[Object]) -> list[Atom]:
        """Every well-typed ground atom over `objects` with distinct arguments, in a fixed order."""
        pools = [sorted(o for o in objects if o.type == t) for t in self.types]
        return [Atom(self, args) for args in distinct_products(pools)]


@dataclass(frozen=True, slots=True, order=True)
class Atom:
    """A predicate applied to objects (ground) or variables (lifted)."""

    predicate: Predicate
    args: tuple[Term, ...]
    _hash: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        types = self.predicate.types
        if len(self.args) != len(types) or any(a.type != t for a, t in zip(self.args, types, strict=False)):
            given = ", ".join(f"{a} - {a.type.name}" for a in self.args)
            wanted = ", ".join(t.name for t in types)
            raise PlanningError(f"{self.predicate.name}({given}) is ill-typed: it takes ({wanted})")
        object.__setattr__(self, "_hash", hash((self.predicate.name, self.args)))

    def __hash__(self) -> int:
        return self._hash

    def __reduce__(self) -> tuple[Any, ...]:
        # Hashes of words differ from process to process.
        return Atom, (self.predicate, self.args)

    def substitute(self, binding: Mapping[Any, Term]) -> Atom:
        """The same atom with its terms replaced; terms without a binding stay."""
        return Atom(self.predicate, tuple(binding.get(a, a) for a in self.args))

    def __str__(self) -> str:
        return f"{self.predicate.name}({', '.join(a.name for a in self.args)})"


Atoms = frozenset[Atom]


@dataclass(frozen=True, slots=True)
class Operator:
    """What a skill needs and what it changes, lifted. The name is the skill's name (one operator a skill).

    Attributes:
        delete_all: universally quantified delete effects: atoms with variables that are no parameters, and stand for
            every object there is. A hand that punches lets go of whatever it holds.
    """

    name: str
    parameters: tuple[Variable, ...]
    preconditions: Atoms = frozenset()
    add: Atoms = frozenset()
    delete: Atoms = frozenset()
    delete_all: Atoms = frozenset()

    def __post_init__(self) -> None:
        free = {t for a in self.preconditions | self.add | self.delete for t in a.args} - set(self.parameters)
        if free:
            raise PlanningError(f"operator {self.name}: {sorted(t.name for t in free)} are not among its parameters")
        if bound := [str(a) for a in self.delete_all if set(a.args) <= set(self.parameters)]:
            raise PlanningError(f"operator {self.name}: {sorted(bound)} have no variable that stands for every object")

    def ground(self, objects: Sequence[Object], among: Sequence[Object] = ()) -> GroundOperator:
        """Bind the parameters to `objects`, in order. Raises PlanningError on wrong number or type.

        Args:
            among: every object there is, for what the operator deletes of all of them.
        """
        if len(objects) != len(self.parameters) or any(
            o.type != v.type for o, v in zip(objects, self.parameters, strict=False)
        ):
            wanted = ", ".join(f"{v} - {v.type.name}" for v in self.parameters)
            raise PlanningError(f"{self.name}({', '.join(map(str, objects))}) is ill-typed: it takes ({wanted})")
        binding: dict[Term, Term] = dict(zip(self.parameters, objects, strict=True))

        def bind(atoms: Atoms) -> Atoms:
            return frozenset(a.substitute(binding) for a in atoms)

        swept = frozenset(a for atom in bind(self.delete_all) for a in _instances(atom, among))
        return GroundOperator(self, tuple(objects), bind(self.preconditions), bind(self.add), bind(self.delete), swept)

    def renamed(self, names: Mapping[str, Predicate]) -> Operator:
        """The same operator with the predicates of these names exchanged for others of the same types."""

        def of(atoms: Atoms) -> Atoms:
            return frozenset(Atom(names.get(a.predicate.name, a.predicate), a.args) for a in atoms)

        return replace(
            self,
            preconditions=of(self.preconditions),
            add=of(self.add),
            delete=of(self.delete),
            delete_all=of(self.delete_all),
        )


@dataclass(frozen=True, slots=True)
class GroundOperator:
    """An operator applied to objects.

    Attributes:
        swept: what it deletes of every object there is, as far as it was told which there are.
    """

    operator: Operator
    objects: tuple[Object, ...]
    preconditions: Atoms
    add: Atoms
    delete: Atoms
    swept: Atoms = frozenset()

    @property
    def name(self) -> str:
        return self.operator.name

    def applicable(self, atoms: Atoms) -> bool:
        return self.preconditions <= atoms

    def apply(self, atoms: Atoms) -> Atoms:
        """Successor state: deletes first, then adds, as pyperplan does."""
        return (atoms - self.delete - self.swept) | self.add

    def lift(self) -> Operator:
        """The lifted operator again; the inverse of `Operator.ground`."""
        back: dict[Term, Term] = dict(zip(self.objects, self.operator.parameters, strict=True))

        def unbind(atoms: Atoms) -> Atoms:
            return frozenset(a.substitute(back) for a in atoms)

        op = self.operator
        return Operator(
            op.name, op.parameters, unbind(self.preconditions), unbind(self.add), unbind(self.delete), op.delete_all
        )

    def __str__(self) -> str:
        return f"{self.name}({', '.join(map(str, self.objects))})"


def _instances(atom: Atom, among: Sequence[Object]) -> list[Atom]:
    """The atom with every object in place of each variable that is left."""
    free = list(dict.fromkeys(t for t in atom.args if isinstance(t, Variable)))
    chosen = product(*([o for o in among if o.type == v.type] for v in free))
    return [atom.substitute(dict(zip(free, objects, strict=True))) for objects in chosen]


def distinct_products(pools: Sequence[Sequence[Object]]) -> list[tuple[Object, ...]]:
    """Cartesian product of the pools, without tuples that use one object twice, in lexicographic order."""
    tuples: list[tuple[Object, ...]] = [()]
    for pool in pools:
        tuples = [(*t, o) for t in tuples for o in pool if o not in t]
    return tuples
