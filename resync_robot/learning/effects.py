"""Which predicates could there be? Candidates by what skills do to them, checked against the data without training.

A candidate is a signature and an effect vector (Delta^psi): for a few skills, whether they make its atoms true (+),
false (-) or leave them as they are (0). A vector and its negative describe a predicate and its negation: one
candidate. Along a trajectory an effect forces values, which hold until the next skill that affects the atom;
where two forced values meet, no classifier can fit and none is trained.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

from resync_robot.core.symbols import Object, Type, distinct_products
from resync_robot.learning.dataset import Dataset, Run, Step

Slots = tuple[int | None, ...]
"""For each argument of a predicate the parameter of a skill it is, or None for a type the skill does not mention."""

Told = dict[tuple[int, tuple[Object, ...]], list[int]]
"""(moment, arguments) -> the values that something forces on that atom."""

MAX_CONFLICTS = 0.05
"""A candidate is contradicted when more of its forced stretches than this disagree; noise makes a few."""


@dataclass(frozen=True, slots=True, order=True)
class Effect:
    """A skill makes the atoms with these slots true (+1) or false (-1)."""

    skill: str
    slots: Slots
    sign: int


@dataclass(frozen=True, slots=True, order=True)
class Attempts:
    """A skill's attempts as labels: the objects in these slots allow it (success) or do not (failure). Of a type that
    the skill does not mention all objects allow it, or at least one of them does not."""

    skill: str
    slots: Slots


@dataclass(frozen=True, slots=True)
class Candidate:
    """A predicate that may be worth learning.

    Attributes:
        effects: nonzero entries of the effect vector.
        attempts: where given, failed and successful attempts label its atoms besides.
    """

    types: tuple[Type, ...]
    effects: tuple[Effect, ...]
    attempts: Attempts | None = None

    @property
    def name(self) -> str:
        kinds = "-".join(t.name for t in self.types)
        if self.attempts is not None:
            # The usual case, "what the skill is about" as the first argument, needs no mention of the slots.
            usual = self.attempts.slots[0] == 1 and self.attempts.slots.count(None) == len(self.types) - 1
            which = "" if usual else "".join(map(_slot, self.attempts.slots))
            return f"Ready{self.attempts.skill}{which}-{kinds}"
        signs = [f"{e.skill}{''.join(map(_slot, e.slots))}{'pos' if e.sign > 0 else 'neg'}" for e in self.effects]
        return "-".join([*signs, kinds])

    def __str__(self) -> str:
        vector = ", ".join(f"{e.skill} {'+' if e.sign > 0 else '-'}" for e in self.effects)
        labels = f", attempts of {self.attempts.skill}" if self.attempts else ""
        return f"({', '.join(t.name for t in self.types)}): {vector}{labels}"


def _slot(slot: int | None) -> str:
    return "x" if slot is None else str(slot)


def signatures(recovery: Sequence[Type]) -> list[tuple[Type, ...]]:
    """Unary over each type of the recovery, binary over each pair of its parameters."""
    unary = [(t,) for t in dict.fromkeys(recovery)]
    return unary + list(dict.fromkeys(combinations(recovery, 2)))


def slots(types: Sequence[Type], parameters: Sequence[Type]) -> list[Slots]:
    """Ways to read a predicate's arguments as a skill's parameters; none where they share no type."""
    choices: list[list[int | None]] = [
        [i for i, p in enumerate(parameters) if p == t] or [None]  # type: ignore[list-item]
        for t in types
    ]
    found = []
    for chosen in product(*choices):
        bound = [c for c in chosen if c is not None]
        if bound and len(set(bound)) == len(bound):
            found.append(tuple(chosen))
    return found


def candidates(recovery: str, skills: Sequence[str], parameters: Mapping[str, Sequence[Type]]) -> list[Candidate]:
    """Every effect vector over `skills`, up to its sign, for every signature of the recovery.

    Args:
        skills: recovery skill, failed skill, skill after the recovery (repeated names count once).
    """
    result: dict[Candidate, None] = {}
    for types in signatures(parameters[recovery]):
        options: list[list[Effect | None]] = []
        for skill in sorted(set(skills), key=lambda s: (s != recovery, s)):
            ways = slots(types, parameters[skill])
            options.append([None, *(Effect(skill, w, sign) for w in ways for sign in (1, -1))])
        for chosen in product(*options):
            effects = tuple(e for e in chosen if e is not None)
            # The recovery stands first, so a vector is kept in the form in which the recovery achieves.
            if effects and effects[0].sign > 0:
                result[Candidate(types, effects)] = None
    return list(result)


def affordances(recovery: str, skills: Sequence[str], parameters: Mapping[str, Sequence[Type]]) -> list[Candidate]:
    """Candidates that the recovery achieves and that one skill's attempts label: "ready for that skill".

    After the recovery they hold; that they did not before is for the skill's own failures to say.
    """
    return [
        Candidate(types, (Effect(recovery, gained, 1),), Attempts(skill, needed))
        for types in signatures(parameters[recovery])
        for gained in slots(types, parameters[recovery])
        for skill in skills
        for needed in attempted(types, parameters[skill])
    ]


def attempted(types: Sequence[Type], parameters: Sequence[Type]) -> list[Slots]:
    """Which objects a skill's attempts label: those that it names, else all of these types."""
    return slots(types, parameters) or [(None,) * len(types)]


def affected(step: Step, where: Slots, types: Sequence[Type], objects: Sequence[Object]) -> list[tuple[Object, ...]]:
    """The arguments of the ground atoms that a step touches; a type the skill lacks stands for all its objects."""
    pools = [
        [o for o in objects if o.type == t] if s is None else [step.objects[s]]
        for s, t in zip(where, types, strict=True)
    ]
    return distinct_products(pools)


@dataclass(frozen=True, slots=True)
class Label:
    """At a moment all of these atoms hold (value 1), or at least one of them does not (value 0)."""

    run: int
    moment: int
    atoms: tuple[tuple[Object, ...], ...]
    value: int
    direct: bool


@dataclass(frozen=True, slots=True)
class Invariance:
    """A step that leaves an atom as it is."""

    run: int
    before: int
    after: int
    args: tuple[Object, ...]


@dataclass(frozen=True)
class Supervision:
    """What the data say about a candidate.

    Attributes:
        labels: direct ones (effects and attempts) and those that hold by propagation.
        conflicts: share of the stretches with a forced value that have both.
    """

    labels: tuple[Label, ...]
    invariances: tuple[Invariance, ...]
    conflicts: float

    @property
    def contradicted(self) -> bool:
        return self.conflicts > MAX_CONFLICTS


def supervise(dataset: Dataset, candidate: Candidate, explained: Collection[Step] = ()) -> Supervision:
    """Labels, invariances and contradictions of a candidate over the whole data set.

    Args:
        explained: failed attempts whose cause is known to be another one; they label nothing.
    """
    labels: list[Label] = []
    invariances: list[Invariance] = []
    forced = conflicting = 0
    for r, run in enumerate(dataset.runs):
        groups, told = _direct(r, run, candidate, explained)
        labels += groups
        for args in distinct_products([[o for o in run.objects if o.type == t] for t in candidate.types]):
            for stretch, kept in _stretches(run, candidate, args):
                invariances += [Invariance(r, a, b, args) for a, b in kept]
                values = {v for m in stretch for v in told.get((m, args), ())}
                forced += bool(values)
                conflicting += len(values) > 1
                if len(values) == 1:
                    value = values.pop()
                    unsaid = [m for m in stretch if (m, args) not in told]
                    labels += [Label(r, m, (args,), value, direct=False) for m in unsaid]
    return Supervision(tuple(labels), tuple(invariances), conflicting / max(forced, 1))


def _direct(r: int, run: Run, candidate: Candidate, explained: Collection[Step]) -> tuple[list[Label], Told]:
    """Labels from effects and attempts, and the values they force on single atoms."""
    labels: list[Label] = []

    def hold(moment: int, atoms: list[tuple[Object, ...]], value: int) -> None:
        # Each of them holds, or, where several could be to blame, at least one does not.
        groups = [(a,) for a in atoms] if value else [tuple(atoms)]
        labels.extend(Label(r, moment, g, value, direct=True) for g in groups if g)

    for step in run.steps:
        for effect in candidate.effects:
            if effect.skill == step.skill:
                for args in affected(step, effect.slots, candidate.types, run.objects):
                    # What a skill's attempts label may have held before: the block that one skill could not take
                    # may well have served another.
                    if candidate.attempts is None:
                        hold(step.before, [args], (1 - effect.sign) // 2)
                    hold(step.after, [args], (1 + effect.sign) // 2)
    if (source := candidate.attempts) is not None:
        for step, value in [*((s, 1) for s in run.steps), *((s, 0) for s in run.failures if s not in explained)]:
            if step.skill == source.skill:
                hold(step.before, affected(step, source.slots, candidate.types, run.objects), value)
    labels = list(dict.fromkeys(labels))
    told: Told = {}
    for label in labels:
        if len(label.atoms) == 1:
            told.setdefault((label.moment, label.atoms[0]), []).append(label.value)
    return labels, told


def _stretches(
    run: Run, candidate: Candidate, args: tuple[Object, ...]
) -> Iterator[tuple[list[int], list[tuple[int, int]]]]:
    """Moments in a row between which no step affects the atom, each with the steps inside it."""
    stretch, kept = [run.first], list[tuple[int, int]]()
    for step in run.steps:
        touched = any(
            e.skill == step.skill and args in affected(step, e.slots, candidate.types, run.objects)
            for e in candidate.effects
        )
        if step.before != stretch[-1]:
            yield stretch, kept
            stretch, kept = [step.before], []
        if touched:
            yield stretch, kept
            stretch, kept = [step.after], []
        else:
            stretch.append(step.after)
            kept.append((step.before, step.after))
    yield stretch, kept
