"""The learned model: readable names, operators, library records, a report, and the way back from a library."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from resync_robot.core.errors import LibraryError
from resync_robot.core.library import RETRAIN, Record
from resync_robot.core.relations import Relations
from resync_robot.core.symbols import Atom, Operator, Predicate, Type
from resync_robot.learning.classifiers import KIND, NeuralClassifier
from resync_robot.learning.effect_vectors import (
    candidate_from_json,
    candidate_to_json,
    effects_to_json,
    stated_effects,
)
from resync_robot.learning.effects import Candidate
from resync_robot.learning.fit import Fit
from resync_robot.learning.operators import Column, Evidence
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
        records: learned predicates as library records: `stage` in which it was learned (from 1), `effects` ({skill:
            [[slots, sign], ...]}), and `attempts` where those label it. A predicate is learned where it has a record.
        report: what was tried, kept and why; plain data. `affordances_of[skill]` lists {"predicate", "argument"}: the
            learned predicates that the skill needs, that which excludes most of its failures first, and which of the
            skill's parameters each is about. After the skill failed on an object, one of these atoms is to be held
            false until a recovery. `experience` is that of `learning.outcome_counts`.
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


def load_concepts(domain_pddl: str, records: Mapping[str, Record], given: GivenModel) -> Concepts:
    """The model that a library holds, from its texts and records.

    What the domain was given since the library was learned, a predicate or a skill with its operator, comes with it.

    Raises:
        LibraryError: a predicate of the domain has neither a given classifier nor a readable record.
        PlanningError: the PDDL text is malformed.
    """
    types = {t.name: t for t in given.types}
    predicates, operators = domain_from_pddl(domain_pddl, types)
    signatures = {op.name: tuple(v.type for v in op.parameters) for op in operators}
    by_name = {p.name: p for p in predicates}
    classifiers: dict[str, Classifier | Form] = {p.name: given.classifiers[p.name] for p in given.predicates}
    for name, record in records.items():
        if name not in by_name:
            raise LibraryError(f"domain.pddl declares no predicate '{name}', but there is a record of it", RETRAIN)
        if record.meta.get("kind") == DERIVED:
            classifiers[name] = form_from_json(record.meta, by_name)
            continue
        if record.meta.get("kind") != KIND:
            raise LibraryError(f"the record of {name} is of kind {record.meta.get('kind')!r}", RETRAIN)
        classifier = NeuralClassifier.from_record(name, record, types, given.relations)
        if classifier.types != by_name[name].types:
            raise LibraryError(f"domain.pddl and the record of {name} disagree about its types", RETRAIN)
        try:
            candidate_from_json(record.meta, classifier.types, signatures)
        except ValueError as error:
            raise LibraryError(f"the record of {name} has no effect vector: {error}", RETRAIN) from None
        classifiers[name] = classifier
    missing = sorted(set(by_name) - set(classifiers))
    if missing:
        raise LibraryError(f"no classifier for {', '.join(missing)}", RETRAIN)
    return known_model(given, Concepts(predicates, classifiers, operators, records, {}))


def known_model(given: GivenModel, learned: Concepts | None) -> Concepts:
    """What is known before a stage: the domain's own model, and what earlier stages learned beside and over it."""
    if learned is None:
        return Concepts(given.predicates, given.classifiers, given.operators, {}, {})
    names = {p.name for p in learned.predicates} | {o.name for o in learned.operators}
    return replace(
        learned,
        predicates=(*learned.predicates, *(p for p in given.predicates if p.name not in names)),
        classifiers={**given.classifiers, **learned.classifiers},
        operators=(*learned.operators, *(o for o in given.operators if o.name not in names)),
    )


def assemble(
    given: GivenModel,
    known: Concepts,
    known_evidence: Sequence[Evidence],
    selection: Selection,
    pool: Sequence[Concept],
    stage: int,
    report: Mapping[str, Any],
) -> Concepts:
    """Name what was selected, add the predicates it derives from, and write it all down beside what was known.

    Args:
        known: the model before this stage.
        known_evidence: columns of its predicates.
        pool: every concept that could be selected, for the predicates that selected ones derive from.
        stage: number of this stage, from 1.
        report: what earlier steps have to say; the model is added to it.
    """
    # PDDL has one space of names, so a new predicate is called like no type and no operator either.
    taken = [*(t.name for t in given.types), *(p.name for p in known.predicates)]
    named, names = _name(selection.concepts, {*taken, *(o.name for o in selection.score.operators)})
    renamed = {old: n.predicate for old, n in names.items()}
    operators = tuple(_with_effects(op, pool, names).renamed(renamed) for op in selection.score.operators)
    predicates = (*known.predicates, *(n.predicate for n in named))
    classifiers: dict[str, Classifier | Form] = dict(known.classifiers)
    records: dict[str, Record] = dict(known.records)
    for n in named:
        described: dict[str, Any] = {"signature": [t.name for t in n.predicate.types], "stage": stage}
        if n.form is not None:
            classifiers[n.predicate.name] = n.form
            records[n.predicate.name] = Record({**described, "kind": DERIVED, **form_to_json(n.form)})
        elif n.fit is not None and n.candidate is not None:
            described |= {"candidate": str(n.candidate), **candidate_to_json(n.candidate)}
            figures = (("loss", n.fit.loss), ("train_loss", n.fit.train_loss), ("accuracy", n.fit.accuracy))
            described |= {name: round(value, 5) for name, value in figures}
            classifiers[n.predicate.name] = n.fit.classifier
            records[n.predicate.name] = n.fit.classifier.to_record(described)
    for p in predicates:
        if p.name in records and records[p.name].meta["kind"] == DERIVED:
            # Nobody chose these effects: they follow from those of the base, as the operators state them.
            effects = effects_to_json(stated_effects(p, operators))
            records[p.name] = Record({**records[p.name].meta, "effects": effects})
    needed = {op.name: _needed(op, known_evidence, selection, names) for op in operators}
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
            "changes": _changes(known.operators, operators),
            "affordances_of": _affordances(operators, needed, classifiers),
            "exclusion": _exclusion(needed),
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
            ("destroys of everything", op.delete_all, old.delete_all if old else frozenset()),
        ):
            lines += [f"{op.name} {what} {a}" for a in sorted(now - was)]
            lines += [f"{op.name} no longer {what} {a}" for a in sorted(was - now)]
    return lines


def _needed(
    operator: Operator, known_evidence: Sequence[Evidence], selection: Selection, names: Mapping[str, _Named]
) -> list[tuple[Predicate, Column]]:
    """The learned preconditions of an operator, of earlier stages or of this one, with their columns."""
    columns = [(c.atom.predicate, c) for e in known_evidence for c in e[operator.name] if c.learned]
    for concept in selection.concepts:
        columns += [(names[concept.predicate.name].predicate, c) for c in concept.evidence[operator.name]]
    return [(p, c) for p, c in columns if Atom(p, c.atom.args) in operator.preconditions]


def _affordances(
    operators: Iterable[Operator],
    needed: Mapping[str, Sequence[tuple[Predicate, Column]]],
    classifiers: Mapping[str, Classifier | Form],
) -> dict[str, list[dict[str, Any]]]:
    """For each skill the learned preconditions over one of its parameters; that which excludes most failures first."""
    result: dict[str, list[dict[str, Any]]] = {}
    for op in operators:
        parameters = [v.name for v in op.parameters]
        found = [
            (int((~c.failed).sum()), p.name, parameters.index(c.atom.args[0].name))
            for p, c in needed[op.name]
            if len(c.atom.args) == 1 and is_neural(p, classifiers)
        ]
        if found:
            ordered = sorted(found, reverse=True)
            result[op.name] = [{"predicate": name, "argument": argument} for _, name, argument in ordered]
    return result


def is_neural(predicate: Predicate, classifiers: Mapping[str, Classifier | Form]) -> bool:
    """Was the predicate, or what it derives from, learned from examples?"""
    found = classifiers[predicate.name]
    return is_neural(found.base, classifiers) if isinstance(found, Form) else isinstance(found, NeuralClassifier)


def _exclusion(needed: Mapping[str, Sequence[tuple[Predicate, Column]]]) -> dict[str, dict[str, float]]:
    """For each skill the share of its failures, and of its successes, that its learned preconditions rule out."""
    result = {}
    for skill, pairs in needed.items():
        columns = [c for _, c in pairs]
        if columns:
            failed = [c.failed for c in columns]
            result[skill] = {
                "failures": round(1.0 - float(_all(failed).mean()), 4) if len(failed[0]) else 0.0,
                "successes": round(1.0 - float(_all([c.before for c in columns]).mean()), 4),
            }
    return result


def _all(columns: Sequence[Any]) -> Any:
    held = columns[0].copy()
    for c in columns[1:]:
        held &= c
    return held
