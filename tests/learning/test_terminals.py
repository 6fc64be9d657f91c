"""A terminal function learns what can be told apart, refuses what cannot be learned, and is saved whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from resync_robot.core.errors import LibraryError, TrainingError
from resync_robot.learning.terminals import Terminal, train_terminal


def toy(count: int = 600) -> tuple[torch.Tensor, torch.Tensor]:
    """Points in a plane, over where the first coordinate is large; scales and offsets far from one."""
    generator = torch.Generator().manual_seed(0)
    x = torch.rand(count, 2, generator=generator)
    return x * torch.tensor([0.01, 100.0]) + torch.tensor([5.0, -300.0]), (x[:, 0] > 0.7).long()


@pytest.fixture(scope="module")
def learned() -> tuple[Terminal, float]:
    return train_terminal(*toy(), seed=0, epochs=12, batch=128)


def test_it_learns_what_can_be_told_apart(learned: tuple[Terminal, float]) -> None:
    terminal, accuracy = learned
    features, labels = toy(1000)
    right = (terminal.probability(features) > 0.5) == (labels == 1)
    assert accuracy > 0.95
    assert right.float().mean() > 0.95


def test_the_same_seed_gives_the_same_function(learned: tuple[Terminal, float]) -> None:
    again, accuracy = train_terminal(*toy(), seed=0, epochs=12, batch=128)
    assert accuracy == learned[1]
    assert torch.equal(again.probability(toy()[0]), learned[0].probability(toy()[0]))


def test_a_record_brings_it_back(learned: tuple[Terminal, float]) -> None:
    terminal, _ = learned
    back = Terminal.from_record(terminal.to_record())
    assert torch.equal(back.probability(toy()[0]), terminal.probability(toy()[0]))


@pytest.mark.parametrize("name", ["mean", "scale", "net.0.weight", "net.1.running_var", "net.12.bias"])
def test_a_record_that_is_not_whole_is_refused(learned: tuple[Terminal, float], name: str) -> None:
    record = learned[0].to_record()
    assert name in record.tensors
    with pytest.raises(LibraryError, match=name):
        Terminal.from_record(replace(record, tensors={k: v for k, v in record.tensors.items() if k != name}))
    with pytest.raises(LibraryError, match=name):
        Terminal.from_record(replace(record, tensors={**record.tensors, name: np.zeros((2, 5), np.float32)}))


def test_a_record_without_its_size_is_refused(learned: tuple[Terminal, float]) -> None:
    with pytest.raises(LibraryError):
        Terminal.from_record(replace(learned[0].to_record(), meta={}))


@pytest.mark.parametrize("value", [0, 1])
def test_one_class_alone_teaches_nothing(value: int) -> None:
    features, _ = toy(100)
    labels = torch.full((100,), value)
    labels[:9] = 1 - value
    with pytest.raises(TrainingError, match=f"class {1 - value}"):
        train_terminal(features, labels, seed=0)
