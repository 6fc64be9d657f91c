"""The learner knows no domain: none of its code names a type, skill, predicate or scenario of one."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from resync_robot.core.task import Domain
from resync_robot.sim_training.domains import DOMAINS, find_domain

ROOT = Path(__file__).parents[1]
LEARNER = ("resync_robot/learning", "resync_robot/planning", "resync_robot/curriculum")
STEPS = (
    "ppo",
    "claims",
    "failure_mining",
    "recovery_env",
    "recovery_episodes",
    "recovery_problem",
    "recovery_elsewhere",
    "learn_recovery",
    "shared_env",
    "dreaming",
)
OF_THE_ARM = {
    # How the arm's recovery sees and acts, by the simulator's state and by camera.
    "resync_robot/learning/recovery_policy.py",
    "resync_robot/learning/camera_view.py",
    "resync_robot/learning/demonstrations.py",
    # What it learns by camera.
    "resync_robot/curriculum/distil.py",
    "resync_robot/curriculum/model_card.py",
}
"""Files that know the arm and its blocks."""
ANY_ROBOT = {"robot", "ROBOT", "item"}
"""Every domain has a robot; and of a type called item that word is not the only meaning."""


def _domains() -> list[Domain]:
    return [*DOMAINS.values(), find_domain(str(ROOT / "docs" / "puck_behind_a_door.py"))]


def words_of(domain: Domain) -> set[str]:
    """Its names, and those of its types as constants are written."""
    types = {t.name for t in domain.types}
    named = types | {t.upper() for t in types} | {p.name for p in domain.predicates}
    named |= {o.name for o in domain.operators} | {s.recovery for s in domain.stages}
    # A scenario called "0" or "open" is no word that would give a domain away.
    named |= {s for s in domain.scenarios if any(c.isalpha() for c in s) and s not in ("open", "clear", "two")}
    return named - ANY_ROBOT


def _said(code: str) -> Iterator[str]:
    """Names, attributes and texts of a module, without its docstrings and comments."""
    tree = ast.parse(code)
    prose = {
        id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.alias):
            yield from (node.name, *node.name.split("."))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose:
            yield node.value


def _files() -> list[Path]:
    found = [p for folder in LEARNER for p in sorted((ROOT / folder).glob("*.py"))]
    found += [ROOT / "sim_training" / f"{name}.py" for name in STEPS]
    return [p for p in found if str(p.relative_to(ROOT)) not in OF_THE_ARM]


@pytest.mark.parametrize("path", _files(), ids=lambda p: str(p.relative_to(ROOT)))
def test_no_domain_is_named(path: Path) -> None:
    said = set(_said(path.read_text(encoding="utf-8")))
    named = {domain.name: said & (words_of(domain) | {domain.name}) for domain in _domains()}
    assert not any(named.values()), named


def test_a_file_that_names_one_is_found() -> None:
    """The files of the arm do; so would a learner that knew it."""
    arm = next(d for d in _domains() if d.name == "cornered-insertion-s")
    for name in ("sim_training/device_env.py", "resync_robot/learning/camera_view.py"):
        said = set(_said((ROOT / name).read_text(encoding="utf-8")))
        assert said & (words_of(arm) | {"block", "BLOCK_NAMES"}), name
    assert "BLOCK" in set(_said("from x import BLOCK\n")) and "Pick" not in set(_said('"""Pick is a skill."""\n'))
