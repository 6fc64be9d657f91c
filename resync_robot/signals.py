"""Signals that ask a program to end: Ctrl-C, SIGTERM, SIGHUP. Each raises the same exception.

Where something has to be finished whatever happens (a robot braked, a recording closed), it is done under `held`.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class EndedBySignal(KeyboardInterrupt):
    """Somebody asked this program to end; whatever cleans up after Ctrl-C does so after each of them.

    Attributes:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(words_for(number))
        self.number = number


def words_for(number: int) -> str:
    """What happened, for people."""
    return "interrupted by Ctrl-C" if number == signal.SIGINT else f"ended by {signal.Signals(number).name}"


def number_of(end: KeyboardInterrupt) -> int:
    """Of the signal that ended a program."""
    return int(getattr(end, "number", signal.SIGINT))


def ended_by(error: BaseException | None) -> int | None:
    """The signal in whose course an error came up; None where there was none."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return None if error is None else number_of(error)


class _Held:
    """How many `held` blocks are under way, and the signal that came meanwhile; 0 where none did."""

    depth = 0
    number = 0


def _on_signal(number: int, frame: FrameType | None) -> None:
    if _Held.depth:
        _Held.number = number
        return
    raise EndedBySignal(number)


@contextmanager
def raised() -> Iterator[None]:
    """In here each of these signals raises EndedBySignal, unless this process was told to ignore it (`nohup`)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {s: signal.getsignal(s) for s in ENDING}
    for number, handler in before.items():
        if handler in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, _on_signal)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def held() -> Iterator[None]:
    """In here such a signal waits for the end of the block, where it raises unless another exception passes."""
    _Held.depth += 1
    try:
        yield
    finally:
        _Held.depth -= 1
        number = _Held.number
        if not _Held.depth:
            _Held.number = 0
    if number and not _Held.depth:
        raise EndedBySignal(number)


@contextmanager
def let_through() -> Iterator[None]:
    """Within `held`, a part in which such a signal raises at once, also one that has waited."""
    depth, _Held.depth = _Held.depth, 0
    try:
        if number := _Held.number:
            _Held.number = 0
            raise EndedBySignal(number)
        yield
    finally:
        _Held.depth = depth
