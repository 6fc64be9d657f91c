"""Numbers from the command line: each has a range, which is checked before anything is loaded or moved."""

from __future__ import annotations

from collections.abc import Sequence

from resync_robot.core.errors import ConfigError

DEFAULT_DOMAIN = "cornered-insertion-s"
"""Of all commands, where none is named."""
MOST_SEED = 2**31 - 1
"""What every simulator takes as a seed."""
MOST_EPISODES = 1_000_000
"""Of a seed: a world that cannot be used is replaced by the one that comes so many later."""
MOST_STEPS = 10_000_000
"""Control steps of an episode; a day of them at 100 Hz."""
MOST_WORKERS = 256


def check_range(option: str, value: float, low: float, high: float, advice: str = "") -> None:
    """Raises ConfigError where `value` is not between the two, or is no number at all; `advice` may name a unit."""
    if not low <= value <= high:
        given, least, most = (f"{v:g}" if isinstance(v, float) else str(v) for v in (value, low, high))
        raise ConfigError(f"{option} is {given}; allowed: {least} to {most}" + (f", {advice}" if advice else ""))


def check_seed(value: int, option: str = "--seed") -> None:
    """Raises ConfigError."""
    if not 0 <= value <= MOST_SEED:
        raise ConfigError(f"{option} is {value}", f"give a whole number from 0 to {MOST_SEED}")


def check_seeds(values: Sequence[int]) -> None:
    """Raises ConfigError."""
    if not values:
        raise ConfigError("--seeds names none", "give one or more whole numbers from 0 on")
    for value in values:
        check_seed(value, "--seeds")
