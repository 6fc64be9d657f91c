"""Trajectories in, concepts out: the front door of concept learning (Section "Concept Learning" of the paper).

    candidates by effect -> contradictions sorted out -> classifiers trained -> derived forms -> selection on J

Two formulations. `default`: a failed attempt and its recovery are one use of the recovery skill, failed attempts
label one "ready for that skill" candidate for each skill, J compares the first plan. `paper`: as published, a failed
attempt is a skill of its own, only successes count, J weighs several plans.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from resync_robot.core.errors import TrainingError, UnknownNameError
from resync_robot.core.relations import Relations
from resync_robot.core.symbols import Atoms, Object, Operator, Predicate, Type, Variable, distinct_products
from resync_robot.learning.classifiers import NeuralClassifier
from resync_robot.learning.dataset import (
    Dataset,
    StageData,
    Step,
    merged_dataset,
    variant_dataset,
    variant_name,
    without_unclear,
)
from resync_robot.learning.effects import Candidate, affordances, candidates, supervise
from resync_robot.learning.features import gather
from resync_robot.learning.fit import COMPACT, PAPER, SCREENING, Fit, FitConfig, fit
from resync_robot.learning.model import Concepts, GivenModel, assemble, known_model, quantifications
from resync_robot.learning.operators import Evidence, OperatorConfig, evidence, explained_failures, swept
from resync_robot.learning.outcome_counts import experience
from resync_robot.learning.select import PAPER_J, Concept, SelectConfig, Selector, select
from resync_robot.learning.tuning import TuneConfig, tune_known
from resync_robot.planning.abstract import HOLDS, Abstraction, Form, Not

SPLITS, SPLIT_LUCK, SPLIT_SEEDS = 3, 0.1, 100_003
"""What attempts label is judged by a few dozen failures that are held out, and these are drawn by chance. So a
candidate that comes within reach of the accuracy asked for is trained on three splits, and their mean decides."""

Mode = Literal["default", "paper"]
Progress = Callable[[str, float], None]
Table = dict[tuple[Object, ...], float]


@dataclass(frozen=True, kw_only=True)
class ConceptConfig:
    """Settings of concept learning.

    Attributes:
        max_loss: a classifier that fits worse on held-out trajectories is no predicate.
        min_accuracy: the same for candidates labelled by attempts, whose labels are noisy at the boundary: balanced
            accuracy on held-out labels.
        max_screening_loss, max_screening_loss_attempts: above these the small net's candidates are not trained fully.
    """

    mode: Mode = "default"
    fit: FitConfig = COMPACT
    screening: FitConfig = SCREENING
    max_loss: float = 0.05
    min_accuracy: float = 0.8
    max_screening_loss: float = 0.25
    max_screening_loss_attempts: float = 0.45
    operators: OperatorConfig = field(default_factory=OperatorConfig)
    select: SelectConfig = field(default_factory=SelectConfig)
    tune: TuneConfig = field(default_factory=TuneConfig)

    @staticmethod
    def of(mode: str) -> ConceptConfig:
        """The settings of a formulation. Raises UnknownNameError on a strange one."""
        if mode == "default":
            return ConceptConfig()
        if mode == "paper":
            operators = OperatorConfig(use_failures=False, least_cluster=1.0)
            return ConceptConfig(mode="paper", fit=PAPER, operators=operators, select=PAPER_J)
        raise UnknownNameError("formulation of concept learning", mode, ["default", "paper"])


def learn_concepts(
    stages: Sequence[StageData],
    given: GivenModel,
    known: Concepts | None = None,
    mode: str = "default",
    seed: int = 0,
    progress: Progress = lambda what, share: None,
    config: ConceptConfig | None = None,
) -> Concepts:
    """Learn predicates and operators that let the planner use the recovery skill ahead of failure.

    Args:
        stages: the data of all stages so far. The last one is new; that of earlier ones keeps what they taught: from
            the new data alone a condition that none of its failures shows would be forgotten.
        given: types, predicates with classifiers, operators of the domain.
        known: what the earlier stages learned.
        progress: called with what is going on and the share of it done.

    Raises:
        TrainingError: the data hold no successful recovery, or use unknown skills.
    """
    config = config or ConceptConfig.of(mode)
    start = time.perf_counter()
    before, new = known_model(given, known), stages[-1]
    real = {op.name: tuple(v.type for v in op.parameters) for op in before.operators}
    for s in stages:
        if s.failed_skill not in real:
            raise UnknownNameError("failed skill", s.failed_skill, list(real))
        real[s.recovery] = tuple(s.recovery_types)
    recoveries = [s.recovery for s in stages]
    view = merged_dataset if config.mode == "default" else variant_dataset
    dataset = view([s.trajectories for s in stages], recoveries, real)
    if config.mode == "default":
        dataset = without_unclear(dataset)
    parameters = _parameters(dataset.signatures, before.operators)
    truth, columns = _judged(before, dataset, parameters)
    tuned: list[dict[str, Any]] = []
    if before.records:
        progress("fine-tuning what is known", 0.0)
        before, tuned = tune_known(before, dataset, truth, columns, recoveries, seed, config.fit, config.tune)
        truth, columns = _judged(before, dataset, parameters)
    pool = _Pool(dataset, parameters)
    pool.add_known(sorted(before.predicates), truth)
    learned = {p for p in before.predicates if p.name in before.records}
    explained = explained_failures(dataset, [*columns, *(c.evidence for c in pool.concepts)], learned)
    # What an earlier recovery mended is not what the new one is about.
    explained |= {f for run in dataset.runs for f in run.failures if f.mended_by in recoveries[:-1]}

    proposals = _proposals(dataset, new, before.operators, config.mode)
    kept, log = _train(dataset, proposals, explained, config, seed, given.relations, progress)
    for candidate, fitted in kept:
        pool.add_learned(candidate, fitted)
    selector = Selector(
        dataset,
        truth,
        columns,
        parameters,
        {op.name: op for op in before.operators},
        config.select,
        config.operators,
        swept(dataset, truth, before.predicates, parameters) if config.mode == "default" else None,
    )
    selection = select(selector, pool.concepts, progress)
    progress("concepts learned", 1.0)
    report = {
        "mode": config.mode,
        "seed": seed,
        "tuned": tuned,
        "candidates": log,
        "pool": len(pool.concepts),
        "demonstrations": len(selector.demonstrations),
        "failed_attempts": len(selector.failures),
        "explained_failures": len(explained),
        "variants": _variants(dataset, real, recoveries),
        "seconds": round(time.perf_counter() - start, 2),
    }
    concepts = assemble(given, before, columns, selection, pool.concepts, len(stages), report)
    abstraction = Abstraction(concepts.predicates, concepts.classifiers)
    tried = (t for s in stages for t in s.trajectories)
    gone = experience(tried, abstraction, concepts.operators, given.predicates)
    return replace(concepts, report={**concepts.report, "experience": gone})


def _judged(
    model: Concepts, dataset: Dataset, parameters: Mapping[str, tuple[Variable, ...]]
) -> tuple[list[Atoms], list[Evidence]]:
    """For each moment the atoms of known predicates that hold, and the columns of each predicate in their order."""
    judge = Abstraction(model.predicates, model.classifiers)
    truth = [judge.true_atoms(dataset.state_at(m)) for m in range(len(dataset.moments))]
    # Learned is what has a record, in whichever stage that was, and not what is new in this one.
    return truth, [evidence(dataset, truth, p, parameters, p.name in model.records) for p in judge.predicates]


def _variants(dataset: Dataset, skills: Collection[str], recoveries: Sequence[str]) -> dict[str, str]:
    """The published formulation's skills that fail on purpose, and the skill that each of them is."""
    named = {variant_name(s, r): s for s in skills for r in recoveries}
    return {variant: skill for variant, skill in named.items() if variant in dataset.signatures}


def _proposals(dataset: Dataset, new: StageData, operators: Sequence[Operator], mode: Mode) -> list[Candidate]:
    """The candidates of a stage: effect vectors, and where failures count what the attempts of each skill label."""
    published = variant_name(new.failed_skill, new.recovery)
    around = (new.recovery, new.failed_skill if mode == "default" else published, _skill_after(dataset, new.recovery))
    proposals = candidates(new.recovery, [s for s in around if s in dataset.signatures], dataset.signatures)
    if mode == "default":
        # What the recovery does not bring about gives no reason to use it, and may forbid what is to be done again.
        proposals = [c for c in proposals if any(e.skill == new.recovery for e in c.effects)]
        attempted = {step.skill for run in dataset.runs for step in (*run.steps, *run.failures)}
        tried = [op.name for op in operators if op.name in attempted]
        proposals += affordances(new.recovery, tried, dataset.signatures)
    return proposals


def _skill_after(dataset: Dataset, recovery: str) -> str:
    """The skill that most often follows the recovery."""
    following = Counter(
        b.skill for run in dataset.runs for a, b in zip(run.steps, run.steps[1:], strict=False) if a.skill == recovery
    )
    if not following:
        raise TrainingError(
            f"no trajectory continues after a successful {recovery}", "dream 'before' states that trigger the recovery"
        )
    return min(following, key=lambda s: (-following[s], s))


def _train(
    dataset: Dataset,
    proposals: Sequence[Candidate],
    explained: Collection[Step],
    config: ConceptConfig,
    seed: int,
    relations: Relations,
    progress: Progress,
) -> tuple[list[tuple[Candidate, Fit]], list[dict[str, Any]]]:
    """Contradictions out, a small net for each that is left, the full one where the small one fits.

    Returns:
        What fits, the preferred ones first: of concepts that always agree only the first is pooled. And what became of
        each.
    """
    kept: list[tuple[Candidate, Fit]] = []
    log: list[dict[str, Any]] = []
    for i, candidate in enumerate(proposals):
        entry: dict[str, Any] = {"candidate": str(candidate), "name": candidate.name}
        log.append(entry)
        progress(f"training classifiers, {len(kept)} kept", i / len(proposals))
        supervision = supervise(dataset, candidate, explained)
        entry["conflicts"] = round(supervision.conflicts, 4)
        if supervision.contradicted:
            entry["verdict"] = "contradicted by the data, not trained"
            continue
        labelled = candidate.attempts is not None
        try:
            small = fit(dataset, candidate, supervision, seed + i, config.screening, relations)
        except TrainingError as error:
            entry["verdict"] = error.what
            continue
        entry["screening_loss"] = round(small.loss, 4)
        if small.loss > (config.max_screening_loss_attempts if labelled else config.max_screening_loss):
            entry["verdict"] = "does not fit (small net)"
            continue
        result = fit(dataset, candidate, supervision, seed + i, config.fit, relations)
        accuracy = result.accuracy
        if labelled and accuracy >= config.min_accuracy - SPLIT_LUCK:
            others = (seed + i + SPLIT_SEEDS * k for k in range(1, SPLITS))
            found = [result, *(fit(dataset, candidate, supervision, s, config.fit, relations) for s in others)]
            accuracy = float(np.mean([f.accuracy for f in found]))
            result = sorted(found, key=lambda f: f.accuracy)[SPLITS // 2]
        entry |= {"train_loss": round(result.train_loss, 4), "loss": round(result.loss, 4)}
        entry["accuracy"] = round(accuracy, 4)
        fits = accuracy >= config.min_accuracy if labelled else result.loss <= config.max_loss
        entry["verdict"] = "kept" if fits else "does not fit"
        if fits:
            kept.append((candidate, result))
    # A candidate that attempts label supersedes the one with the same effects whose boundary is left to luck.
    better = {(c.types, c.effects) for c, _ in kept if c.attempts is not None}
    kept = [(c, f) for c, f in kept if c.attempts is not None or (c.types, c.effects) not in better]
    return sorted(kept, key=lambda pair: (pair[0].attempts is None, len(pair[0].effects), pair[1].loss)), log


def _parameters(signatures: Mapping[str, Sequence[Type]], given: Sequence[Operator]) -> dict[str, tuple[Variable, ...]]:
    """Variables of each skill: those of the given operator where there is one."""
    known = {op.name: op.parameters for op in given}
    result = {}
    for skill, types in signatures.items():
        fresh = tuple(Variable(f"?{t.name}{'' if list(types).count(t) == 1 else i}", t) for i, t in enumerate(types))
        result[skill] = known.get(skill, fresh)
    return result


def forms_of(base: Predicate) -> list[Form]:
    """Derived forms to try: every quantification of the arguments, and the negation of each and of the base."""
    quantified = quantifications(base)
    return [*quantified, Not(base), *(Not(f.predicate) for f in quantified)]


class _Pool:
    """Concepts to select from: predicates and their forms; of those that always agree the first one only."""

    def __init__(self, dataset: Dataset, parameters: Mapping[str, tuple[Variable, ...]]) -> None:
        self.dataset, self.parameters = dataset, parameters
        self.concepts: list[Concept] = []
        self._robots = {variables[0].type for variables in parameters.values() if variables}
        self._seen: set[tuple[tuple[Type, ...], tuple[frozenset[tuple[Object, ...]], ...]]] = set()

    def add_known(self, predicates: Sequence[Predicate], truth: Sequence[Atoms]) -> None:
        """The forms of known predicates, which are in the model anyway."""
        tables: list[list[Table]] = []
        for predicate in predicates:
            table = [
                {args: float(predicate(*args) in held) for args in _groundings(predicate.types, self.dataset, m)}
                for m, held in enumerate(truth)
            ]
            # All of them first: a known predicate that is a form of another one is no new concept.
            self._seen.add((predicate.types, _held(table)))
            tables.append(table)
        for predicate, table in zip(predicates, tables, strict=True):
            self._add(predicate, table, None, None)

    def add_learned(self, candidate: Candidate, fitted: Fit) -> None:
        """A candidate with its classifier, and its forms."""
        table = probabilities(fitted.classifier, self.dataset)
        self._add(Predicate(candidate.name, candidate.types), table, candidate, fitted)

    def _add(self, base: Predicate, table: list[Table], candidate: Candidate | None, fitted: Fit | None) -> None:
        tables = {base.name: table}
        members: list[tuple[Predicate, Form | None]] = [(base, None), *((f.predicate, f) for f in forms_of(base))]
        for predicate, form in members:
            if form is not None:
                tables[predicate.name] = _derive(form, predicate, tables[form.base.name], self.dataset)
            held = _held(tables[predicate.name])
            if (predicate.types, held) in self._seen:
                continue
            self._seen.add((predicate.types, held))
            if form is None and candidate is None:
                continue
            truth: tuple[Atoms, ...] = tuple(frozenset(predicate(*args) for args in h) for h in held)
            columns = evidence(self.dataset, truth, predicate, self.parameters, learned=True)
            about = sum(t not in self._robots for t in predicate.types)
            self.concepts.append(Concept(predicate, form, base, candidate, fitted, truth, columns, about))


def _held(table: Sequence[Table]) -> tuple[frozenset[tuple[Object, ...]], ...]:
    """For each moment the groundings that hold."""
    return tuple(frozenset(args for args, p in at.items() if p > HOLDS) for at in table)


def probabilities(classifier: NeuralClassifier, dataset: Dataset) -> list[Table]:
    """For each moment the probability of every grounding, in one forward pass."""
    keys = [(m, args) for m in range(len(dataset.moments)) for args in _groundings(classifier.types, dataset, m)]
    rows = gather([dataset.state_at(m) for m, _ in keys], [args for _, args in keys])
    tables: list[Table] = [{} for _ in dataset.moments]
    for (m, args), p in zip(keys, classifier.probabilities(rows), strict=True):
        tables[m][args] = float(p)
    return tables


def _derive(form: Form, predicate: Predicate, base: Sequence[Table], dataset: Dataset) -> list[Table]:
    result = []
    for m, table in enumerate(base):
        groups: dict[tuple[Object, ...], list[float]] = {a: [] for a in _groundings(predicate.types, dataset, m)}
        for args, p in table.items():
            groups[form.keeps(args)].append(p)
        result.append({args: form.combine(values) for args, values in groups.items()})
    return result


def _groundings(types: Sequence[Type], dataset: Dataset, moment: int) -> list[tuple[Object, ...]]:
    objects = dataset.state_at(moment).objects
    return distinct_products([[o for o in objects if o.type == t] for t in types])
