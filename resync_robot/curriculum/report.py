"""What a training run found out, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from resync_robot.core.library import LearnedStage, Library
from resync_robot.core.task import Domain
from resync_robot.library_models import known_concepts, learned_names
from resync_robot.planning.model_table import model_table
from resync_robot.planning.pddl import operator_to_pddl


def report(domain: Domain, library: Library) -> str:
    """Each stage's failure and recovery, and the model that the planner has in the end."""
    lines = [line for number, stage in enumerate(library.stages, 1) for line in _stage(number, stage)]
    concepts, given = known_concepts(domain, library), {o.name: o for o in domain.operators}
    learned = [p for p in concepts.predicates if p.name in concepts.records]
    signatures = ", ".join(f"{p.name}({', '.join(t.name for t in p.types)})" for p in learned)
    named = learned_names(domain, library)
    lines.append(f"Discovered predicates: {signatures or 'none'}")
    lines += ["What each skill needs and does, **learned** or given:", model_table(concepts.operators, named)]
    lines.append("Operators (those marked * are new or differ from the given model):")
    for operator in concepts.operators:
        mark = "  " if given.get(operator.name) == operator else "* "
        lines += [mark + line for line in operator_to_pddl(operator).splitlines()]
    return "\n".join(lines)


def _stage(number: int, stage: LearnedStage) -> list[str]:
    f: Mapping[str, Any] = stage.figures
    causes, failed = " and ".join(stage.failure.objects), stage.failure.skill
    lines = [f"Stage {number}: {failed} fails in {stage.scenario} on {causes}; mended by {stage.recovery}."]
    how = ""
    if "take-over" in f:
        how = f"taken over from {f['take-over']['from']}"
    elif "recover" in f:
        how = f"learned in {f['recover']['steps'] / 1000:.0f} k actions with {f['recover']['verdicts']} verdicts"
    if "mine" in f and how and "check" in f:
        lines.append(
            f"  {f['mine']['failed']} of {f['mine']['tasks']} tasks failed; {how}; "
            f"{failed} then succeeds in {f['check']['mended']} of {f['check']['worlds']} fresh tasks."
        )
    if "distil" in f:
        chosen = next(p for p in f["distil"]["points"] if p["step"] == f["distil"]["chosen"])
        lines.append(f"  By camera: recovered in {chosen['success']} of {chosen['worlds']} worlds of its own.")
    seconds = sum(v.get("seconds", 0.0) for v in f.values() if isinstance(v, dict))
    return [*lines, *([f"  {seconds / 60:.1f} min"] if seconds else [])]
