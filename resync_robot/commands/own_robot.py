"""What the commands say where a domain brings a robot of its own."""

from __future__ import annotations

from collections.abc import Mapping

from resync_robot.core.errors import ConfigError


def check_own_robot(given: Mapping[str, bool]) -> None:
    """Refuse what such a domain has no use for.

    Args:
        given: options, as they are typed -> whether they were.

    Raises:
        ConfigError: one of them was.
    """
    for option, was_given in given.items():
        if was_given:
            raise ConfigError(
                f"{option} is for domains of the arm, and this one has a robot of its own", "leave it out"
            )
