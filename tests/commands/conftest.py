from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from resync_robot import cli
from resync_robot.core.library import save_library
from tests.commands.pretended_episodes import pretended
from tests.libraries import given_library


@pytest.fixture
def library(tmp_path: Path) -> Path:
    save_library(given_library(), tmp_path / "library")
    return tmp_path / "library"


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, library: Path) -> Callable[..., int]:
    """`evaluate` with a library and episodes that cost nothing."""
    monkeypatch.setattr("resync_robot.sim_training.parallel.parallel_map", pretended)
    return lambda *args: cli.main(["evaluate", "--library", str(library), *map(str, args)])
