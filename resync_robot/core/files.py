"""Files that are read and written by name: UTF-8 whatever the locale, whole or not at all.

Every command reads and writes through here, so that a full disk, a kill or a mistyped name costs nobody a file.
"""

from __future__ import annotations

import errno
import json
import os
import secrets
import shutil
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, BinaryIO

from resync_robot.core.errors import ConfigError, DiskError, ResyncError

DISK_FAULTS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO, errno.ESTALE)
"""What the system says of a disk that is full, read-only, failing or gone."""


@dataclass(frozen=True)
class FileKind:
    """A kind of file that a command writes.

    Attributes:
        title: as a message names it, such as "a Rerun recording".
        suffix: of such files, with the dot.
        recognise: whether this file, open at its beginning, is of this kind.
    """

    title: str
    suffix: str
    recognise: Callable[[BinaryIO], bool]


def starting_with(title: str, suffix: str, *magic: bytes, containing: bytes = b"") -> FileKind:
    """The kind of files that begin with one of these bytes, and contain others somewhere."""

    def recognise(file: BinaryIO) -> bool:
        return file.read(max(map(len, magic))).startswith(magic) and (not containing or containing in file.read())

    return FileKind(title, suffix, recognise)


def with_tables(title: str, suffix: str, parse: Callable[[str], Any], *names: str) -> FileKind:
    """The kind of text files that `parse`, of JSON or TOML, reads as a table that has these names."""

    def recognise(file: BinaryIO) -> bool:
        try:
            table = parse(file.read().decode("utf-8-sig"))
        except (ValueError, RecursionError):
            return False
        return isinstance(table, dict) and set(names) <= set(table)

    return FileKind(title, suffix, recognise)


MCAP = starting_with("an MCAP recording", ".mcap", b"\x89MCAP0\r\n")
RRD = starting_with("a Rerun recording", ".rrd", b"RRF")
PDDL = starting_with("a PDDL text that this program wrote", ".pddl", b"(define")
MP4 = FileKind("an MP4 film", ".mp4", lambda file: file.read(8)[4:] == b"ftyp")
WEBP = FileKind("a WebP picture", ".webp", lambda file: file.read(12)[8:] == b"WEBP")
JPEG = starting_with("a JPEG picture", ".jpg", b"\xff\xd8\xff")
PNG = starting_with("a PNG picture", ".png", b"\x89PNG\r\n\x1a\n")
FIGURE = starting_with(
    "a figure that this program drew", ".png", b"\x89PNG\r\n\x1a\n", containing=b"Software\0resync-robot"
)
REPORT = with_tables("a report that this program wrote", ".json", json.loads, "provenance", "rows", "summary")
RIG = with_tables("a rig file", ".toml", tomllib.loads, "arm", "gripper", "cameras")

EMULATED = "emulated"
"""Name of the rig whose file comes with this package."""


def packaged_rig(name: str) -> Path | None:
    """Where the rig file lies that comes with this package by that name; None where none does, or a file here has it.

    There is one, "emulated": hardware/emulated.toml of a checkout.
    """
    if name != EMULATED or Path(name).exists():
        return None
    return Path(str(files("resync_robot.hardware").joinpath("emulated.toml")))


def read_text(path: Path) -> str:
    """The text of a UTF-8 file, with or without a byte order mark, line ends as they are read from any system.

    Raises:
        OSError, UnicodeDecodeError.
    """
    return path.read_text(encoding="utf-8-sig")


def check_output(path: Path, kind: FileKind, inputs: Sequence[Path | None] = (), option: str = "--out") -> None:
    """Refuse to write `path` where that would fail or cost a file that somebody keeps, before any work is done.

    Its folder is made.

    Args:
        kind: what will be written; an existing file of this kind, or an empty one, may be replaced.
        inputs: files that are read; none of them is ever written, by whatever name or link.
        option: the option that gave the name, for the message.

    Raises:
        ConfigError: it is one of the inputs, a folder, or a file of another kind, or cannot be written.
        DiskError: there is no room for it.
    """
    for read in inputs:
        if read is not None and _same(path, read):
            raise ConfigError(
                f"{option} {path} is the file that is read ({read})", f"give another name, such as {_other(path, kind)}"
            )
    try:
        if path.is_dir():
            raise ConfigError(f"{option} {path} is a folder", f"name a file in it: {path / f'NAME{kind.suffix}'}")
        if path.exists() and not path.is_file():
            return  # A device such as /dev/null keeps nothing.
        if path.exists():
            if not os.access(path, os.W_OK):
                raise PermissionError(errno.EACCES, "it is write-protected")
            with path.open("rb") as file:
                known = kind.recognise(file) or file.seek(0, os.SEEK_END) == 0
            if not known:
                raise ConfigError(
                    f"{option} {path} exists and is not {kind.title}; it is left as it is",
                    f"give another name, such as {_other(path, kind)}, or remove it",
                )
        with new_beside(path):
            pass
    except OSError as error:
        raise unwritable(f"{option} {path}", error, "give another name") from None


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A new name beside `path` to write to; renamed to `path` at the end, removed where that is not reached.

    A link stays a link: the file it points to is replaced. Permissions are those of the file that was there.
    A device, such as /dev/null, is written as it is.

    Raises:
        OSError: from the folder or the disk, with `path` as its `filename`, whatever the library that wrote made of
            it; what was there before is untouched.
    """
    if path.exists() and not path.is_file():
        yield path
        return
    target = path.resolve() if path.is_symlink() else path
    try:
        with new_beside(path) as beside:
            if target.exists():
                beside.chmod(target.stat().st_mode & 0o777)
            yield beside
            with beside.open("rb") as written:
                # Without this a power cut can leave the new name with nothing in it.
                os.fsync(written.fileno())
            beside.replace(target)
    except Exception as error:
        _name(error, path)
        raise


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """A name beside `path` for a folder to make; it takes the place of `path` at the end, or is removed.

    It is always the same name, so that what a kill leaves is gone with the next try.

    Raises:
        OSError: from the disk; what was there before is untouched.
    """
    beside, old = path.with_name(f"{path.name}.part"), path.with_name(f"{path.name}.old")
    shutil.rmtree(beside, ignore_errors=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield beside
        shutil.rmtree(old, ignore_errors=True)
        if path.exists():
            path.rename(old)
        beside.rename(path)
    except BaseException as error:
        if old.exists() and not path.exists():
            old.rename(path)
        shutil.rmtree(beside, ignore_errors=True)
        if isinstance(error, Exception):
            _name(error, path)
        raise
    shutil.rmtree(old, ignore_errors=True)


def write_text(path: Path, text: str) -> None:
    """Replace `path` by this text as UTF-8, whole or not at all. Raises OSError."""
    with whole(path) as beside:
        beside.write_text(text, encoding="utf-8")


def write_bytes(path: Path, data: bytes) -> None:
    """Replace `path` by these bytes, whole or not at all. Raises OSError."""
    with whole(path) as beside:
        beside.write_bytes(data)


def unwritable(what: object, error: OSError, fix: str, kind: type[ResyncError] = ConfigError) -> ResyncError:
    """What to raise where `what` cannot be written: a DiskError where the disk is to blame, else one of `kind`."""
    why = error.strerror or str(error)
    if error.errno in DISK_FAULTS:
        return DiskError(
            f"cannot write {what}: {why}", fix if error.errno == errno.EROFS else f"free space there, or {fix}"
        )
    return kind(f"cannot write {what}: {why}", fix)


def disk_fault(error: BaseException) -> DiskError | None:
    """The disk's fault behind this error of whatever library, None where there is none."""
    if isinstance(error, DiskError):
        return error
    code, name = _disk_code(error)
    if code is None:
        return None
    verb = "read or write" if code == errno.EIO else "write"
    fix = "look at the disk: dmesg" if code == errno.EIO else "free some space (df -h), and do the same again"
    return DiskError(f"cannot {verb} {name or 'a file'}: {os.strerror(code)}", fix)


def _disk_code(error: BaseException) -> tuple[int | None, str | None]:
    """The system's number for the disk's fault behind this error, and the file, where they are known."""
    seen: BaseException | None = error
    while seen is not None and not isinstance(seen, ResyncError):
        code = seen.errno if isinstance(seen, OSError) else None
        if code is None:
            # Libraries of other languages pass on only the system's words.
            words = str(seen).lower()
            code = next((c for c in DISK_FAULTS if c != errno.EIO and os.strerror(c).lower() in words), None)
        if code in DISK_FAULTS:
            return code, getattr(seen, "filename", None)
        seen = seen.__cause__ or seen.__context__
    return None, None


def _name(error: Exception, path: Path) -> None:
    """Let an error of the disk name the file that was to be written, and not the one beside. Raises OSError."""
    code, name = _disk_code(error)
    if code is None or not isinstance(error, OSError):
        if code is not None:
            raise OSError(code, os.strerror(code), str(path)) from error
        return
    if name is None or name.endswith(".part"):
        error.filename = str(path)


@contextmanager
def new_beside(path: Path) -> Iterator[Path]:
    """A new, empty file in the folder of what `path` is or points to; removed at the end if it is still there.

    Its folder is made. Raises OSError.
    """
    target = path.resolve() if path.is_symlink() else path
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise NotADirectoryError(errno.ENOTDIR, f"{target.parent} is no folder") from None
    # Two processes that write one file each have a name of their own; the last to finish wins. ASCII, for libraries
    # that write a name in another encoding than the locale's.
    beside = target.with_name(f".resync.{secrets.token_hex(4)}.part")
    beside.touch(exist_ok=False)
    try:
        yield beside
    finally:
        with suppress(OSError):
            beside.unlink()


def _same(a: Path, b: Path) -> bool:
    try:
        return a.samefile(b)
    except OSError:
        return a.resolve() == b.resolve()


def _other(path: Path, kind: FileKind) -> str:
    other = path.with_suffix(kind.suffix)
    return str(other if not other.exists() else path.with_name(f"{path.stem}-2{kind.suffix}"))


def read_json(path: Path) -> Any:
    """The file's content, or None where there is no such file. Raises ConfigError on a broken one."""
    if not path.exists():
        return None
    try:
        return json.loads(read_text(path))
    except ValueError as error:
        raise ConfigError(f"{path} is no valid JSON: {error}", "remove it, or start a new run") from None


def write_json(path: Path, data: Any) -> None:
    """Replace the file, whole or not at all. Raises OSError."""
    write_text(path, json.dumps(data, indent=2, sort_keys=True) + "\n")


def check_folder(path: Path, of: Path | None = None) -> None:
    """Make the folder `path`, a part of `of`, and be sure that files can be written to it.

    Raises:
        ConfigError: they cannot.
        DiskError: the same, where the disk is to blame.
    """
    try:
        with new_beside(path / "probe"):
            pass
    except OSError as error:
        raise unwritable(f"to {of or path}", error, "give another folder with --out") from None
