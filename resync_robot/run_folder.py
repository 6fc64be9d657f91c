"""A run as a folder: its settings, what each stage left, its figures. Every write is whole or not at all."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import date
from functools import cached_property
from pathlib import Path
from typing import Any

from resync_robot.core.errors import ConfigError
from resync_robot.core.rig import Rig, load_rig

RIG_FILE = "rig.toml"


class RunFolder:
    """`runs/<date>-<name>/{config.json, rig.toml, metrics.json, stages/, library/}`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.stages = path / "stages"
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
            ConfigError: the file is no rig, or the run has begun with another one.
        """
        if path is None:
            return
        given = load_rig(path)
        if (self.path / "config.json").exists() and self.rig.hash != given.hash:
            raise ConfigError(
                f"the run in {self.path} is for the rig '{self.rig.name}' ({self.rig.hash}), not for {path}",
                "leave --rig out to go on with it, or start a new run without --resume",
            )
        beside = self.path / f"{RIG_FILE}.part"
        beside.write_bytes(path.read_bytes())
        beside.replace(self.path / RIG_FILE)
        self.__dict__.pop("rig", None)

    @property
    def metrics(self) -> dict[str, Any]:
        return read_json(self.path / "metrics.json") or {}

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


def default_folder(name: str) -> Path:
    """runs/<date>-<name>, numbered where that exists."""
    base = Path("runs") / f"{date.today().isoformat()}-{name}"
    path, n = base, 2
    while path.exists():
        path, n = base.with_name(f"{base.name}-{n}"), n + 1
    return path


def latest_folder(name: str) -> Path:
    """The newest run of that name. Raises ConfigError where there is none."""
    found = sorted(Path("runs").glob(f"*-{name}*/config.json"), key=lambda p: p.stat().st_mtime)
    if not found:
        raise ConfigError(f"there is no run of '{name}' under runs/ to resume", "start one without --resume")
    return found[-1].parent


def read_json(path: Path) -> Any:
    """The file's content, or None where there is no such file. Raises ConfigError on a broken one."""
    if not path.exists():
        return None
    try:
        return json.loads(path.read_text())
    except ValueError as error:
        raise ConfigError(f"{path} is no valid JSON: {error}", "remove it, or start a new run") from None


def write_json(path: Path, data: Any) -> None:
    """Write beside and rename."""
    beside = path.with_name(path.name + ".part")
    beside.write_text(json.dumps(data, indent=2, sort_keys=True) + "\n")
    beside.replace(path)


def check_folder(path: Path, of: Path | None = None) -> None:
    """Make the folder `path`, a part of `of`, and be sure that files can be written to it. Raises ConfigError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise ConfigError(f"cannot write to {of or path}: {error.strerror}", "give another folder with --out") from None


def check_writable(path: Path) -> None:
    """Make sure before long work that its results can be written to the file `path`. Raises ConfigError."""
    beside = path.with_name(path.name + ".part")
    try:
        if path.is_dir():
            raise IsADirectoryError(0, "it is a folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        beside.touch()
        beside.unlink()
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}", "give another file") from None


def git_hash() -> str:
    """The commit of the code that runs, '+' where it has changes; 'unknown' outside a checkout."""
    here = Path(__file__).parent
    try:
        head = subprocess.run(
            ["git", "rev-parse", "--short=12", "HEAD"], cwd=here, capture_output=True, text=True, timeout=5
        )
        dirty = subprocess.run(
            ["git", "status", "--porcelain", "-uno"], cwd=here, capture_output=True, text=True, timeout=5
        )
    except (OSError, subprocess.TimeoutExpired):
        return "unknown"
    return head.stdout.strip() + ("+" if dirty.stdout.strip() else "") if head.returncode == 0 else "unknown"
