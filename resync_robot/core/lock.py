"""One writer at a time: a lock that names its holder, and that the kernel takes away from a process that is gone."""

from __future__ import annotations

import errno
import fcntl
import json
import logging
import os
import shlex
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from resync_robot.core.errors import ConfigError
from resync_robot.core.files import unwritable

_log = logging.getLogger(__name__)

LOCK = ".lock"
"""Name of the lock of a folder, in it."""
NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)
"""What file systems without locks answer, some network ones among them."""


@contextmanager
def sole_writer(lock: Path, of: Path, otherwise: str) -> Iterator[None]:
    """While it is entered, this process alone writes `of`.

    The lock is the kernel's (flock): a process that ends in whatever way, kill -9 too, has given it back, and a file
    that it left behind is in nobody's way. Worker processes do not hold it: they are started anew, not forked, and
    Python closes its files in them. NFS passes it on to the server (Linux 2.6.12 and later), so it holds between
    machines; where a file system has no locks there is a warning, and nothing else keeps a second writer away.

    Args:
        lock: the file to lock; made where it is missing, removed at the end. Its folder exists.
        of: what is written, for the message.
        otherwise: what to do instead of waiting, such as "give another folder with --out".

    Raises:
        ConfigError: another process holds it (the message names that), or the file cannot be made.
        DiskError: the same, where the disk is to blame.
    """
    try:
        handle = _locked(lock)
    except BlockingIOError:
        raise ConfigError(f"{of} is being written by {_holder(lock)}", f"{_wait(lock)}, or {otherwise}") from None
    except OSError as error:
        raise unwritable(f"{lock} to lock it", error, otherwise) from None
    if handle is None:
        _log.warning("%s: its file system has no locks; make sure that nothing else writes there", of)
        yield
        return
    try:
        words = {
            "pid": os.getpid(),
            "host": socket.gethostname(),
            "since": datetime.now().astimezone().isoformat(timespec="seconds"),
            "command": shlex.join(sys.argv[1:]),
        }
        with suppress(OSError):  # On a full disk it holds all the same, without a name.
            os.truncate(handle, 0)
            os.pwrite(handle, (json.dumps(words) + "\n").encode(), 0)
        yield
    finally:
        with suppress(OSError):
            lock.unlink()
        os.close(handle)


def _locked(lock: Path) -> int | None:
    """A descriptor of the locked file; None where there are no locks. Raises OSError."""
    while True:
        handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(handle), lock.stat()):
                    return handle
        except BlockingIOError:
            os.close(handle)
            raise
        except OSError as error:
            os.close(handle)
            if error.errno in NO_LOCKS:
                return None
            raise
        # Whoever held it removed it between the two calls: what is locked here is no file any more.
        os.close(handle)


def _holder(lock: Path) -> str:
    words = _words(lock)
    if not words:
        return "another process"
    return f"process {words['pid']} on {words['host']} since {words['since']} ({words['command']})"


def _wait(lock: Path) -> str:
    words = _words(lock)
    here = words.get("host") == socket.gethostname()
    return f"wait until it ends, end it (kill {words['pid']})" if here else "wait until it ends"


def _words(lock: Path) -> dict[str, str]:
    """What the holder said of itself; nothing where it has not got to it yet."""
    try:
        words = json.loads(lock.read_text(encoding="utf-8"))
        return {name: str(words[name]) for name in ("pid", "host", "since", "command")}
    except (OSError, ValueError, KeyError, TypeError):
        return {}
