"""The learned model: readable names, operators, library records, a report, and the way back from a library."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from resync_robot.core.errors import LibraryError
from resync_robot.core.library import RETRAIN, Record
from resync_robot.core.relations import DEFAULTS, Relations
from resync_robot.core.symbols import Atom, Atoms, Operator, Predicate, Type
from resync_robot.learning.classifiers import KIND, NeuralClassifier
from resync_robot.learning.effects import Candidate
from resync_robot.learning.fit import Fit
from resync_robot.learning.operators import Column
from resync_robot.learning.select import Concept, Selection
from resync_robot.planning.abstract import Classifier, Exists, ForAll, Form, Not, form_from_json, form_to_json
from resync_robot.planning.pddl import domain_from_pddl, domain_to_pddl

DERIVED = "derived"


class GivenModel(Protocol):
    """What concept learning needs of a domain: a `core.task.Domain` is one."""

    @property
    def name(self) -> str: ...
    @property
    def types(self) -> tuple[Type, ...]: ...
    @property
    def predicates(self) -> tuple[Predicate, ...]: ...
    @property
    def classifiers(self) -> Mapping[str, Classifier]: ...
    @property
    def operators(self) -> tuple[Operator, ...]: ...
    @property
    def relations(self) -> Relations: ...


@dataclass(frozen=True)
class Concepts:
    """A symbolic model with its classifiers.

    Attributes:
        predicates: given and learned.
        classifiers: predicate name -> classifier or derived form, given ones included.
        records: learned predicates as library records.
        report: what was tried, kept and why; plain data. `affordance_of[skill]` is {"predicate", "argument"}: the
            learned predicate that the skill needs, and which of the skill's parameters it is about. After the skill
            failed on an object, that atom is to be held false until a recovery. `experience` is that of
            `learning.experience`.
    """

    predicates: tuple[Predicate, ...]
    classifiers: Mapping[str, Classifier | Form]
    operators: tuple[Operator, ...]
    records: Mapping[str, Record]
    report: Mapping[str, Any]


@dataclass(frozen=True)
class _Named:
    """A learned predicate under its final name; `form` refers to final names."""

    predicate: Predicate
    form: Form | None
    candidate: Candidate | None
    fit: Fit | None


def load_concepts(
    domain_pddl: str,
    records: Mapping[str, Record],
    types: Mapping[str, Type],
    given: Mapping[str, Classifier],
    relations: Relations = DEFAULTS,
) -> tuple[tuple[Predicate, ...], dict[str, Classifier | Form], tuple[Operator, ...]]:
    """(predicates, classifiers, operators) from the texts and records of a library.

    Args:
        given: classifiers of the predicates that are not learned.
        relations: those that the domain declares.

    Raises:
        LibraryError: a predicate of the domain has neither a given classifier nor a readable record.
        PlanningError: the PDDL text is malformed.
    """
    predicates, operators = domain_from_pddl(domain_pddl, types)
    by_name = {p.name: p for p in predicates}
    classifiers: dict[str, Classifier | Form] = dict(given)
    for name, record in records.items():
        if name not in by_name:
            raise LibraryError(f"domain.pddl declares no predicate '{name}', but there is a record of it", RETRAIN)
        if record.meta.get("kind") == DERIVED:
            classifiers[name] = form_from_json(record.meta, by_name)
            continue
        if record.meta.get("kind") != KIND:
            raise LibraryError(f"the record of {name} is of kind {record.meta.get('kind')!r}", RETRAIN)
        classifier = NeuralClassifier.from_record(name, record, types, relations)
        if classifier.types != by_name[name].types:
            raise LibraryError(f"domain.pddl and the record of {name} disagree about its types", RETRAIN)
        classifiers[name] = classifier
    missing = sorted(set(by_name) - set(classifiers))
    if missing:
        raise LibraryError(f"no classifier for {', '.join(missing)}", RETRAIN)
    return predicates, classifiers, operators


def assemble(
    given: GivenModel,
    selection: Selection,
    pool: Sequence[Concept],
    report: Mapping[str, Any],
) -> Concepts:
    """Name what was selected, add the predicates it derives from, and write it all down.

    Args:
        pool: every concept that could be selected, for the predicates that selected ones derive from.
        report: what earlier stages have to say; the model is added to it.
    """
    # PDDL has one space of names, so a new predicate is called like no type and no operator either.
    taken = [*(t.name for t in given.types), *(p.name for p in given.predicates)]
    named, names = _name(selection.concepts, {*taken, *(o.name for o in selection.score.operators)})
    renamed = {old: n.predicate for old, n in names.items()}
    operators = tuple(_renamed(_with_effects(op, pool, names), renamed) for op in selection.score.operators)
    predicates = (*given.predicates, *(n.predicate for n in named))
    classifiers: dict[str, Classifier | Form] = dict(given.classifiers)
    records: dict[str, Record] = {}
    for n in named:
        described: dict[str, Any] = {"signature": [t.name for t in n.predicate.types]}
        if n.form is not None:
            classifiers[n.predicate.name] = n.form
            records[n.predicate.name] = Record({**described, "kind": DERIVED, **form_to_json(n.form)})
        elif n.fit is not None:
            described["candidate"] = str(n.candidate)
            figures = (("loss", n.fit.loss), ("train_loss", n.fit.train_loss), ("accuracy", n.fit.accuracy))
            described |= {name: round(value, 5) for name, value in figures}
            classifiers[n.predicate.name] = n.fit.classifier
            records[n.predicate.name] = n.fit.classifier.to_record(described)
    return Concepts(
        predicates,
        classifiers,
        operators,
        records,
        {
            **report,
            "curve": selection.curve,
            "predicates": [f"{n.predicate.name}({', '.join(t.name for t in n.predicate.types)})" for n in named],
            "derived": {n.predicate.name: form_to_json(n.form) for n in named if n.form is not None},
            "pddl": domain_to_pddl(given.name, given.types, predicates, operators),
            "changes": _changes(given.operators, operators),
            "affordance_of": _affordances(operators, selection, names),
            "exclusion": _exclusion(selection),
        },
    )


def _name(selected: Sequence[Concept], taken: set[str]) -> tuple[list[_Named], dict[str, _Named]]:
    """Selected concepts and what they derive from, under final names; and the same by their names in the pool.

    A predicate labelled by a skill's attempts is `Ready<Skill>`, another one `Concept<n>`, a form of a given predicate
    keeps its name. The plain name goes to what was selected, so that plans read well; a base it derives from adds the
    types that were quantified away.
    """
    named: dict[str, _Named] = {}
    used = {t.lower() for t in taken}

    def add(old: Predicate, wish: str, concept: Concept, form: Form | None) -> Predicate:
        if old.name not in named:
            name, n = wish, 2
            while name.lower() in used:
                name, n = f"{wish}{n}", n + 1
            used.add(name.lower())
            named[old.name] = _Named(Predicate(name, old.types), form, concept.candidate, concept.fit)
        return named[old.name].predicate

    for i, concept in enumerate(selected, start=1):
        # From the outermost form inwards; a form is at most a negation of a quantification of the base.
        chain: list[Form] = []
        form = concept.form
        while form is not None:
            chain.append(form)
            form = _form_called(form.base, concept.base)
        candidate = concept.candidate
        if candidate is None:
            inner, wishes = concept.base, [f.predicate.name for f in chain]
        else:
            root = f"Ready{candidate.attempts.skill}" if candidate.attempts else f"Concept{i}"
            foreign = [f"-{f.base.types[k].name}" for f in chain if isinstance(f, ForAll | Exists) for k in f.over]
            inner = add(concept.base, root + "".join(foreign), concept, None)
            wishes = [f"Not{root}" if isinstance(f, Not) else root for f in chain]
        for derived, wish in reversed(list(zip(chain, wishes, strict=True))):
            inner = add(derived.predicate, wish, concept, replace(derived, base=inner))
    return list(named.values()), named


def _form_called(predicate: Predicate, base: Predicate) -> Form | None:
    """The quantification of `base` that `predicate` stands for, None where it is the base itself."""
    if predicate == base:
        return None
    for form in quantifications(base):
        if form.predicate == predicate:
            return form
    raise LibraryError(f"{predicate.name} is no form of {base.name}", RETRAIN)


def quantifications(base: Predicate) -> list[Form]:
    """ForAll and Exists over every choice of the arguments of `base`."""
    subsets = [tuple(i for i in range(len(base.types)) if mask >> i & 1) for mask in range(1, 2 ** len(base.types))]
    return [kind(base, over) for over in sorted(subsets, key=lambda s: (len(s), s)) for kind in (ForAll, Exists)]


def _with_effects(operator: Operator, pool: Sequence[Concept], names: Mapping[str, _Named]) -> Operator:
    """The operator with its effects on bases that were not selected themselves, so that the model says all it knows."""
    add, delete = set(operator.add), set(operator.delete)
    for concept in pool:
        if concept.predicate.name in names:
            for column in concept.evidence[operator.name]:
                sign = _usual_change(column)
                if sign and column.atom not in add | delete:
                    (add if sign > 0 else delete).add(column.atom)
    return replace(operator, add=frozenset(add), delete=frozenset(delete))


def _usual_change(column: Column) -> int:
    """+1 or -1 where most successes change the atom so, else 0."""
    if not len(column.before):
        return 0
    gained, lost = (column.after & ~column.before).mean(), (column.before & ~column.after).mean()
    return 1 if gained > 0.5 else -1 if lost > 0.5 else 0


def _renamed(operator: Operator, names: Mapping[str, Predicate]) -> Operator:
    def atoms(of: Atoms) -> Atoms:
        return frozenset(Atom(names.get(a.predicate.name, a.predicate), a.args) for a in of)

    return replace(
        operator,
        preconditions=atoms(operator.preconditions),
        add=atoms(operator.add),
        delete=atoms(operator.delete),
    )


def _changes(before: Iterable[Operator], after: Iterable[Operator]) -> list[str]:
    """What differs from the given model, one line a difference."""
    known = {op.name: op for op in before}
    lines: list[str] = []
    for op in after:
        old = known.get(op.name)
        if old is None:
            lines.append(f"{op.name}: new operator")
        for what, now, was in (
            ("needs", op.preconditions, old.preconditions if old else frozenset()),
            ("achieves", op.add, old.add if old else frozenset()),
            ("destroys", op.delete, old.delete if old else frozenset()),
        ):
            lines += [f"{op.name} {what} {a}" for a in sorted(now - was)]
            lines += [f"{op.name} no longer {what} {a}" for a in sorted(was - now)]
    return lines


def _affordances(
    operators: Iterable[Operator], selection: Selection, names: Mapping[str, _Named]
) -> dict[str, dict[str, Any]]:
    """For each skill the learned precondition over one of its parameters that excludes most of its failures."""
    result: dict[str, dict[str, Any]] = {}
    for op in operators:
        best = (0, "", -1)
        for concept in selection.concepts:
            predicate = names[concept.predicate.name].predicate
            for column in concept.evidence[op.name]:
                needed = Atom(predicate, column.atom.args) in op.preconditions
                if concept.candidate is not None and needed and len(column.atom.args) == 1:
                    argument = [v.name for v in op.parameters].index(column.atom.args[0].name)
                    best = max(best, (int((~column.failed).sum()) + 1, predicate.name, argument))
        if best[0]:
            result[op.name] = {"predicate": best[1], "argument": best[2]}
    return result


def _exclusion(selection: Selection) -> dict[str, dict[str, float]]:
    """For each skill the share of its failures, and of its successes, that its learned preconditions rule out."""
    result = {}
    for op in selection.score.operators:
        columns = [c for k in selection.concepts for c in k.evidence[op.name] if c.atom in op.preconditions]
        if columns:
            failed = [c.failed for c in columns]
            result[op.name] = {
                "failures": round(1.0 - float(_all(failed).mean()), 4) if len(failed[0]) else 0.0,
                "successes": round(1.0 - float(_all([c.before for c in columns]).mean()), 4),
            }
    return result


def _all(columns: Sequence[Any]) -> Any:
    held = columns[0].copy()
    for c in columns[1:]:
        held &= c
    return held
