"""Episodes in several processes, results in order, so that the outcome does not depend on who was faster."""

from __future__ import annotations

import multiprocessing as mp
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

from resync_robot.core.files import disk_fault

Item = TypeVar("Item")
Result = TypeVar("Result")

_context: Any = None


def parallel_map(
    function: Callable[[Any, Item], Result], items: Sequence[Item], make_context: Callable[[], Any], workers: int
) -> Iterator[Result]:
    """`function(context, item)` for every item, in order.

    Args:
        make_context: builds what every call needs (models, skills); run once in each process, must be picklable.
        workers: processes; 0 or 1 runs everything here.
    """
    if workers <= 1:
        context = make_context()
        for item in items:
            yield function(context, item)
        return
    # OpenMP threads of two processes on two cores make each other ten times slower.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    others = set(mp.active_children())
    pool = ProcessPoolExecutor(workers, mp.get_context("forkserver"), _start, (make_context,))
    try:
        for future in [pool.submit(_call, function, item) for item in items]:
            yield future.result()
    except BaseException:
        # Nobody wants what they are still at, which may take minutes.
        for worker in set(mp.active_children()) - others:
            worker.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _start(make_context: Callable[[], Any]) -> None:
    global _context
    # A Ctrl-C at the terminal is for the parent, which ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import torch

    threading.Thread(target=_leave_with_parent, daemon=True).start()
    torch.set_num_threads(1)
    try:
        _context = make_context()
    except Exception as error:
        # Raised here it would only break the pool; raised by a call it reaches who asked.
        _context = _Failed(error)


def _leave_with_parent() -> None:
    """A worker waits for work on a pipe that it holds open itself, so it would outlive a parent that was killed."""
    parent = mp.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@dataclass(frozen=True)
class _Failed:
    """In place of a context that could not be made."""

    error: Exception


def _call(function: Callable[[Any, Item], Result], item: Item) -> Result:
    if isinstance(_context, _Failed):
        raise _context.error
    try:
        return function(_context, item)
    except Exception as error:
        # In our own words: errors of some libraries do not survive the way to another process.
        fault = disk_fault(error)
        if fault is None:
            raise
        raise fault from None
