"""What was planned in a dry run, as PDDL for other planners."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from resync_robot.core.errors import ConfigError
from resync_robot.core.files import PDDL, check_output, unwritable, write_text

if TYPE_CHECKING:
    from resync_robot.core.task import Domain, Task
    from resync_robot.deployment.settings import DeployConfig
    from resync_robot.planning.execute import Model
    from resync_robot.planning.search import Plan

DOMAIN, PROBLEM = "domain.pddl", "problem.pddl"


def check_plan_files(config: DeployConfig) -> None:
    """Refuse `--pddl` before anything is loaded or moved. Raises ConfigError or DiskError."""
    if config.pddl is None:
        return
    if not config.dry_run:
        raise ConfigError("--pddl writes what a dry run planned", "add --dry-run, or leave out --pddl")
    if config.episodes != 1:
        raise ConfigError(f"--pddl writes one problem, and --episodes is {config.episodes}", "leave out --episodes")
    for name in (DOMAIN, PROBLEM):
        check_output(config.pddl / name, PDDL, [config.replay, config.rig], "--pddl")


def write_plan_files(folder: Path, domain: Domain, model: Model, task: Task, scenario: str, plan: Plan) -> str:
    """Write what `plan` was found from: the model to domain.pddl; objects, atoms and goal to problem.pddl.

    Returns:
        What to tell a person.

    Raises:
        PlanningError: a name that PDDL does not allow.
        ConfigError, DiskError: a file cannot be written.
    """
    from resync_robot.planning.pddl import domain_to_pddl, object_names, problem_to_pddl

    predicates, operators = model.abstraction.predicates, model.operators
    names = object_names(task.objects, domain.types, predicates, operators)
    texts = {
        DOMAIN: domain_to_pddl(domain.name, domain.types, predicates, operators),
        PROBLEM: problem_to_pddl(f"{scenario}-seed{task.seed}", domain.name, names, plan.atoms, task.goal),
    }
    for name, text in texts.items():
        try:
            write_text(folder / name, text)
        except OSError as error:
            raise unwritable(folder / name, error, "give another folder with --pddl") from None
    words = f"PDDL: {folder / DOMAIN} and {folder / PROBLEM}."
    if not plan.reaches(task.goal):
        words += " By these alone there is no plan: the one above supposes more, as its first line says."
    return words
