"""The rig and the catalogue that every test here uses."""

from __future__ import annotations

import pytest

from perception.catalogue import Catalogue
from resync_robot.core.rig import Rig, load_rig


@pytest.fixture(scope="session")
def rig() -> Rig:
    return load_rig()


@pytest.fixture(scope="session")
def catalogue() -> Catalogue:
    return Catalogue()
