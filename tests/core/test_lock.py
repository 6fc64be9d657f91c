"""One writer at a time: the other is named, and a process that is gone is in nobody's way."""

from __future__ import annotations

import errno
import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest

from resync_robot.core.errors import ConfigError
from resync_robot.core.lock import LOCK, sole_writer

HOLD = """
import sys, time
from multiprocessing import get_context
from pathlib import Path

from resync_robot.core.lock import sole_writer

if __name__ == "__main__":
    path = Path(sys.argv[1])
    with sole_writer(path / ".lock", path, "go away"):
        workers = [get_context("forkserver").Process(target=time.sleep, args=(60,)) for _ in range(2)]
        for worker in workers:
            worker.start()
        print(*(w.pid for w in workers), flush=True)
        time.sleep(60)
"""


def test_the_holder_is_named_and_the_lock_leaves_nothing_behind(tmp_path: Path) -> None:
    with (
        sole_writer(tmp_path / LOCK, tmp_path, "give another"),
        pytest.raises(ConfigError, match=f"{tmp_path} is being written by process {os.getpid()} on ") as caught,
        sole_writer(tmp_path / LOCK, tmp_path, "give another"),
    ):
        pytest.fail("two hold it")
    assert f"kill {os.getpid()}" in caught.value.fix and caught.value.fix.endswith("or give another")
    assert list(tmp_path.iterdir()) == []
    with sole_writer(tmp_path / LOCK, tmp_path, ""):
        pass


def test_an_error_inside_gives_it_back(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), sole_writer(tmp_path / LOCK, tmp_path, ""):
        raise KeyboardInterrupt
    with sole_writer(tmp_path / LOCK, tmp_path, ""):
        pass


def test_a_killed_process_gives_it_back_though_its_workers_live_on(tmp_path: Path) -> None:
    script, folder = tmp_path / "hold.py", tmp_path / "run"
    script.write_text(HOLD)
    folder.mkdir()
    run = subprocess.Popen([sys.executable, str(script), str(folder)], stdout=subprocess.PIPE, text=True)
    assert run.stdout is not None
    workers = [int(w) for w in run.stdout.readline().split()]
    try:
        assert len(workers) == 2
        with pytest.raises(ConfigError, match=f"process {run.pid} "), sole_writer(folder / LOCK, folder, ""):
            pytest.fail("two hold it")
        run.kill()
        run.wait()
        for worker in workers:
            os.kill(worker, 0)  # It is there.
        with sole_writer(folder / LOCK, folder, ""):
            pass
    finally:
        run.kill()
        for worker in workers:
            try:
                os.kill(worker, 9)
            except ProcessLookupError:
                continue


def test_a_lock_without_a_name_in_it_is_held_all_the_same(tmp_path: Path) -> None:
    with (tmp_path / LOCK).open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with (
            pytest.raises(ConfigError, match="is being written by another process"),
            sole_writer(tmp_path / LOCK, tmp_path, ""),
        ):
            pytest.fail("two hold it")


def test_of_many_that_want_it_at_once_one_at_a_time_gets_it(tmp_path: Path) -> None:
    """Each that gets it adds one to the number that it read; none is lost, though the lock's file comes and goes."""
    script = tmp_path / "add.py"
    script.write_text(
        "import sys, time\n"
        "from pathlib import Path\n"
        "from resync_robot.core.errors import ConfigError\n"
        "from resync_robot.core.lock import sole_writer\n"
        "number, done = Path(sys.argv[1]), 0\n"
        "while done < 30:\n"
        "    try:\n"
        "        with sole_writer(number.with_name('.lock'), number, ''):\n"
        "            value = int(number.read_text())\n"
        "            time.sleep(0.0005)\n"
        "            number.write_text(str(value + 1))\n"
        "            done += 1\n"
        "    except ConfigError:\n"
        "        time.sleep(0.0002)\n"
    )
    number = tmp_path / "number"
    number.write_text("0")
    runs = [subprocess.Popen([sys.executable, str(script), str(number)]) for _ in range(4)]
    assert [run.wait(60) for run in runs] == [0] * 4
    assert number.read_text() == "120"


def test_a_file_system_without_locks_is_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def none(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", none)
    with sole_writer(tmp_path / LOCK, tmp_path, ""):
        pass
    assert "has no locks" in caplog.text


@pytest.mark.parametrize("how", ["folder", "nowhere"])
def test_a_lock_that_cannot_be_made_is_a_clear_error(tmp_path: Path, how: str) -> None:
    lock = tmp_path / "missing" / LOCK if how == "nowhere" else tmp_path / LOCK
    if how == "folder":
        lock.mkdir()
    words = "cannot write .* to lock it"
    with pytest.raises(ConfigError, match=words) as caught, sole_writer(lock, tmp_path, "name another"):
        pytest.fail("it is held")
    assert caught.value.fix == "name another"
