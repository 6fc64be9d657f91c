"""The JSON file of an evaluation: what is finished is kept as it goes, and an unfinished one can be gone on with."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from resync_robot.core.damage import check_shape
from resync_robot.core.errors import ConfigError
from resync_robot.core.files import REPORT, check_output, read_json, write_json
from resync_robot.core.lock import sole_writer

_log = logging.getLogger(__name__)

Job = TypeVar("Job")
Row = TypeVar("Row")

KEEP_EVERY_S = 60.0
ANOTHER = "name another file with --json"


@dataclass(kw_only=True)
class ResultFile(Generic[Job, Row]):
    """What becomes of an evaluation's jobs, and the file that holds it, if any.

    Attributes:
        path: of the file; None: nothing is kept.
        jobs: all that are to be done.
        rows: name of the list in the file that holds a row for each job done.
        settings: what decides how a row comes out, part of the file's provenance; rows that were made with others are
            never mixed with these.
        more: what else the provenance says, such as how much was asked for.
        inputs: files that are read, where they are named; none of them is ever written.
        report: from the rows, in the order of their jobs, all that the file holds beside its provenance.
        parse: a job and its row from an entry of the list; raises KeyError, TypeError or ValueError on another thing.
    """

    path: Path | None
    jobs: Sequence[Job]
    rows: str
    settings: Mapping[str, Any]
    more: Mapping[str, Any]
    inputs: Sequence[Path | None]
    report: Callable[[list[Row]], Mapping[str, Any]]
    parse: Callable[[Any], tuple[Job, Row]]

    def __post_init__(self) -> None:
        self.done: dict[Job, Row] = {}
        self._kept = time.monotonic()

    @property
    def todo(self) -> list[Job]:
        return [job for job in self.jobs if job not in self.done]

    @property
    def found(self) -> list[Row]:
        """The rows so far, in the order of their jobs."""
        return [self.done[job] for job in self.jobs if job in self.done]

    @contextmanager
    def open(self, resume: bool) -> Iterator[None]:
        """Hold the file, take over what it has with `resume`, and write it in the end, however that comes.

        Raises:
            DiskError: there is no room for it.
            ConfigError: it cannot be written, is an input or no such report, another process writes it, it is
                unfinished and `resume` is not set, or it holds what this evaluation would not.
        """
        if self.path is None:
            if resume:
                raise ConfigError("--resume needs the file to go on with", "name it with --json FILE")
            yield
            return
        check_output(self.path, REPORT, self.inputs, "--json")
        with ExitStack() as held:
            if self.path.is_file() or not self.path.exists():
                held.enter_context(
                    sole_writer(self.path.with_name(f".{self.path.name}.lock"), self.path, ANOTHER),
                )
            self._begin(self.path, resume)
            try:
                yield
            finally:
                if self.done or not self.jobs:
                    self._write()
                if self.todo:
                    _log.warning(
                        "%d of %d are finished and kept in %s; go on with: --resume --json %s",
                        len(self.done), len(self.jobs), self.path, self.path,
                    )  # fmt: skip

    def add(self, job: Job, row: Row) -> None:
        """One more is done. The file is written now and then, for what no process survives."""
        self.done[job] = row
        if self.path is not None and time.monotonic() - self._kept > KEEP_EVERY_S:
            self._write()

    def _write(self) -> None:
        if self.path is not None:
            provenance = {**self.settings, **self.more, "planned": len(self.jobs)}
            write_json(self.path, {"provenance": provenance, **self.report(self.found)})
            self._kept = time.monotonic()

    def _begin(self, path: Path, resume: bool) -> None:
        try:
            data = read_json(path) if path.is_file() and path.stat().st_size else None
        except ConfigError:
            if resume:
                raise ConfigError(f"{path} is damaged: no evaluation can be gone on with", "remove it") from None
            return
        if not resume:
            planned, finished = _counts(data, self.rows)
            if finished < planned:
                raise ConfigError(
                    f"{path} holds an unfinished evaluation ({finished} of {planned})",
                    f"add --resume to go on with it, remove it, or {ANOTHER}",
                )
            return
        if data is None:
            raise ConfigError(f"there is no {path} to go on with", "leave --resume out")
        try:
            check_shape(data, {"provenance": {}, self.rows: list})
            self._same(path, data["provenance"])
            self.done = dict(self.parse(entry) for entry in data[self.rows])
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigError(f"{path} does not hold an evaluation of this kind: {error}", ANOTHER) from None
        wanted = set(self.jobs)
        strange = next((job for job in self.done if job not in wanted), None)
        if strange is not None:
            raise ConfigError(
                f"{path} holds what this command does not ask for: {strange}", f"ask for that too, or {ANOTHER}"
            )

    def _same(self, path: Path, saved: Mapping[str, Any]) -> None:
        for name, mine in self.settings.items():
            if name not in saved or saved[name] != mine:
                raise ConfigError(
                    f"{path} was made with {name} {saved.get(name)!r}, this is {mine!r}; they are not mixed",
                    f"use the same, or {ANOTHER}",
                )
        if str(self.settings.get("git", "")).endswith("+"):
            _log.warning("%s: the program has uncommitted changes; whether they are the same nobody knows", path)


def _counts(data: Any, rows: str) -> tuple[int, int]:
    """Of a file's content, how many rows were planned and how many there are; (0, 0) where it is no such file."""
    try:
        check_shape(data, {"provenance": {"planned": int}, rows: list})
    except ValueError:
        return 0, 0
    return data["provenance"]["planned"], len(data[rows])
