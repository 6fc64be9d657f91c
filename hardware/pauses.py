"""Whether this program itself stood still for a while: suspended by Ctrl-Z, the computer asleep, or far too busy.

Whatever talked to it may have given it up meanwhile, and what it last heard is old through no fault of a cable.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import cache

BEAT_S = 0.1
PAUSE_S = 1.0
"""Between two beats. A busy computer makes shorter gaps, which are nobody's pause."""
BLAME_S = 10.0
"""How long after a pause it is named beside what goes wrong."""


def _now() -> float:
    # Unlike the monotonic clock this one goes on while the computer sleeps.
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class Pauses:
    """Beats in the background; a gap between beats is a pause. For any thread.

    Args:
        clock: s, which goes on while this program stands still.
    """

    def __init__(self, clock: Callable[[], float] = _now) -> None:
        self._clock, self._lock = clock, threading.Lock()
        self._beat = clock()
        self._length, self._ended = 0.0, float("-inf")
        threading.Thread(target=self._go_on, name="pauses", daemon=True).start()

    def since(self) -> float:
        """s since the last pause ended; infinite where there was none."""
        return self._look() - self._ended

    def lately(self) -> float:
        """s that the last pause lasted, where it ended within BLAME_S; else 0."""
        return self._length if self.since() < BLAME_S else 0.0

    def _look(self) -> float:
        # Whoever asks may be the first to run after a pause.
        with self._lock:
            now = self._clock()
            if now - self._beat > PAUSE_S:
                self._length, self._ended = now - self._beat, now
            self._beat = now
            return now

    def _go_on(self) -> None:
        while True:
            self._look()
            time.sleep(BEAT_S)


@cache
def pauses() -> Pauses:
    """Those of this process, from the first call on."""
    return Pauses()


def blaming_a_pause(what: str, fix: str) -> tuple[str, str]:
    """What went wrong and what mends it, or the pause that this program made shortly before, and what mends that."""
    paused = pauses().lately()
    if not paused:
        return what, fix
    return (
        f"this program stood still for {paused:.1f} s (suspended, asleep, or too busy), and then {what}",
        "look at the robot, and start again; keep this computer awake meanwhile",
    )
