"""Another planner, Fast Downward by way of unified-planning, over PDDL files."""

from __future__ import annotations

from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory


def solve(domain: Path, problem: Path) -> list[tuple[str, ...]]:
    """A shortest plan: each step's operator and objects, by their names in the files and in lower case."""
    from unified_planning.io import PDDLReader
    from unified_planning.shortcuts import OneshotPlanner, get_environment

    get_environment().credits_stream = None
    read = PDDLReader().parse_problem(str(domain), str(problem))
    # It leaves a file in the folder that it runs in, which another test's planner would take for its own.
    with TemporaryDirectory() as folder, chdir(folder), OneshotPlanner(name="fast-downward-opt") as planner:
        found = planner.solve(read).plan
    return [(a.action.name.lower(), *(str(o).lower() for o in a.actual_parameters)) for a in found.actions]
