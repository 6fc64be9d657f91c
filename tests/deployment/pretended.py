"""A camera that sees nothing, and a witness that tells some of what it hears."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from resync_robot.core.world import CameraFrame


def silent(*args: object) -> None:
    pass


@dataclass(frozen=True)
class Told:
    """A witness that passes some of it on."""

    on_answer: Callable[..., None] = silent
    on_picture: Callable[..., None] = silent
    on_scan: Callable[..., None] = silent
    on_look: Callable[..., None] = silent
    on_seen: Callable[..., None] = silent
    on_timing: Callable[..., None] = silent
    on_doubt: Callable[..., None] = silent
    on_unsettled: Callable[..., None] = silent


@dataclass
class Whole:
    """A camera that gives whole pictures only."""

    name: str = "front"
    size: tuple[int, int] = (424, 240)
    asked: list[str] = field(default_factory=list)

    def connect(self) -> None: ...

    def close(self) -> None: ...

    def capture(self) -> CameraFrame:
        width, height = self.size
        colour = np.full((height, width, 3), 90, dtype=np.uint8)
        return CameraFrame(self.name, colour, np.zeros((height, width), np.uint16), np.eye(3), np.eye(4), 1.25)
