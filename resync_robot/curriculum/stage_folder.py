"""What one stage leaves in the run folder: `stages/2-NAME/{failures, recovery, check, dreams-*, library}`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from resync_robot.core.damage import check_folder_kind
from resync_robot.core.files import check_folder
from resync_robot.curriculum.run_folder import RunFolder

Tell = Callable[[float, str], None]
"""Called with the share of a step that is done and the figure that matters."""


class StageFolder:
    """One stage's part of a run folder.

    Args:
        number: of the stage in the library that it ends in, from 1.
    """

    def __init__(self, run: RunFolder, number: int, recovery: str) -> None:
        self.run, self.number = run, number
        self.name = f"{number}-{recovery}"
        self.path = run.stages / self.name
        check_folder_kind(self.path)
        check_folder(self.path, of=run.path)
        check_folder_kind(self.library)

    @property
    def library(self) -> Path:
        """Where all that is known after this stage lies."""
        return self.path / "library"

    def figures(self, step: str) -> dict[str, Any]:
        """What a step left in metrics.json; empty where it is not finished."""
        found = self.run.metrics.get(self._key(step), {})
        return dict(found) if self.run.has_figures(self._key(step)) else {}

    def record(self, step: str, figures: dict[str, Any]) -> None:
        """Add a step's figures to metrics.json."""
        self.run.record(self._key(step), figures)

    @contextmanager
    def timed(self, step: str) -> Iterator[None]:
        """Adds the seconds spent to the step's figures, over all the times it was resumed."""
        with self.run.timed(self._key(step)):
            yield

    @property
    def all_figures(self) -> dict[str, Any]:
        """Step -> its figures, without what is long."""
        own = {k: v for k, v in self.run.metrics.items() if k.startswith(f"{self.name}/")}
        short = {k: {n: v for n, v in f.items() if n not in ("curve", "report")} for k, f in own.items()}
        return {k.removeprefix(f"{self.name}/"): v for k, v in short.items()}

    def _key(self, step: str) -> str:
        return f"{self.name}/{step}"
