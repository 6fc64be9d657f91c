"""A model as a table for people: what each skill needs, what it makes true, and what it ends, of which arguments."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from resync_robot.core.symbols import Atom, Operator, Variable

HEAD = ("skill", "needs", "makes true", "ends")


def model_table(operators: Iterable[Operator], learned: Collection[str] = ()) -> str:
    """A Markdown table with a row for each operator, by name; its columns are as wide as they have to be.

    Args:
        learned: names of the predicates, and of the skills, that were not given; they are set in bold.
    """
    rows: list[Sequence[str]] = [HEAD]
    for operator in sorted(operators, key=lambda o: o.name):
        own = set(operator.parameters)
        skill = f"{_named(operator.name, learned)}({', '.join(_variable(v) for v in operator.parameters)})"
        columns = operator.preconditions, operator.add, (*operator.delete, *operator.delete_all)
        rows.append((skill, *(", ".join(sorted(_atom(a, own, learned) for a in atoms)) for atoms in columns)))
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEAD))]
    lines = ["| " + " | ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "|".join("-" * (w + 2) for w in widths) + "|", *lines[1:]])


def _atom(atom: Atom, own: set[Variable], learned: Collection[str]) -> str:
    """Of what is not among an operator's parameters it ends everything there is."""
    terms = (_variable(t) if t in own else f"any {t.type.name}" for t in atom.args)
    return f"{_named(atom.predicate.name, learned)}({', '.join(terms)})"


def _variable(term: object) -> str:
    return str(getattr(term, "name", term)).removeprefix("?")


def _named(name: str, learned: Collection[str]) -> str:
    return f"**{name}**" if name in learned else name
