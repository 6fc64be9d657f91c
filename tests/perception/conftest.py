"""The rig, the catalogue and the empty belief that tests here use."""

from __future__ import annotations

import pytest

from resync_robot.core.rig import Rig, load_rig
from resync_robot.perception.belief import Belief
from resync_robot.perception.catalogue import Catalogue
from tests.perception.estimates import B0, B1, THE_BOX, R


@pytest.fixture(scope="session")
def rig() -> Rig:
    return load_rig()


@pytest.fixture(scope="session")
def catalogue() -> Catalogue:
    return Catalogue()


@pytest.fixture
def belief(rig: Rig) -> Belief:
    return Belief(R, THE_BOX, (B0, B1), rig)
