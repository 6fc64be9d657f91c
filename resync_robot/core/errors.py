"""One tree of errors. A message says what happened, where, what is allowed, and what to type next."""

from __future__ import annotations

from typing import Any


class ResyncError(Exception):
    """Base of every error this package raises on purpose; the CLI prints it and exits with code 2.

    Args:
        what: what happened, where, and what is allowed.
        fix: the next command or edit that mends it.
    """

    def __init__(self, what: str, fix: str = "") -> None:
        super().__init__(what if not fix else f"{what}\n  -> {fix}")
        self.what = what
        self.fix = fix

    def __reduce__(self) -> tuple[Any, ...]:
        # The default calls the class with the finished message, which a subclass with arguments of its own refuses;
        # an error of a worker process would then arrive as a broken pool.
        return _rebuild, (type(self), self.args, self.__dict__)


class ConfigError(ResyncError):
    """A rig, preset, or command line value that cannot be used."""


class DiskError(ResyncError):
    """A disk that is full, failing or read-only: a fault of the machine, with which the CLI exits with code 3."""


class UnknownNameError(ResyncError):
    """A domain, scenario, object, predicate, skill or camera that does not exist.

    Args:
        where: the file that has the valid ones, where it is not the program itself.
    """

    def __init__(self, kind: str, name: str, valid: list[str] | tuple[str, ...], where: str = "") -> None:
        super().__init__(
            f"unknown {kind} '{name}'" + (f" in {where}" if where else ""),
            f"valid: {', '.join(sorted(valid)) or '(none)'}",
        )


class LibraryError(ResyncError):
    """A library folder that is missing, of another version, truncated or altered."""


class EpisodeError(ResyncError):
    """An episode recording that cannot be written or read."""


class PlanningError(ResyncError):
    """A goal that no plan reaches, or a model that is not well formed."""


class MotionError(ResyncError):
    """A target outside the arm's reach or limits."""


class InterruptedMotionError(MotionError):
    """The robot had to stop in the middle of a motion, and may move again: look anew, plan anew."""


class PerceptionError(ResyncError):
    """An image or estimate that cannot be used."""


class CalibrationError(ResyncError):
    """Pictures of a board, or poses of the arm, from which no trustworthy calibration follows."""


class RenderError(ResyncError):
    """No device can render."""


class PolicyError(ResyncError):
    """A camera policy that cannot be read, or that does not fit this rig."""


class TrainingError(ResyncError):
    """A training phase that cannot produce what the next one needs."""


def _rebuild(kind: type[ResyncError], args: tuple[Any, ...], fields: dict[str, Any]) -> ResyncError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(fields)
    return error
