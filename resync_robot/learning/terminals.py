"""Terminal functions beta: when a recovery is done, and when a skill has failed (section 3.1, appendix).

Both are classifiers over the canonical view of the projected state, trained with binary cross-entropy.
"""

from __future__ import annotations

import copy

import numpy as np
import torch
from torch import Tensor, nn

from resync_robot.core.errors import LibraryError, TrainingError
from resync_robot.core.library import RETRAIN, Record
from resync_robot.learning.success_model import corrected_loss


class Terminal(nn.Module):
    """MLP 128-256-256-128 with GELU and batch norm, as in the paper, its input normaliser inside."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("scale", torch.ones(inputs))
        layers: list[nn.Module] = []
        for width in (128, 256, 256, 128):
            layers += [nn.Linear(inputs, width), nn.BatchNorm1d(width), nn.GELU()]
            inputs = width
        self.net = nn.Sequential(*layers, nn.Linear(inputs, 1))

    def forward(self, features: Tensor) -> Tensor:
        return self.net(((features - self.mean) / self.scale).clamp(-10, 10)).squeeze(-1)

    @torch.no_grad()
    def probability(self, features: Tensor) -> Tensor:
        """(n,) probability that the skill is over, for (n, d) features."""
        return torch.sigmoid(self(features))

    def _saved(self) -> list[str]:
        # The batch counter of batch norm takes no part in a prediction.
        return [k for k in self.state_dict() if not k.endswith("num_batches_tracked")]

    def to_record(self) -> Record:
        tensors = {k: self.state_dict()[k].detach().numpy().copy() for k in self._saved()}
        return Record({"inputs": len(self.mean)}, tensors)

    @staticmethod
    def from_record(record: Record) -> Terminal:
        """Raises LibraryError where weights or the normaliser are missing or misshaped."""
        try:
            terminal = Terminal(int(record.meta["inputs"]))
        except (KeyError, TypeError, ValueError):
            raise LibraryError(
                f"a terminal function's record has no number of inputs: {record.meta}", RETRAIN
            ) from None
        for name in terminal._saved():
            value = terminal.state_dict()[name]
            if name not in record.tensors or tuple(record.tensors[name].shape) != tuple(value.shape):
                raise LibraryError(f"a terminal function's record has no fitting '{name}'", RETRAIN)
        terminal.load_state_dict({k: torch.from_numpy(np.array(v)) for k, v in record.tensors.items()}, strict=False)
        return terminal.eval()


def train_terminal(
    features: Tensor, labels: Tensor, seed: int, epochs: int = 30, batch: int = 512, reliability: float = 1.0
) -> tuple[Terminal, float]:
    """A terminal function and its balanced accuracy on the fifth of the data that was held out.

    Args:
        features: (n, d) canonical views.
        labels: (n,) 1 where the skill is over.
        reliability: the share of states with the label 1 among those where the skill really is over.

    Raises:
        TrainingError: one of the two classes has fewer than ten samples.
    """
    for value in (0, 1):
        if int((labels == value).sum()) < 10:
            raise TrainingError(f"a terminal function needs ten samples of class {value}", "train for longer")
    generator = torch.Generator().manual_seed(seed)
    torch.manual_seed(seed)
    order = torch.randperm(len(labels), generator=generator)
    held_out, train = order[: len(order) // 5], order[len(order) // 5 :]
    net = Terminal(features.shape[1])
    net.mean.copy_(features[train].mean(0))
    net.scale.copy_(features[train].std(0).clamp(min=1e-3))
    weight = ((labels[train] == 0).sum() / (labels[train] == 1).sum().clamp(min=1)).clamp(0.1, 10.0)
    most = float(weight * reliability / (weight * reliability + 1 - reliability))
    optimiser = torch.optim.AdamW(net.parameters(), lr=1e-3)
    best, best_accuracy = copy.deepcopy(net.state_dict()), -1.0
    for _ in range(epochs):
        net.train()
        for part in train[torch.randperm(len(train), generator=generator)].split(batch):
            if len(part) < 2:
                continue
            optimiser.zero_grad()
            target = labels[part].float()
            corrected_loss(net(features[part]), target, most, torch.where(target > 0.5, weight, 1.0)).backward()  # type: ignore[no-untyped-call]
            optimiser.step()
        net.eval()
        accuracy = _balanced_accuracy(net.probability(features[held_out]) > 0.5, labels[held_out] > 0.5)
        if accuracy > best_accuracy:
            best, best_accuracy = copy.deepcopy(net.state_dict()), accuracy
    net.load_state_dict(best)
    return net.eval(), best_accuracy


def _balanced_accuracy(predicted: Tensor, truth: Tensor) -> float:
    rates = [(predicted[truth == c] == c).float().mean() for c in (False, True) if (truth == c).any()]
    return float(torch.stack(rates).mean())
