"""A domain to start from: a small complete one, in a file of one's own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from resync_robot.given import Given


@dataclass(frozen=True, kw_only=True)
class NewDomainConfig:
    """Write a small complete domain to a file, for you to change into yours (docs/own-domain.md)."""

    name: tyro.conf.Positional[str]
    """Its name: small letters, digits and '-'."""

    out: Given[Path] = None
    """The file. Default: the name, with '_' for '-' and .py, in this folder."""


def new_domain(config: NewDomainConfig) -> None:
    """Write it, and say how to go on.

    Raises:
        ConfigError: the name cannot be that of a domain, or the file exists or cannot be written.
    """
    from dataclasses import replace

    from resync_robot.console import say
    from resync_robot.core.domain_faults import faults
    from resync_robot.core.errors import ConfigError
    from resync_robot.core.files import read_text, unwritable, write_text
    from resync_robot.sim_training.domains import template

    for what, fix in faults(replace(template.DOMAIN, name=config.name)):
        raise ConfigError(what, fix)
    path = config.out or Path(config.name.replace("-", "_") + ".py")
    if path.suffix != ".py":
        raise ConfigError(f"--out {path} is no name of a Python file", "let it end in .py")
    if path.exists():
        raise ConfigError(f"{path} exists; it is left as it is", "give another name with --out")
    text = read_text(Path(template.__file__)).replace("THIS_FILE", str(path)).replace(template.DOMAIN.name, config.name)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, text)
    except OSError as error:
        raise unwritable(f"--out {path}", error, "give another file") from None
    say(f"{path}: a domain in which a robot drives to a flag, and a crate stands on it. Change it, and run:")
    say(f"  resync-robot check-domain {path}")
