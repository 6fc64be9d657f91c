"""Memory that the driver shares with the process that talks to the arm; neither ever waits for the other.

Each word has one writer. Setpoints travel in a ring; every block comes with its way to rest, of which the link reads
the last block's while the driver writes over the oldest. `wire` is what the last RING setpoints were when they went
out, and `sent_at` when that was, on the host's monotonic clock. Of two snapshots of the robot one is whole while the
other is written: a reader finds one even where the writer died in the middle of it. `why` is the last word of a link
that could not go on.
"""

from __future__ import annotations

import mmap
import os
from enum import IntEnum

import numpy as np

RING = 1 << 15
"""Setpoints; 65 s."""
STOPS = 4
LONGEST_STOP = 4096
JOINTS = ("f8", 6)
PLAYING = 2
"""`runtime` while a program runs."""

SNAPSHOT = np.dtype(
    [
        ("time", "f8"),
        ("q", *JOINTS),
        ("qd", *JOINTS),
        ("force", *JOINTS),
        ("robot_mode", "i8"),
        ("safety_mode", "i8"),
        ("runtime", "i8"),
        ("speed_fraction", "f8"),
        ("heard", "f8"),
    ]
)
"""`heard` is the host's monotonic time at which the controller's `time` last changed."""
STOP = np.dtype([("epoch", "i8"), ("after", "i8"), ("count", "i8"), ("q", "f8", (LONGEST_STOP, 6))])
LAYOUT = np.dtype(
    [
        # Written by the driver.
        ("write", "i8"), ("epoch", "i8"), ("finish", "i8"), ("ring", "f8", (RING, 6)), ("tags", "i8", RING),
        ("stops", STOP, STOPS),
        # Written by the link.
        ("read", "i8"), ("link_epoch", "i8"), ("resting", "i8"), ("held", *JOINTS), ("felt", "f8"), ("fault", "i8"),
        ("why", "S200"), ("uploaded", "i8"), ("orders", "i8"), ("sent", "i8"), ("sequence", "i8"),
        ("snapshots", SNAPSHOT, 2), ("sent_at", "f8", RING), ("wire", "f8", (RING, 6)),
    ]
)  # fmt: skip


class Fault(IntEnum):
    """Why the link sends no setpoints any more."""

    NONE = 0
    STALE = 1
    STOPPED = 2
    """The control program does not run: protective stop, emergency stop, dashboard, watchdog."""
    LINK_LOST = 3
    DRIVER_GONE = 4


class LinkMemory:
    """The shared words as numpy sees them.

    Args:
        file: descriptor from `new_file`, inherited by the child.
    """

    def __init__(self, file: int) -> None:
        self._map = mmap.mmap(file, LAYOUT.itemsize)
        self.words = np.frombuffer(self._map, LAYOUT, count=1)[0:1].view(np.recarray)[0]

    @staticmethod
    def new_file() -> int:
        """A descriptor of zeroed memory without a name; it goes when its last holder does."""
        file = os.memfd_create("resync-robot-link")
        os.ftruncate(file, LAYOUT.itemsize)
        return file

    def publish(self, snapshot: np.ndarray) -> None:
        """Replace the snapshot (one element of SNAPSHOT)."""
        w = self.words
        w["snapshots"][(int(w["sequence"]) + 1) % 2] = snapshot
        w["sequence"] += 1

    def snapshot(self) -> np.ndarray:
        """A copy of the latest whole snapshot, one element of SNAPSHOT."""
        w = self.words
        while True:
            before = int(w["sequence"])
            copy = w["snapshots"][before % 2].copy()
            # Once more only where the writer has come round meanwhile, so never where it is dead.
            if int(w["sequence"]) == before:
                return copy
