"""Work in several processes gives what it gives in one: same results, same order, same errors."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from resync_robot.core.errors import DiskError, LibraryError, UnknownNameError
from resync_robot.sim_training.parallel import parallel_map


def ten() -> int:
    return 10


def no_library() -> int:
    raise LibraryError("there is none", "train one")


def times(context: int, item: int) -> int:
    # Those that come first take longest, so that order by finishing would show.
    time.sleep(0.02 * (5 - item))
    if item < 0:
        raise UnknownNameError("number", str(item), ["0", "1"])
    return context * item


class OfALibrary(Exception):
    """It cannot be rebuilt from its message, so it does not survive the way to another process."""

    def __init__(self, file: str, code: int) -> None:
        super().__init__(f"{file}: {os.strerror(code)}")


def write_to_a_full_disk(context: int, item: int) -> None:
    raise OfALibrary("a.mp4", errno.ENOSPC)


def test_a_full_disk_of_a_worker_is_one_of_ours() -> None:
    with pytest.raises(DiskError, match="No space left"):
        list(parallel_map(write_to_a_full_disk, [1], ten, 2))


def process(context: int, item: int) -> int:
    return os.getpid()


@pytest.mark.parametrize("workers", [0, 1, 2])
def test_results_come_in_order_and_an_error_after_those_before_it(workers: int) -> None:
    results = parallel_map(times, [0, 1, 2, -1, 3], ten, workers)
    assert [next(results) for _ in range(3)] == [0, 10, 20]
    with pytest.raises(UnknownNameError, match="unknown number '-1'"):
        next(results)


def test_nothing_to_do_gives_nothing() -> None:
    assert list(parallel_map(times, [], ten, 0)) == []


@pytest.mark.slow
def test_one_worker_is_this_process_and_two_are_others() -> None:
    assert set(parallel_map(process, [0], ten, 1)) == {os.getpid()}
    assert os.getpid() not in set(parallel_map(process, [0, 1], partial(int, "7"), 2))


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_a_context_that_cannot_be_made_says_why(workers: int) -> None:
    with pytest.raises(LibraryError, match="there is none"):
        list(parallel_map(times, [1, 2], no_library, workers))


ENDLESS = """
import os, time
from functools import partial
from resync_robot.sim_training.parallel import parallel_map

def work(context, item):
    print(os.getpid(), flush=True)
    time.sleep(0.2)

if __name__ == "__main__":
    list(parallel_map(work, range(1000), partial(int, 1), 2))
"""


@pytest.mark.slow
def test_workers_do_not_outlive_a_parent_that_was_killed(tmp_path: Path) -> None:
    script = tmp_path / "endless.py"
    script.write_text(ENDLESS)
    run = subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": str(Path.cwd())}
    )
    workers: set[int] = set()
    while len(workers) < 2:
        workers.add(int(run.stdout.readline()))
    run.kill()
    run.wait()
    run.stdout.close()
    try:
        deadline = time.monotonic() + 20
        while left := {w for w in workers if alive(w)}:
            assert time.monotonic() < deadline, f"{left} still run"
            time.sleep(0.1)
    finally:
        for worker in filter(alive, workers):
            os.kill(worker, signal.SIGKILL)


LONG = """
import os, sys, time
from functools import partial
from resync_robot.signals import raised
from resync_robot.sim_training.parallel import parallel_map

def work(context, item):
    print(os.getpid(), flush=True)
    time.sleep(120.0)

if __name__ == "__main__":
    try:
        with raised():
            list(parallel_map(work, range(1000), partial(int, 1), 2))
    except KeyboardInterrupt as end:
        print(end, file=sys.stderr)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "everybody"), [(signal.SIGTERM, False), (signal.SIGINT, True)], ids=["kill", "Ctrl-C at a terminal"]
)
def test_workers_are_not_waited_for_when_somebody_ends_the_program(
    tmp_path: Path, number: signal.Signals, everybody: bool
) -> None:
    script = tmp_path / "long.py"
    script.write_text(LONG)
    run = subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": str(Path.cwd())}, start_new_session=True,
    )  # fmt: skip
    try:
        workers = {int(run.stdout.readline()) for _ in range(2)}
        (os.killpg if everybody else os.kill)(run.pid, number)
        words = run.communicate(timeout=60)[1]
    finally:
        run.kill()
    assert words == ("interrupted by Ctrl-C\n" if everybody else "ended by SIGTERM\n")
    assert not any(map(alive, workers))


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False
