"""Which ground operators a search needs at all: of a hundred objects a goal concerns a few."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from resync_robot.core.symbols import Atom, Atoms, GroundOperator, Object, Predicate, Term
from resync_robot.planning.abstract import Exists, ForAll
from resync_robot.planning.outcome_costs import OutcomeCosts


def relevant(
    ground: Sequence[GroundOperator], atoms: Atoms, goal: Atoms, costs: OutcomeCosts, objects: Collection[Object]
) -> list[GroundOperator]:
    """Those that can be part of a cheapest plan, in their order.

    An operator can where it achieves something of the goal, of what such an operator needs, or of what makes one
    cheaper. To achieve what holds already, or to end what does not hold, is worth something only where an operator
    among them undoes it. Every other operator can be left out of a plan, which stays one, and is no dearer then.
    """
    search = _Relevance(atoms, goal, costs, objects)
    left = list(ground)
    while found := [op for op in left if search.is_useful(op)]:
        for op in found:
            search.take(op)
        taken = set(map(id, found))
        left = [op for op in left if id(op) not in taken]
    remaining = set(map(id, left))
    return [op for op in ground if id(op) not in remaining]


class _Wishes:
    """Atoms, and all atoms from which certain others are derived."""

    def __init__(self, atoms: Atoms = frozenset()) -> None:
        self._atoms = set(atoms)
        self._derived: dict[Predicate, set[tuple[Exists | ForAll, tuple[Term, ...]]]] = {}

    def add(self, atom: Atom, form: Exists | ForAll | None = None) -> None:
        """Add an atom; with a form, all those that it is derived from."""
        if form is None:
            self._atoms.add(atom)
        else:
            self._derived.setdefault(form.base, set()).add((form, atom.args))

    def __contains__(self, atom: Atom) -> bool:
        objects = tuple(a for a in atom.args if isinstance(a, Object))
        found = self._derived.get(atom.predicate, ())
        return atom in self._atoms or any(form.keeps(objects) == args for form, args in found)


class _Relevance:
    """What is known to be wanted so far.

    Attributes:
        wanted, unwanted: what had better hold, and what had better not.
        added, deleted: by operators that were taken.
    """

    def __init__(self, atoms: Atoms, goal: Atoms, costs: OutcomeCosts, objects: Collection[Object]) -> None:
        self._atoms, self._costs, self._objects = atoms, costs, objects
        self.wanted, self.unwanted = _Wishes(goal), _Wishes()
        self.added: set[Atom] = set()
        self.deleted: set[Atom] = set()

    def is_useful(self, op: GroundOperator) -> bool:
        return any(a in self.wanted and (a not in self._atoms or a in self.deleted) for a in op.add) or any(
            a in self.unwanted and (a in self._atoms or a in self.added) for a in op.delete | op.swept
        )

    def take(self, op: GroundOperator) -> None:
        self.added |= op.add
        self.deleted |= op.delete | op.swept
        for atom in op.preconditions:
            self.wanted.add(atom)
        for atom, form, holds in self._costs.hangs_on(op, self._objects):
            (self.wanted if holds else self.unwanted).add(atom, form)
