"""What is learned from the toy's first failure, once for all tests that begin there."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from resync_robot.learning.dataset import StageData
    from resync_robot.learning.model import Concepts


@contextmanager
def one_thread() -> Iterator[None]:
    """Nets this small gain nothing from a second thread, and sums come out the same everywhere."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def first_data() -> StageData:
    """A hundred dreams and some attempts around a cornered block."""
    from tests.learning.toy import Toy, first_stage

    toy = Toy(0)
    return first_stage(toy.dreams(100) + toy.attempts(140))


@pytest.fixture(scope="session")
def concepts(first_data: StageData) -> Concepts:
    """Small nets on a hundred dreams: seconds, and still the right model."""
    from resync_robot.learning.concepts import learn_concepts
    from tests.learning.episodes import SMALL
    from tests.learning.toy import DOMAIN

    with one_thread():
        return learn_concepts([first_data], DOMAIN, config=SMALL)
