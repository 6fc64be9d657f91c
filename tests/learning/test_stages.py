"""A second failure learned on top of a first one: what was known stays, and a library holds all of it."""

from __future__ import annotations

import pytest

from resync_robot.learning.concepts import learn_concepts
from resync_robot.learning.dataset import StageData
from resync_robot.learning.model import Concepts
from tests.learning.conftest import one_thread
from tests.learning.episodes import SMALL
from tests.learning.toy_can import DOMAIN_WITH_CAN, PUSH, ToyWithCan


@pytest.fixture(scope="module")
def second_data() -> StageData:
    toy = ToyWithCan(0)
    return StageData("Push", PUSH, "Pick", toy.dreams(100) + toy.attempts(140))


@pytest.fixture(scope="module")
def both(first_data: StageData, second_data: StageData, concepts: Concepts) -> Concepts:
    with one_thread():
        return learn_concepts([first_data, second_data], DOMAIN_WITH_CAN, concepts, config=SMALL)
