"""What `import resync_robot` offers: a few names, each from its module, and nothing that takes time to load."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module

import pytest

import resync_robot


@pytest.mark.parametrize("name", resync_robot.__all__)
def test_each_name_is_that_of_the_module_which_defines_it(name: str) -> None:
    found = getattr(resync_robot, name)
    assert found is getattr(import_module(found.__module__), name)
    assert name in dir(resync_robot)
    assert f"`{name}`" in (resync_robot.__doc__ or "")


def test_a_star_import_brings_all_of_them() -> None:
    brought: dict[str, object] = {}
    exec("from resync_robot import *", brought)
    assert set(resync_robot.__all__) <= set(brought)


def test_another_name_is_the_usual_error() -> None:
    with pytest.raises(AttributeError, match="'resync_robot' has no attribute 'Robot'"):
        _ = resync_robot.Robot
    with pytest.raises(ImportError, match="Robot"):
        exec("from resync_robot import Robot")


def test_importing_it_loads_none_of_its_rooms() -> None:
    code = "import sys, resync_robot; print(sorted(m for m in sys.modules if m.startswith(('resync_robot', 'numpy'))))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert loaded.stdout.strip() == "['resync_robot']"
