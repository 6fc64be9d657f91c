"""What decides the outcome of a training run: given when it begins, kept in config.json, and the same when resumed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, get_args, get_type_hints

from resync_robot.core.errors import ConfigError, ResyncError
from resync_robot.core.files import read_json
from resync_robot.core.options import DEFAULT_DOMAIN

CONFIG = "config.json"


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """The settings that shape a library; `commands.train_sim.TrainConfig` describes them."""

    domain: str = DEFAULT_DOMAIN
    preset: Literal["smoke", "quick", "full"] = "quick"
    seed: int = 0
    device: Literal["cpu", "cuda"] = "cpu"
    concepts: Literal["default", "paper"] = "default"
    skills: Literal["camera", "state"] = "camera"
    stages: str = ""
    library: str = ""


SHAPING = tuple(f.name for f in fields(RunSettings))
ADDED = ("stages", "library")
"""Settings that runs of earlier versions did not keep."""
OPTIONS = {"library": "from"}
"""What a setting is called on the command line, where that is not its own name."""


def read_settings(
    path: Path, given: Mapping[str, Any], find_domain: Callable[[str], object]
) -> tuple[RunSettings, str | None]:
    """The settings that the run in the folder `path` began with, and the hash of its rig where one was kept.

    Args:
        given: settings of this command, by name: they must be those of the run.
        find_domain: raises ResyncError where a domain cannot be used.

    Raises:
        ConfigError: the file is missing or damaged, a value in it is not allowed, or one that was given differs.
    """
    file = path / CONFIG
    lost = "put it right by hand, or start a new run without --resume"
    try:
        saved = read_json(file)
    except (ConfigError, OSError) as error:
        what = error.what if isinstance(error, ConfigError) else f"cannot read {file}: {error.strerror}"
        raise ConfigError(what, lost) from None
    if saved is None and not file.exists():
        raise ConfigError(f"{path} holds no run to resume", "start one without --resume")
    if not isinstance(saved, dict):
        raise ConfigError(f"{file} is not the config of a run", lost)
    kinds = get_type_hints(RunSettings)
    for name in SHAPING:
        if name not in saved and name in ADDED:
            saved[name] = getattr(RunSettings, name)
        if name not in saved:
            raise ConfigError(f"{file} is not the config of a run: it has no '{name}'", lost)
        value, allowed = saved[name], get_args(kinds[name])
        if name == "domain":
            try:
                find_domain(str(value))
            except ResyncError as error:
                raise ConfigError(f"{file}: 'domain' is {value!r}: {error.what}", error.fix or lost) from None
        elif name == "seed":
            if not isinstance(value, int) or isinstance(value, bool) or value < 0:
                raise ConfigError(f"{file}: 'seed' is {value!r}; allowed: whole numbers from 0 on", lost)
        elif kinds[name] is str:
            if not isinstance(value, str):
                raise ConfigError(f"{file}: '{name}' is {value!r}; allowed: text", lost)
        elif value not in allowed:
            raise ConfigError(f"{file}: '{name}' is {value!r}; allowed: {', '.join(allowed)}", lost)
    for name, value in given.items():
        option = OPTIONS.get(name, name)
        if value != saved[name]:
            kept = "(none)" if saved[name] == "" else saved[name]
            raise ConfigError(
                f"the run in {path} began with --{option} {kept}, not {value}, and keeps it",
                f"leave --{option} out to go on with it, or start a new run without --resume",
            )
    rig = saved.get("rig")
    if rig is not None and not isinstance(rig, str):
        raise ConfigError(f"{file}: 'rig' is {rig!r}; allowed: the hash of a rig", lost)
    return RunSettings(**{name: saved[name] for name in SHAPING}), rig
