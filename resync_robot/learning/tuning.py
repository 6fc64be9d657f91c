"""Fine-tuning: what earlier stages learned goes on learning from the dreams of a new one, before discovery.

A saved classifier has no batch normalisation any more, so its folded layers are trained on, at a third of the rate, on
old labels and new ones in equal shares. It is kept only where it fits neither of the two worse than chance explains:
what a stage adds must not cost what the stages before it can do.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import nn

from resync_robot.core.symbols import Atoms
from resync_robot.learning.classifiers import NeuralClassifier
from resync_robot.learning.dataset import Dataset
from resync_robot.learning.effect_vectors import candidate_from_json, candidate_to_json, measured_effects
from resync_robot.learning.effects import Candidate, Supervision, supervise
from resync_robot.learning.fit import (
    VALIDATION_SHARE,
    FitConfig,
    difference,
    examples_of,
    folded,
    loss_of,
    noisy_inputs,
    steps_in_epoch,
    train_epoch,
)
from resync_robot.learning.model import Concepts, is_neural
from resync_robot.learning.operators import Evidence, explained_failures


@dataclass(frozen=True, kw_only=True)
class TuneConfig:
    """How a known classifier is trained on."""

    rate: float = 0.3
    """Share of the learning rate with which it was trained."""
    epochs: int = 10
    """0: it stays as it was."""


@dataclass(frozen=True)
class Tuned:
    """A classifier after fine-tuning, or as it was where that helped nothing.

    Attributes:
        before, after: (on old, on new) held-out trajectories, its loss.
    """

    classifier: NeuralClassifier
    before: tuple[float, float]
    after: tuple[float, float]

    @property
    def kept(self) -> bool:
        return self.before != self.after


def tune_known(
    known: Concepts,
    dataset: Dataset,
    truth: Sequence[Atoms],
    columns: Sequence[Evidence],
    recoveries: Sequence[str],
    seed: int,
    fit_config: FitConfig,
    config: TuneConfig,
) -> tuple[Concepts, list[dict[str, Any]]]:
    """The known model with its classifiers fine-tuned and their effect vectors extended to the new recovery.

    Args:
        dataset: of all stages.
        truth: for each moment the atoms that hold by the known classifiers.
        columns: of each known predicate, in their order.
        recoveries: of all stages, the new one last.

    Returns:
        The model, and what became of each classifier.
    """
    fresh = replace(dataset, runs=tuple(run for run in dataset.runs if run.stage == len(recoveries)))
    # Of a failure in the new dreams the cause may be the new one, unless an earlier recovery mended it.
    unsure = {f for run in fresh.runs for f in run.failures if f.mended_by not in recoveries[:-1]}
    predicates = sorted(known.predicates)
    settled = [c for p, c in zip(predicates, columns, strict=True) if not is_neural(p, known.classifiers)]
    unsure |= explained_failures(dataset, settled)
    classifiers, records, log = dict(known.classifiers), dict(known.records), list[dict[str, Any]]()
    for i, predicate in enumerate(predicates):
        classifier = known.classifiers[predicate.name]
        if predicate.name not in records or not isinstance(classifier, NeuralClassifier):
            continue
        meta = records[predicate.name].meta
        candidate = candidate_from_json(meta, predicate.types, dataset.signatures)
        found = measured_effects(fresh, truth, predicate, recoveries[-1])
        wider = replace(candidate, effects=(*candidate.effects, *found))
        supervision = supervise(dataset, wider, unsure)
        entry: dict[str, Any] = {"predicate": predicate.name, "effects": str(wider)}
        log.append(entry)
        if supervision.contradicted:
            entry["verdict"] = "contradicted by the data, not trained"
            continue
        tuned = tune(dataset, wider, supervision, classifier, seed + i, fit_config, config)
        entry["verdict"] = "as it was" if tuned is None or not tuned.kept else "tuned"
        if tuned is not None:
            entry |= {"loss_before": _rounded(tuned.before), "loss": _rounded(tuned.after)}
            classifier = classifiers[predicate.name] = tuned.classifier
        marks = {"tuned": len(recoveries)} if tuned is not None and tuned.kept else {}
        records[predicate.name] = classifier.to_record({**meta, **candidate_to_json(wider), **marks})
    return replace(known, classifiers=classifiers, records=records), log


def _rounded(losses: tuple[float, float]) -> list[float]:
    return [round(x, 4) for x in losses]


def tune(
    dataset: Dataset,
    candidate: Candidate,
    supervision: Supervision,
    start: NeuralClassifier,
    seed: int,
    fit_config: FitConfig,
    config: TuneConfig,
) -> Tuned | None:
    """Train a classifier on, and take the epoch that fits old and new data best among those that fit neither worse than
    chance explains: by more than a standard error of the difference, on the same held-out labels. What holds and what
    does not counts alike: failures are few, and one that calls everything ready loses little on the whole.

    The new data are those of the last stage.

    Returns:
        None where the old or the new runs are too few to train on some and judge by others.
    """
    rows, examples = examples_of(dataset, candidate, supervision, fit_config)
    rng = np.random.default_rng(seed)
    held_out = rng.random(len(dataset.runs)) < VALIDATION_SHARE
    numbers = np.array([run.stage for run in dataset.runs])
    new = numbers == numbers.max()
    sides = (~new, new)
    labels = [np.flatnonzero((side & ~held_out)[examples.label_run]) for side in sides]
    pairs = [np.flatnonzero((side & ~held_out)[examples.pair_run]) for side in sides]
    judged = [((side & held_out)[examples.label_run], (side & held_out)[examples.pair_run]) for side in sides]
    if not all(map(len, labels)) or not all(of.any() for of, _ in judged):
        return None

    def inputs() -> torch.Tensor:
        return noisy_inputs(candidate.types, rows, start.mean, start.scale, rng, fit_config, start.relations)

    held = examples.values > 0.5
    share = held[labels[0]].mean()

    def of_value(value: bool, most: int) -> np.ndarray:
        """So many labels of a value, as many of the old as of the new, as far as there are."""
        fresh = rng.permutation(labels[1][held[labels[1]] == value])[: most // 2]
        return np.concatenate([fresh, rng.permutation(labels[0][held[labels[0]] == value])[: most - len(fresh)]])

    def some_labels() -> np.ndarray:
        # Values in the shares that they had: in new dreams nearly everything is ready, and to learn that says nothing.
        most = min(2 * min(map(len, labels)), fit_config.labels_per_epoch)
        return rng.permutation(
            np.concatenate([of_value(True, round(share * most)), of_value(False, most - round(share * most))])
        )

    def some_pairs() -> np.ndarray:
        each = min(*map(len, pairs), fit_config.pairs_per_epoch // 2)
        return rng.permutation(np.concatenate([rng.permutation(pool)[:each] for pool in pairs]))

    check, net = inputs(), _unfolded(start)

    def seen() -> torch.Tensor:
        net.eval()
        with torch.no_grad():
            logits: torch.Tensor = net(check)[:, 0]
        return logits

    def losses(logits: torch.Tensor) -> tuple[float, float]:
        old, fresh = (float(loss_of(logits, examples, of, among)) for of, among in judged)
        return old, fresh

    def worse(logits: torch.Tensor) -> list[tuple[float, float]]:
        """For old and new by how much more it loses, both values counted alike, and how much of that is chance."""
        found = []
        for of, _ in judged:
            each = [difference(at_first, logits, examples, of & (held == v)) for v in set(held[of].tolist())]
            found.append(
                (sum(m for m, _ in each) / len(each), float(np.hypot.reduce([c for _, c in each])) / len(each))
            )
        return found

    steps = steps_in_epoch(2 * min(map(len, labels)), fit_config)
    rate = config.rate * fit_config.learning_rate
    optimiser = torch.optim.AdamW(net.parameters(), lr=rate, weight_decay=fit_config.weight_decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, max(1, config.epochs * steps))
    at_first = seen()
    before = after = losses(at_first)
    least = 0.0
    best = copy.deepcopy(net)
    for _ in range(config.epochs):
        train_epoch(net, optimiser, schedule, inputs(), examples, some_labels(), some_pairs(), steps)
        logits = seen()
        more = worse(logits)
        if (total := sum(m for m, _ in more)) < least and all(m <= chance for m, chance in more):
            best, after, least = copy.deepcopy(net), losses(logits), total
    classifier = start if after == before else replace(start, layers=folded(best))
    return Tuned(classifier, before, after)


def _unfolded(classifier: NeuralClassifier) -> nn.Sequential:
    """The classifier as a network that can be trained on; its normalisation by batches stays folded in."""
    layers: list[nn.Module] = []
    for weight, bias in classifier.layers:
        linear = nn.Linear(weight.shape[1], weight.shape[0])
        with torch.no_grad():
            linear.weight.copy_(torch.from_numpy(weight))
            linear.bias.copy_(torch.from_numpy(bias))
        layers += [linear, nn.GELU(approximate="tanh")]
    return nn.Sequential(*layers[:-1])
