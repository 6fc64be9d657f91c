"""Training of predicate classifiers.

Loss = binary cross-entropy where a value is forced + Jensen-Shannon divergence, over both classes, between the values
before and after a step that leaves the atom alone. Poses get the error of perception anew in every epoch, so that
what is learned survives the camera.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from resync_robot.core.errors import TrainingError
from resync_robot.core.relations import DEFAULTS, Relations
from resync_robot.core.symbols import Object, Type
from resync_robot.learning.classifiers import NeuralClassifier
from resync_robot.learning.dataset import Dataset
from resync_robot.learning.effects import Candidate, Supervision
from resync_robot.learning.features import Rows, gather, perturb, relative_features

VALIDATION_SHARE = 0.2


@dataclass(frozen=True, kw_only=True)
class FitConfig:
    """How a classifier is trained.

    Attributes:
        widths: hidden layers.
        min_steps_per_epoch: small data sets are cut into at least so many batches.
        pairs_per_epoch: invariances seen in one epoch, drawn anew each time; most say the same thing.
        propagated_weight: of a label that holds by propagation, against one that was observed.
        caution: how much more a failed attempt weighs than a successful one. To recover in vain costs a moment, to
            fail with a block in the hand costs the task.
        position_m, angle: pose noise, standard deviations.
    """

    widths: tuple[int, ...] = (128, 256, 256, 128)
    epochs: int = 30
    batch: int = 512
    min_steps_per_epoch: int = 12
    learning_rate: float = 1e-3
    weight_decay: float = 1e-2
    pairs_per_epoch: int = 1024
    labels_per_epoch: int = 4096
    propagated_weight: float = 0.3
    caution: float = 2.0
    position_m: float = 0.002
    angle: float = float(np.deg2rad(0.5))


PAPER = FitConfig()
"""The network of the paper."""

COMPACT = FitConfig(widths=(32, 32), learning_rate=3e-3)
"""For the few hundred labels that attempts give. The paper's network remembers them, and takes 3 % of unseen corners
for room enough; this one 0.05 % (720 worlds, three seeds)."""

SCREENING = FitConfig(
    widths=(64, 64), epochs=12, min_steps_per_epoch=8, learning_rate=3e-3, pairs_per_epoch=512, labels_per_epoch=1024
)
"""Small and quick: only sorts out candidates that nothing could fit."""


@dataclass(frozen=True)
class Fit:
    """A trained classifier and how well it fits.

    Attributes:
        train_loss, loss: on training and held-out trajectories (split by trajectory), with pose noise.
        accuracy: balanced over the two values, on held-out observed labels.
    """

    classifier: NeuralClassifier
    train_loss: float
    loss: float
    accuracy: float


@dataclass(frozen=True)
class Examples:
    """Labels and invariances as index arrays into the rows.

    `groups` is (m, k): the label is about the least likely atom of each group.
    """

    groups: np.ndarray
    values: np.ndarray
    weights: np.ndarray
    direct: np.ndarray
    label_run: np.ndarray
    pairs: np.ndarray
    pair_run: np.ndarray


def fit(
    dataset: Dataset,
    candidate: Candidate,
    supervision: Supervision,
    seed: int,
    config: FitConfig = PAPER,
    relations: Relations = DEFAULTS,
) -> Fit:
    """Train one classifier; the same seed gives the same weights on one machine.

    Raises:
        TrainingError: the data force no value, or only one, so there is nothing to tell apart.
    """
    rows, examples = examples_of(dataset, candidate, supervision, config)
    if len(set(examples.values.tolist())) < 2:
        raise TrainingError(f"nothing tells true from false for the candidate {candidate}")
    rng = np.random.default_rng(seed)
    held_out = _held_out(examples, len(dataset.runs), rng)
    clean = relative_features(candidate.types, rows, relations)
    mean, scale = clean.mean(0), clean.std(0)
    # What hardly varies is left at its size: dividing by a spread near zero would blow up its noise.
    scale = np.where(scale < 1e-4, 1.0, scale)
    inputs = partial(noisy_inputs, candidate.types, rows, mean, scale, rng, config, relations)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        net = _network(clean.shape[1], config.widths)
        best, best_loss = _train(net, examples, held_out, inputs, rng, config)
        net.load_state_dict(best)
    net.eval()
    x = inputs()
    with torch.no_grad():
        logits = net(x)[:, 0]
        train = float(loss_of(logits, examples, ~held_out[examples.label_run], ~held_out[examples.pair_run]))
    accuracy = _balanced_accuracy(logits.numpy(), examples, held_out[examples.label_run] & examples.direct)
    layers = folded(net)
    normaliser = mean.astype(np.float32), scale.astype(np.float32)
    classifier = NeuralClassifier(candidate.types, *normaliser, layers, relations)
    return Fit(classifier, train, best_loss, accuracy)


def _train(
    net: nn.Sequential,
    examples: Examples,
    held_out: np.ndarray,
    inputs: Callable[[], Tensor],
    rng: np.random.Generator,
    config: FitConfig,
) -> tuple[dict[str, Any], float]:
    """The best weights by validation loss, and that loss."""
    optimiser = torch.optim.AdamW(net.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay)
    label_pool = np.flatnonzero(~held_out[examples.label_run])
    pair_pool = np.flatnonzero(~held_out[examples.pair_run])
    steps = steps_in_epoch(len(label_pool), config)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, config.learning_rate, config.epochs * steps)
    best, best_loss = copy.deepcopy(net.state_dict()), float("inf")
    check = inputs()
    val_labels, val_pairs = held_out[examples.label_run], held_out[examples.pair_run]
    judged = np.union1d(examples.groups[val_labels], examples.pairs[val_pairs])
    logits_of_all = torch.zeros(len(check))
    for _ in range(config.epochs):
        x = inputs()
        labels = rng.permutation(label_pool)[: config.labels_per_epoch]
        pairs = rng.permutation(pair_pool)[: config.pairs_per_epoch]
        train_epoch(net, optimiser, schedule, x, examples, labels, pairs, steps)
        net.eval()
        with torch.no_grad():
            logits_of_all[judged] = net(check[judged])[:, 0]
            now = float(loss_of(logits_of_all, examples, val_labels, val_pairs))
        if now < best_loss:
            # A deep copy: a plain dict of the state would alias the weights that go on training.
            best, best_loss = copy.deepcopy(net.state_dict()), now
    return best, best_loss


def steps_in_epoch(labels: int, config: FitConfig) -> int:
    """Into how many batches so many labels are cut."""
    steps = max(config.min_steps_per_epoch, -(-min(labels, config.labels_per_epoch) // config.batch))
    return max(1, min(steps, labels // 8))


def train_epoch(
    net: nn.Module,
    optimiser: torch.optim.Optimizer,
    schedule: torch.optim.lr_scheduler.LRScheduler,
    x: Tensor,
    examples: Examples,
    labels: np.ndarray,
    pairs: np.ndarray,
    steps: int,
) -> None:
    """So many steps of gradient descent over these labels and pairs, by index."""
    net.train()
    for some_labels, some_pairs in zip(np.array_split(labels, steps), np.array_split(pairs, steps), strict=True):
        groups = examples.groups[some_labels]
        index = np.concatenate([groups.reshape(-1), examples.pairs[some_pairs].reshape(-1)])
        logits = net(x[index])[:, 0]
        told = logits[: groups.size].reshape(groups.shape).amin(1)
        loss = _cross_entropy(told, examples, some_labels) + _divergence(logits[groups.size :].reshape(-1, 2))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()


def noisy_inputs(
    types: Sequence[Type],
    rows: Sequence[Rows],
    mean: np.ndarray,
    scale: np.ndarray,
    rng: np.random.Generator,
    config: FitConfig,
    relations: Relations,
) -> Tensor:
    """(n, d) normalised features of the rows with a new pose error."""
    noisy = [perturb(kind, r, rng, config.position_m, config.angle) for kind, r in zip(types, rows, strict=True)]
    return torch.from_numpy(((relative_features(types, noisy, relations) - mean) / scale).astype(np.float32))


def examples_of(
    dataset: Dataset, candidate: Candidate, supervision: Supervision, config: FitConfig
) -> tuple[tuple[Rows, ...], Examples]:
    """Features of the arguments, one array each, and what is said of these rows.

    A row is a state with arguments; a moment seen in several states gives each of them the label.
    """
    keys: dict[tuple[int, tuple[Object, ...]], int] = {}

    def row(state: int, args: tuple[Object, ...]) -> int:
        return keys.setdefault((state, args), len(keys))

    most = max((len(label.atoms) for label in supervision.labels), default=1)
    groups, values, weights, direct, label_run = [], [], [], [], []
    for label in supervision.labels:
        for state in dataset.moments[label.moment]:
            members = [row(state, a) for a in label.atoms]
            groups.append(members + members[:1] * (most - len(members)))
            values.append(label.value)
            weights.append(1.0 if label.direct else config.propagated_weight)
            direct.append(label.direct)
            label_run.append(label.run)
    pairs, pair_run = [], []
    for same in supervision.invariances:
        pairs.append([row(dataset.moments[m][0], same.args) for m in (same.before, same.after)])
        pair_run.append(same.run)
    weight = np.array(weights, dtype=np.float32)
    value = np.array(values, dtype=np.float32)
    if candidate.attempts is not None:
        # As often as they happened: at the boundary that is what decides. To weigh both values alike in total would
        # move it well into what works, since failures are few.
        weight[value == 0.0] *= config.caution
    else:
        for v in (0.0, 1.0):
            if (total := weight[value == v].sum()) > 0:
                weight[value == v] *= len(weight) / 2 / total
    rows = gather([dataset.states[s] for s, _ in keys], [args for _, args in keys])
    return rows, Examples(
        np.array(groups, dtype=np.int64).reshape(-1, most),
        value,
        weight,
        np.array(direct, dtype=bool),
        np.array(label_run, dtype=np.int64),
        np.array(pairs, dtype=np.int64).reshape(-1, 2),
        np.array(pair_run, dtype=np.int64),
    )


def _held_out(examples: Examples, runs: int, rng: np.random.Generator) -> np.ndarray:
    """(runs,) mask of validation trajectories, shuffled; both sides keep labels of both values."""
    for _ in range(50):
        mask = np.zeros(runs, dtype=bool)
        mask[rng.permutation(runs)[: max(1, int(runs * VALIDATION_SHARE))]] = True
        sides = [examples.values[mask[examples.label_run]], examples.values[~mask[examples.label_run]]]
        if all(len(set(s.tolist())) == 2 for s in sides):
            return mask
    raise TrainingError("too few trajectories to hold some out for validation", "dream more trajectories")


def _network(inputs: int, widths: Sequence[int]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for a, b in zip([inputs, *widths], widths, strict=False):
        layers += [nn.Linear(a, b), nn.BatchNorm1d(b), nn.GELU(approximate="tanh")]
    return nn.Sequential(*layers, nn.Linear(widths[-1], 1))


def folded(net: nn.Sequential) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Linear layers with the batch normalisation after them folded in."""
    result: list[tuple[np.ndarray, np.ndarray]] = []
    for module in net:
        if isinstance(module, nn.Linear):
            result.append((module.weight.detach().numpy().copy(), module.bias.detach().numpy().copy()))
        elif isinstance(module, nn.BatchNorm1d):
            weight, bias = result.pop()
            gain = (module.weight / torch.sqrt(module.running_var + module.eps)).detach().numpy()
            shift = (module.bias - module.running_mean * torch.from_numpy(gain)).detach().numpy()
            result.append((weight * gain[:, None], bias * gain + shift))
    return tuple(result)


def _cross_entropy(logits: Tensor, examples: Examples, which: np.ndarray) -> Tensor:
    weights = torch.from_numpy(examples.weights[which])
    return (_surprise(logits, examples, which) * weights).sum() / weights.sum().clamp(min=1e-6)


def _surprise(logits: Tensor, examples: Examples, which: np.ndarray) -> Tensor:
    """(n,) cross-entropy of each label."""
    values = torch.from_numpy(examples.values[which])
    return functional.binary_cross_entropy_with_logits(logits, values, reduction="none")


def difference(before: Tensor, after: Tensor, examples: Examples, labels: np.ndarray) -> tuple[float, float]:
    """How much more the second of two classifiers loses over these labels, and the standard error of that.

    Args:
        before, after: (n,) logits of all rows.
        labels: (m,) mask of the labels.
    """
    which = np.flatnonzero(labels)
    if not len(which):
        return 0.0, 0.0
    some = [_surprise(logits[examples.groups[which]].amin(1), examples, which).numpy() for logits in (before, after)]
    weights, more = examples.weights[which], some[1] - some[0]
    mean = float(np.average(more, weights=weights))
    return mean, float(np.sqrt(((weights * (more - mean)) ** 2).sum()) / weights.sum())


def _divergence(pairs: Tensor) -> Tensor:
    """Mean Jensen-Shannon divergence between the two Bernoulli distributions of each pair of logits (n, 2)."""
    if not len(pairs):
        return pairs.sum()
    p = torch.sigmoid(pairs).clamp(1e-6, 1 - 1e-6)
    middle = p.mean(1, keepdim=True)
    kl = p * (p / middle).log() + (1 - p) * ((1 - p) / (1 - middle)).log()
    return kl.mean()


def loss_of(logits: Tensor, examples: Examples, labels: np.ndarray, pairs: np.ndarray) -> Tensor:
    which = np.flatnonzero(labels)
    told = logits[examples.groups[which]].amin(1)
    return _cross_entropy(told, examples, which) + _divergence(logits[examples.pairs[pairs]])


def _balanced_accuracy(logits: np.ndarray, examples: Examples, which: np.ndarray) -> float:
    said = logits[examples.groups[which]].min(1) > 0
    truth = examples.values[which] > 0.5
    shares = [float((said[truth == v] == v).mean()) for v in (False, True) if (truth == v).any()]
    return float(np.mean(shares)) if shares else 0.0
