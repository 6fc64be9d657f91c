"""Files that are read and written by name: UTF-8 whatever the locale, whole or not at all.

Every command reads and writes through here, so that a full disk, a kill or a mistyped name costs nobody a file.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from resync_robot.core.errors import ConfigError

HEAD_BYTES = 4096
"""How much of a file is read to tell of what kind it is."""


@dataclass(frozen=True)
class FileKind:
    """A kind of file that a command writes.

    Attributes:
        title: as a message names it, such as "a Rerun recording".
        suffix: of such files, with the dot.
        recognise: whether a file that begins with these bytes (at most HEAD_BYTES) is of this kind.
    """

    title: str
    suffix: str
    recognise: Callable[[bytes], bool]


def starting_with(title: str, suffix: str, *magic: bytes) -> FileKind:
    """The kind of files that begin with one of these bytes."""
    return FileKind(title, suffix, lambda head: head.startswith(magic))


MCAP = starting_with("an MCAP recording", ".mcap", b"\x89MCAP0\r\n")
RRD = starting_with("a Rerun recording", ".rrd", b"RRF")
PDF = starting_with("a PDF", ".pdf", b"%PDF-")
PNG = starting_with("a PNG picture", ".png", b"\x89PNG\r\n\x1a\n")


def read_text(path: Path) -> str:
    """The text of a UTF-8 file, with or without a byte order mark, line ends as they are read from any system.

    Raises:
        OSError, UnicodeDecodeError.
    """
    return path.read_text(encoding="utf-8-sig")


def check_output(path: Path, kind: FileKind, inputs: Sequence[Path] = (), option: str = "--out") -> None:
    """Refuse to write `path` where that would cost a file that somebody keeps, before any work is done.

    Args:
        kind: what will be written; an existing file of this kind, or an empty one, may be replaced.
        inputs: files that are read; none of them is ever written, by whatever name or link.
        option: the option that gave the name, for the message.

    Raises:
        ConfigError: it is one of the inputs, a folder, or a file of another kind.
    """
    for read in inputs:
        if _same(path, read):
            raise ConfigError(
                f"{option} {path} is the file that is read ({read})", f"give another name, such as {_other(path, kind)}"
            )
    if path.is_dir():
        raise ConfigError(f"{option} {path} is a folder", f"name a file in it: {path / f'NAME{kind.suffix}'}")
    if path.exists() and not path.is_file():
        return  # A device such as /dev/null or /dev/stdout keeps nothing.
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except FileNotFoundError:
        return
    except OSError as error:
        raise ConfigError(f"cannot write {option} {path}: {error.strerror}", "give another name") from None
    if head and not kind.recognise(head):
        raise ConfigError(
            f"{option} {path} exists and is not {kind.title}; it is left as it is",
            f"give another name, such as {_other(path, kind)}, or remove it",
        )


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A new name beside `path` to write to; renamed to `path` at the end, removed where that is not reached.

    A link stays a link: the file it points to is replaced. Permissions are those of the file that was there.

    Raises:
        OSError: from the folder or the disk; what was there before is untouched.
    """
    target = path.resolve() if path.is_symlink() else path
    target.parent.mkdir(parents=True, exist_ok=True)
    # Two processes that write one file each have a name of their own; the last to finish wins.
    beside = target.with_name(f".{target.name}.{secrets.token_hex(4)}.part")
    beside.touch(exist_ok=False)
    try:
        if target.exists():
            beside.chmod(target.stat().st_mode & 0o777)
        yield beside
        with beside.open("rb") as written:
            # Without this a power cut can leave the new name with nothing in it.
            os.fsync(written.fileno())
        beside.replace(target)
    except BaseException:
        with suppress(OSError):
            beside.unlink()
        raise


def write_text(path: Path, text: str) -> None:
    """Replace `path` by this text as UTF-8, whole or not at all. Raises OSError."""
    with whole(path) as beside:
        beside.write_text(text, encoding="utf-8")


def write_bytes(path: Path, data: bytes) -> None:
    """Replace `path` by these bytes, whole or not at all. Raises OSError."""
    with whole(path) as beside:
        beside.write_bytes(data)


def _same(a: Path, b: Path) -> bool:
    try:
        return a.samefile(b)
    except OSError:
        return a.resolve() == b.resolve()


def _other(path: Path, kind: FileKind) -> str:
    other = path.with_suffix(kind.suffix)
    return str(other if not other.exists() else path.with_name(f"{path.stem}-2{kind.suffix}"))
