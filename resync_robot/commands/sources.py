"""Where poses come from and what the recovery sees: by what was asked for, and by what a library is good for."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from resync_robot.core.errors import ConfigError, LibraryError
from resync_robot.core.library import Library
from resync_robot.core.task import Domain
from resync_robot.library_models import sees_by_camera

if TYPE_CHECKING:
    from resync_robot.core.rig import Rig
    from resync_robot.deployment.settings import DeployConfig

LEAST_RECOVERED = 0.5
"""Share of its trials in which a camera policy has to recover to be used without being asked for."""


def camera_trials(domain: Domain, library: Library) -> tuple[int, int] | None:
    """(recovered, worlds) of the trials by which the camera policy was kept; None where the library does not say."""
    try:
        figures = library.stage(domain.recovery).figures["distil"]
        kept = next(point for point in figures["points"] if point["step"] == figures["chosen"])
        return int(kept["success"]), int(kept["worlds"])
    except (KeyError, LibraryError, TypeError, ValueError, StopIteration):
        return None


def why_not_by_camera(domain: Domain, library: Library) -> str:
    """Why the recovery does not see by camera unless somebody asks for it, as a clause; empty where it does."""
    if not sees_by_camera(domain, library):
        return f"the library holds no camera policy for {domain.recovery}"
    trials = camera_trials(domain, library)
    if trials is not None and trials[0] < LEAST_RECOVERED * trials[1]:
        return f"the library's camera policy recovered in only {trials[0]} of the {trials[1]} trials of its training"
    return ""


def deployed_by_camera(config: DeployConfig, domain: Domain, rig: Rig, library: Library) -> bool:
    """Whether the recovery sees by camera. Says so where it does not though the library holds a camera policy.

    Raises:
        ConfigError: it was asked to see without cameras, or there is nothing else that it could follow its block by.
    """
    from resync_robot.console import say

    if config.skills == "camera" and config.perception == "oracle":
        raise ConfigError("--skills camera needs cameras", "leave out --perception oracle")
    if config.skills != "auto" or config.perception == "oracle":
        return config.skills == "camera"
    why = why_not_by_camera(domain, library)
    anyway = "use it all the same: --skills camera"
    if why and config.backend == "ur7e" and not (rig.controller and rig.controller.emulated):
        ways = ["train longer: resync-robot train-sim --preset quick", f"do without {domain.recovery}: --skills state"]
        raise ConfigError(
            f"{why}, and on a real arm {domain.recovery} has nothing else to follow a block by",
            "; or ".join([*ways, anyway] if sees_by_camera(domain, library) else ways),
        )
    if why and sees_by_camera(domain, library):
        say(f"Note: {why}, so {domain.recovery} does without.\n  -> {anyway}")
    return not why


def evaluated_sources(
    perception: str, skills: str, domain: Domain, libraries: Mapping[Path, Library]
) -> tuple[str, str, str]:
    """Where poses come from ("camera" or "oracle"), what the recovery sees ("camera" or "state"), and what to tell a
    person about how these were chosen, after a look at what there is. Raises ConfigError."""
    if skills == "camera" and perception == "oracle":
        raise ConfigError("--skills camera needs cameras", "leave out --perception oracle")
    reasons = {path: why for path, library in libraries.items() if (why := why_not_by_camera(domain, library))}
    by_camera = skills == "camera" or not reasons
    chosen = perception == "auto" or (perception, skills) == ("camera", "auto")
    if perception == "auto":
        perception = "camera" if by_camera else "oracle"
    if skills == "auto":
        skills = "camera" if perception == "camera" and by_camera else "state"
    note = ""
    if reasons and chosen and skills == "state":
        path, why = next(iter(reasons.items()))
        note = f"{why} ({path}), hence {in_words(domain, perception, skills)}."
        if sees_by_camera(domain, libraries[path]):
            note += "\n  -> use it all the same: --skills camera"
    return perception, skills, note


def in_words(domain: Domain, perception: str, skills: str) -> str:
    """Where poses come from and what the recovery sees."""
    ways = {"poses": perception, domain.recovery: skills}
    return ", ".join(f"{what} by {'camera' if way == 'camera' else 'exact state'}" for what, way in ways.items())
