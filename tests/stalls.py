"""Whether this machine kept time while something ran."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Self

MOST_S = 0.1
"""What a driver's limits are made to bear with room to spare."""


class LimitBrokenError(AssertionError):
    """Something was sent that must never be, however late the machine was."""


@contextmanager
def never_excused() -> Iterator[None]:
    """What fails in here has failed, whatever the machine did meanwhile."""
    try:
        yield
    except AssertionError as error:
        raise LimitBrokenError(str(error)) from error


class Stalls:
    """Sleeps 5 ms at a time in the background, and keeps by how much it overslept at worst."""

    def __init__(self) -> None:
        self.worst = 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def _watch(self) -> None:
        while not self._stop.is_set():
            begin = time.monotonic()
            time.sleep(0.005)
            self.worst = max(self.worst, time.monotonic() - begin - 0.005)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
