"""Recoveries that a library of another domain holds: a stage takes one over, and learns only what it means here."""

from __future__ import annotations

from collections.abc import Sequence

from resync_robot.core.embodiment import Stage
from resync_robot.core.errors import ConfigError
from resync_robot.core.library import Library, Record
from resync_robot.core.task import Domain
from resync_robot.curriculum.stage_folder import StageFolder

TAKE_OVER = "take-over"
"""The step that is done instead of learning the recovery."""


def check_taken_over(stages: Sequence[Stage], elsewhere: Library, domain: Domain, by_camera: bool) -> None:
    """Refuse a library of another domain that nothing can be taken over from.

    Args:
        by_camera: the recoveries are to see by camera.

    Raises:
        ConfigError: it holds no recovery of these stages, or one about types that the domain does not have, or no
            camera policy where one is asked for.
    """
    taken, mended = [s for s in stages if s.recovery in elsewhere.skills], f"build on a library of {domain.name}"
    if not taken:
        raise ConfigError(
            f"the library of --from was learned in {elsewhere.domain} and holds {', '.join(sorted(elsewhere.skills))}; "
            f"the stages here learn {', '.join(s.recovery for s in stages)}",
            f"{mended}, or leave --from out",
        )
    types = {t.name for t in domain.types}
    for stage in taken:
        name = stage.recovery
        missing = sorted(set(elsewhere.skills[name].meta.get("signature", ())) - types)
        if missing:
            raise ConfigError(
                f"{name} of the library of --from is about {', '.join(missing)}, which {domain.name} does not have",
                f"{mended}, or leave --from out",
            )
        if by_camera and name not in elsewhere.policies:
            raise ConfigError(
                f"the library of --from holds no camera policy for {name}", "add --skills state, or give another one"
            )


def take_over(stage: Stage, folder: StageFolder, elsewhere: Library) -> Record:
    """The record of the stage's recovery. Raises ConfigError where the run began with another library."""
    begun = folder.figures(TAKE_OVER).get("library")
    if begun not in (None, elsewhere.content_hash):
        raise ConfigError(
            f"the library of --from is not the one any more that {folder.run.path} began with",
            "put it back, or start a new run without --resume",
        )
    folder.record(TAKE_OVER, {"from": elsewhere.domain, "library": elsewhere.content_hash})
    return elsewhere.skills[stage.recovery]
