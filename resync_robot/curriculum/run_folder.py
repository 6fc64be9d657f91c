"""A run as a folder: its settings, what each stage left, its figures. Every write is whole or not at all."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

from resync_robot.core.damage import AGAIN, Shape, check_folder_kind, check_shape, reading
from resync_robot.core.errors import ConfigError, ResyncError
from resync_robot.core.files import check_folder, read_json, write_bytes, write_json
from resync_robot.core.rig import Rig, load_rig

RIG_FILE = "rig.toml"
FILES = ("config.json", "metrics.json", RIG_FILE, "demonstrations.png", "distil.png")
FOLDERS = ("stages", "library", "dataset")
"""What lies in a run folder."""
LEFTOVER = re.compile(r"\..+\.[0-9a-f]{8}\.part")
"""Name of a file that a killed process was writing (`core.files.whole`)."""
LIST: Shape = [float]
FIGURES: dict[str, Shape] = {
    "mine": {"tasks": int, "failed": int, "kept": int},
    "recover": {"curve": {"steps": LIST, "success": LIST, "return": LIST, "seconds": LIST}, "steps": float},
    "take-over": {"from": str, "library": str},
    "check": {"worlds": int, "mended": int},
    "distil": {"points": [{"step": int, "worlds": int, "success": int}], "chosen": int},
}
"""What the steps of a stage leave in metrics.json beside the seconds that they took, and what others rely on."""


class RunFolder:
    """`runs/<date>-<name>/{config.json, rig.toml, metrics.json, stages/, library/}`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.stages = path / "stages"
        for name in FILES:
            if (path / name).is_dir():
                raise ConfigError(f"{path / name} is a folder, and should be a file", AGAIN)
        for name in FOLDERS:
            check_folder_kind(path / name)
        check_folder(self.stages, of=path)

    @property
    def library(self) -> Path:
        return self.path / "library"

    @cached_property
    def rig(self) -> Rig:
        """The rig that the run is for: the one that `keep_rig` left, or the simulation's own."""
        kept = self.path / RIG_FILE
        return load_rig(kept if kept.exists() else None)

    def keep_rig(self, path: Path | None) -> None:
        """Copy the rig file `path` into the run, so that it is resumed with the rig that it began with.

        Raises:
            ConfigError: the file is no rig, the run has begun with another one, or its folder holds another one.
        """
        if path is None:
            return
        given = load_rig(path)
        if (self.path / "config.json").exists() and self.rig.hash != given.hash:
            raise ConfigError(
                f"the run in {self.path} is for the rig '{self.rig.name}' ({self.rig.hash}), not for {path}",
                "leave --rig out to go on with it, or start a new run without --resume",
            )
        kept, data = self.path / RIG_FILE, path.read_bytes()
        if kept.exists() and kept.read_bytes() != data:
            raise ConfigError(f"{kept} exists, and is another rig file than {path}", "give another folder with --out")
        write_bytes(kept, data)
        self.__dict__.pop("rig", None)

    def find_rig(self, begun: str | None, given: Path | None) -> None:
        """Put the rig file that the run began with back where it was lost or altered.

        Args:
            begun: the hash of that rig; None where the run is new, or of a version that did not keep it.
            given: a rig file that may be it.

        Raises:
            ConfigError: the rig here is another one by now, and the right one was not given.
        """
        kept = self.path / RIG_FILE
        try:
            if begun in (None, self.rig.hash):
                return
        except ResyncError:
            if begun is None:
                raise
        if given is None or load_rig(given).hash != begun:
            what = "damaged or altered" if kept.exists() else "missing"
            raise ConfigError(
                f"{kept} is {what}: the run began with a rig of hash {begun}",
                "give that rig file again: --resume --rig FILE",
            )
        write_bytes(kept, given.read_bytes())
        self.__dict__.pop("rig", None)

    @property
    def metrics(self) -> dict[str, Any]:
        """Figures by stage. Raises TrainingError where the file cannot be used."""
        path = self.path / "metrics.json"
        with reading(path):
            found = read_json(path) if path.exists() else {}
            check_shape(found, {})
            for stage, figures in found.items():
                step = stage.rpartition("/")[2]
                check_shape(figures, FIGURES.get(step, {}) if _any_figures(figures) else {}, stage)
                check_shape(figures.get("seconds", 0.0), float, f"{stage}.seconds")
        return dict(found)

    def has_figures(self, stage: str) -> bool:
        """Did the stage leave what it found, and not only how long it took? Without that it is not finished."""
        return _any_figures(self.metrics.get(stage, {}))

    def sweep(self) -> None:
        """Remove what a killed run was writing. Only while nobody else writes here."""
        for folder in (self.path, self.stages):
            for path in folder.glob(".*.part"):
                if LEFTOVER.fullmatch(path.name):
                    path.unlink(missing_ok=True)

    def record(self, stage: str, figures: dict[str, Any]) -> None:
        """Add a stage's figures to metrics.json."""
        write_json(self.path / "metrics.json", {**self.metrics, stage: {**self.metrics.get(stage, {}), **figures}})

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Adds the seconds spent to the stage's figures, over all the times it was resumed."""
        begin = time.monotonic()
        yield
        spent = self.metrics.get(stage, {}).get("seconds", 0.0) + time.monotonic() - begin
        self.record(stage, {"seconds": round(spent, 1)})


def _any_figures(figures: Any) -> bool:
    return not isinstance(figures, dict) or bool(set(figures) - {"seconds"})
