"""Progress bars for long work: one line a stage, with the figure that matters."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from resync_robot.core.findings import Finding

_console = Console(stderr=True, highlight=False)


def say(text: str) -> None:
    """A line of a report, on standard output."""
    Console(highlight=False, soft_wrap=True, markup=False).print(text)


def show_findings(findings: Sequence[Finding], width: int = 9) -> None:
    """A line of each, on standard output, its name in so many letters, and below it what mends it."""
    console = Console(highlight=False, soft_wrap=True)
    colour = {"ok": "green", "warn": "yellow", "fail": "red"}
    for f in findings:
        console.print(f"[{colour[f.status]}]{f.status:<4}[/] {escape(f.name):<{width}} {escape(f.detail)}")
        if f.fix:
            console.print(f"{'':{width + 6}}-> {escape(f.fix)}")


class Stages:
    """Named stages, shown as they run. Where output is no terminal, a line at each tenth instead of a bar."""

    def __init__(self, names: Sequence[str]) -> None:
        self._width = max(map(len, names))
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[figure]}"),
            console=_console,
            disable=not _console.is_terminal,
        )

    def __enter__(self) -> Stages:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    @contextmanager
    def stage(self, name: str) -> Iterator[Callable[[float, str], None]]:
        """Yields `progress(share done, figure)`."""
        task = self._bars.add_task(name.ljust(self._width), total=1.0, figure="")
        told = -1

        def progress(share: float, figure: str) -> None:
            nonlocal told
            self._bars.update(task, completed=min(share, 1.0), figure=figure)
            if not _console.is_terminal and int(share * 10) > told:
                told = int(share * 10)
                _console.print(f"{name}: {100 * min(share, 1.0):.0f} %  {figure}", soft_wrap=True)

        yield progress
        self._bars.update(task, completed=1.0)
