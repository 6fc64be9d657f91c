"""Operators from data: what a skill's successful attempts have in common, lifted to its parameters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from jaxtyping import Bool, Int8
from scipy.special import betainc

from resync_robot.core.symbols import Atom, Atoms, Operator, Predicate, Term, Type, Variable
from resync_robot.learning.dataset import Dataset, Step


@dataclass(frozen=True, kw_only=True)
class OperatorConfig:
    """What counts as a precondition.

    Attributes:
        held_before: an atom over the parameters that held before this share of the matching successes.
        excludes_failures: default view only: a learned one, and a given one that a skill is not said to need, must also
            rule out more than this share of the skill's failures in the data of one stage that are not ruled out
            already,
        excludes_successes: and less than this share of its successes.
        least_cluster: the effects are those of a cluster that holds at least this share of the successes, or else of
            the largest; 1: of the largest in any case.
        use_failures: False for the published formulation, which has no failed attempts.
    """

    held_before: float = 0.8
    excludes_failures: float = 0.5
    excludes_successes: float = 0.15
    least_cluster: float = 0.1
    use_failures: bool = True


@dataclass(frozen=True)
class Column:
    """One lifted atom of one skill, over all attempts.

    Attributes:
        before, after: (successes,) whether it held.
        failed: (failures,) whether it held before.
        learned: False for a given predicate.
        stage: (failures,) in whose data each failure is.
    """

    atom: Atom
    before: np.ndarray
    after: np.ndarray
    failed: np.ndarray
    learned: bool
    stage: np.ndarray


SURE = 0.9
"""A skill usually does something where it is that likely, after the successes that could show it, that it does so in
more than half of them: three of three are enough, and so are five of six."""
MIN_EXPLAINED = 5
MAX_EXCEPTIONS = 0.01
"""A condition accounts for failures when it was missing in so many, and in at most this share of the successes."""
MOSTLY_FATAL = 0.9
"""A condition that an earlier stage learned accounts for failures where at least this share of attempts without it
failed: its classifier may err at its edge."""

Evidence = dict[str, tuple[Column, ...]]
"""Skill name -> the columns of one predicate."""


def lifted_atoms(predicate: Predicate, parameters: Sequence[Variable]) -> list[Atom]:
    """Every well-typed way to apply the predicate to distinct parameters."""
    chosen = permutations(parameters, len(predicate.types))
    return [predicate(*args) for args in chosen if tuple(a.type for a in args) == predicate.types]


def evidence(
    dataset: Dataset,
    truth: Sequence[Atoms],
    predicate: Predicate,
    parameters: Mapping[str, Sequence[Variable]],
    learned: bool,
) -> Evidence:
    """Columns of a predicate for every skill.

    Args:
        truth: for each moment the atoms of this predicate that hold.
        parameters: skill name -> its variables.
    """
    successes: dict[str, list[Step]] = {name: [] for name in parameters}
    failures: dict[str, list[Step]] = {name: [] for name in parameters}
    stages: dict[str, list[int]] = {name: [] for name in parameters}
    for run in dataset.runs:
        for step in run.steps:
            successes[step.skill].append(step)
        for step in run.failures:
            failures[step.skill].append(step)
            stages[step.skill].append(run.stage)

    def held(steps: Sequence[Step], atom: Atom, variables: Sequence[Variable], after: bool) -> np.ndarray:
        values = []
        for step in steps:
            binding: dict[Term, Term] = dict(zip(variables, step.objects, strict=True))
            values.append(atom.substitute(binding) in truth[step.after if after else step.before])
        return np.array(values, dtype=bool)

    return {
        skill: tuple(
            Column(
                atom,
                held(successes[skill], atom, variables, False),
                held(successes[skill], atom, variables, True),
                held(failures[skill], atom, variables, False),
                learned,
                np.array(stages[skill], dtype=int),
            )
            for atom in lifted_atoms(predicate, variables)
        )
        for skill, variables in parameters.items()
    }


def swept(
    dataset: Dataset,
    truth: Sequence[Atoms],
    predicates: Iterable[Predicate],
    parameters: Mapping[str, Sequence[Variable]],
) -> dict[str, Atoms]:
    """What each skill ends of objects that it does not name: lifted atoms, some of whose variables are no parameters.

    Args:
        truth: for each moment the atoms that hold.
        parameters: skill name -> its variables.
    """
    steps: dict[str, list[Step]] = {name: [] for name in parameters}
    for run in dataset.runs:
        for step in run.steps:
            steps[step.skill].append(step)
    by_predicate = [{p: _of(atoms, p) for p in predicates} for atoms in truth]
    several = {t for run in dataset.runs for t, n in Counter(o.type for o in run.objects).items() if n > 1}
    found: dict[str, Atoms] = {}
    for skill, variables in parameters.items():
        # Of a type of which there is only ever one object, that one is named.
        others = several | {t for p in predicates for t in p.types if t not in {v.type for v in variables}}
        atoms = [a for p in predicates for a in _patterns(p, variables, others)]
        added = [
            a for p in predicates for a in lifted_atoms(p, variables) if _adds(a, variables, steps[skill], by_predicate)
        ]
        ended = [a for a in atoms if _ends(a, added, variables, steps[skill], by_predicate)]
        found[skill] = frozenset(a for a in ended if not any(_says_more(b, a, variables) for b in ended))
    return found


def _of(atoms: Atoms, predicate: Predicate) -> Atoms:
    return frozenset(a for a in atoms if a.predicate == predicate)


def _says_more(general: Atom, special: Atom, parameters: Sequence[Variable]) -> bool:
    """Whether ending all of the one ends all of the other as well."""
    pairs = list(zip(general.args, special.args, strict=True)) if general.predicate == special.predicate else []
    return general != special and bool(pairs) and all(a == b or a not in parameters for a, b in pairs)


def _patterns(predicate: Predicate, parameters: Sequence[Variable], others: Collection[Type]) -> list[Atom]:
    """Every way to apply the predicate to at least one parameter and at least one object of `others` that is none."""
    free = [Variable(f"?any{i}", t) for i, t in enumerate(predicate.types)]
    named = [[v for v in parameters if v.type == f.type] for f in free]
    ways = product(*([*([f] if f.type in others else []), *n] for f, n in zip(free, named, strict=True)))
    chosen = [w for w in ways if any(t in free for t in w) and any(t not in free for t in w)]
    return [predicate(*w) for w in chosen if len(set(w)) == len(w)]


def _adds(
    atom: Atom,
    parameters: Sequence[Variable],
    steps: Sequence[Step],
    truth: Sequence[Mapping[Predicate, Atoms]],
) -> bool:
    """Whether successes usually bring it about; of an operator it is added after anything is deleted."""
    became = []
    for step in steps:
        ground = atom.substitute(dict(zip(parameters, step.objects, strict=True)))
        if ground not in truth[step.before][atom.predicate]:
            became.append(ground in truth[step.after][atom.predicate])
    return _usually(became)


def _ends(
    pattern: Atom,
    added: Sequence[Atom],
    parameters: Sequence[Variable],
    steps: Sequence[Step],
    truth: Sequence[Mapping[Predicate, Atoms]],
) -> bool:
    """Whether successes usually leave nothing of it: of other objects, and of those that the skill names neither, but
    for what it adds itself."""
    of_others, of_named = [], []
    for step in steps:
        binding = dict(zip(parameters, step.objects, strict=True))
        fixed = [binding.get(t) if isinstance(t, Variable) else t for t in pattern.args]
        there, then = (truth[m][pattern.predicate] for m in (step.before, step.after))
        before = [a for a in there if all(f in (None, o) for f, o in zip(fixed, a.args, strict=True))]
        others = [a for a in before if not set(a.args) <= set(step.objects)]
        own = {a.substitute(binding) for a in added}
        named = [a for a in before if set(a.args) <= set(step.objects) and a not in own]
        if others:
            of_others.append(not any(a in then for a in others))
        if named:
            of_named.append(not any(a in then for a in named))
    # One punch at a block that was held all along says nothing of others.
    return _usually(of_others) and not _usually([not ended for ended in of_named])


def _usually(shown: Sequence[bool]) -> bool:
    """Whether a share that gave these draws is above one half, by Bayes' rule with a flat prior."""
    yes = sum(shown)
    return float(betainc(len(shown) - yes + 1, yes + 1, 0.5)) > SURE


def explained_failures(dataset: Dataset, columns: Sequence[Evidence], learned: Collection[Predicate] = ()) -> set[Step]:
    """Failed attempts that an atom over the skill's parameters accounts for: where it was false, nothing succeeded.

    Such failures say nothing about what is still to be learned: a block under another one cannot be picked wherever
    it stands, and a puck behind a closed door cannot be fetched, whatever lies in its way besides.

    Args:
        learned: predicates of earlier stages.
    """
    failures: dict[str, list[Step]] = {}
    for run in dataset.runs:
        for step in run.failures:
            failures.setdefault(step.skill, []).append(step)
    explained: set[Step] = set()
    for skill, steps in failures.items():
        for column in (c for e in columns for c in e[skill]):
            without, exceptions = ~column.failed, ~column.before
            if not len(exceptions) or without.sum() < MIN_EXPLAINED:
                continue
            impossible = bool(column.atom.args) and exceptions.mean() <= MAX_EXCEPTIONS
            fatal = without.sum() / (without.sum() + exceptions.sum()) >= MOSTLY_FATAL
            if impossible or (column.atom.predicate in learned and fatal):
                explained |= {s for s, w in zip(steps, without, strict=True) if w}
    return explained


def learn_operator(
    name: str,
    parameters: tuple[Variable, ...],
    columns: Sequence[Column],
    config: OperatorConfig,
    said: Operator | None = None,
) -> Operator | None:
    """The operator of one skill, or None where the skill never succeeded.

    Effects are those of a cluster of successes with the same lifted effects, preconditions what held before most of
    that cluster. Of clusters that are no handful it is the one whose effects explain most successes: what held already
    is achieved as well.

    Args:
        said: what was believed of the skill before. That a lid was off whenever a drawer was opened tells of the order
            in which things were done, not of drawers, unless failures say otherwise.
    """
    if not columns or not len(columns[0].before):
        return None
    before = np.stack([c.before for c in columns], 1)
    after = np.stack([c.after for c in columns], 1)
    change = after.astype(np.int8) - before.astype(np.int8)
    patterns, of, counts = np.unique(change, axis=0, return_inverse=True, return_counts=True)
    # One that a few show by chance would explain all others before which its effects held.
    common = np.flatnonzero(counts >= min(config.least_cluster * len(change), counts.max()))
    explained = [int(_explains(patterns[i], change, after).sum()) for i in common]
    # Ties go to the larger cluster, then to the smaller pattern, so that the order of the data decides nothing.
    best = max(range(len(common)), key=lambda k: (explained[k], counts[common[k]], -k))
    matching, effect = of.reshape(-1) == common[best], patterns[common[best]]

    frequent = [c for c in columns if c.before[matching].mean() >= config.held_before]
    if config.use_failures:
        needed = {c.atom for c in frequent if not c.learned and (said is None or c.atom in said.preconditions)}
        needed |= _that_exclude_failures([c for c in frequent if c.atom not in needed], config)
    else:
        needed = {c.atom for c in frequent}
    return Operator(
        name,
        parameters,
        frozenset(needed),
        frozenset(c.atom for c, e in zip(columns, effect, strict=True) if e > 0),
        frozenset(c.atom for c, e in zip(columns, effect, strict=True) if e < 0),
    )


def _explains(
    pattern: Int8[np.ndarray, " k"], change: Int8[np.ndarray, "n k"], after: Bool[np.ndarray, "n k"]
) -> Bool[np.ndarray, " n"]:
    """The successes that a skill with these effects can have had."""
    return np.all(np.where(pattern > 0, after, np.where(pattern < 0, ~after, change == 0)), axis=1)


def _that_exclude_failures(columns: Sequence[Column], config: OperatorConfig) -> set[Atom]:
    """Greedily the conditions that tell failures from successes; another one must still tell something new.

    Each stage is about a failure of its own, so a condition counts for what it rules out in the data of one stage: of
    the failures of many stages together no condition need rule out much.
    """
    chosen: set[Atom] = set()
    useful = [c for c in columns if len(c.failed) and (~c.before).mean() < config.excludes_successes]
    if not useful:
        return chosen
    left = np.ones(len(useful[0].failed), dtype=bool)
    stages = [useful[0].stage == n for n in np.unique(useful[0].stage)]

    def ruled_out(column: Column) -> float:
        """The share of what is left of a stage's failures, where that is the largest; a handful proves nothing."""
        shares = [0.0]
        for of in stages:
            gone, there = (left & of & ~column.failed).sum(), (left & of).sum()
            if there and gone >= max(0.05 * of.sum(), MIN_EXPLAINED):
                shares.append(float(gone / there))
        return max(shares)

    def worth(column: Column) -> tuple[float, str]:
        return ruled_out(column) - (~column.before).mean(), str(column.atom)

    while left.any():
        best = max(useful, key=worth)
        if ruled_out(best) <= config.excludes_failures:
            break
        chosen.add(best.atom)
        left &= best.failed
    return chosen
