"""Episodes in several processes, results in order, so that the outcome does not depend on who was faster."""

from __future__ import annotations

import multiprocessing as mp
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, TypeVar

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
    with ProcessPoolExecutor(workers, mp.get_context("forkserver"), _start, (make_context,)) as pool:
        pending = [pool.submit(_call, function, item) for item in items]
        try:
            for future in pending:
                yield future.result()
        finally:
            for future in pending:
                future.cancel()


def _start(make_context: Callable[[], Any]) -> None:
    global _context
    import torch

    torch.set_num_threads(1)
    _context = make_context()


def _call(function: Callable[[Any, Item], Result], item: Item) -> Result:
    return function(_context, item)
