"""resync-robot: a robot that learns from its own failures (ReSYNC).

How the parts fit together, from what a person writes to what a robot does:

- A `Domain` declares the things of a world (types with their poses and extents, a `Relation` for how one lies beside
  another), what is known of it (predicates, operators, given skills), its robot with a simulator, a `Scenario` for each
  family of tasks, and a `Stage` for each failure to learn from.
- `sim_training` attempts tasks until a skill fails, learns a recovery from that failure, and dreams about what the
  recovery changes. `curriculum` does so stage by stage.
- `learning` turns the dreams into predicates and operators. They are kept in a library, a folder of open files that
  `load_library` reads.
- `planning` makes atoms of states and plans of atoms. `plan_and_execute` is the one loop of training, evaluation and
  deployment: look, plan, run a skill, look again.
- `perception`, `policies` and `hardware` are how a deployed robot sees, acts and is driven; `deployment` opens it, runs
  an episode, and records it.

The names below are loaded when they are first used, so that importing this package costs nothing. All else is imported
from the module that defines it; docs/structure.md says which folder holds what.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from resync_robot.core.embodiment import Stage
    from resync_robot.core.library import load_library
    from resync_robot.core.relations import Relation
    from resync_robot.core.task import Domain, Scenario
    from resync_robot.planning.execute import plan_and_execute

__version__ = "0.1.0"

__all__ = ["Domain", "Relation", "Scenario", "Stage", "load_library", "plan_and_execute"]

_MODULES = {
    "Domain": "core.task",
    "Relation": "core.relations",
    "Scenario": "core.task",
    "Stage": "core.embodiment",
    "load_library": "core.library",
    "plan_and_execute": "planning.execute",
}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
