"""Files that are not what was once written: what is wrong with one, in a sentence that names it and its mend.

Whoever reads what an earlier part of a run left does it inside `reading(path)`, and checks what it found there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from resync_robot.core.errors import ResyncError, TrainingError

AGAIN = "remove it, and add --resume"
POINTER = b"version https://git-lfs.github.com/spec/"
PULL = "fetch the files themselves: git lfs install && git lfs pull"
LONGEST = 200
"""Characters of another package's complaint that are passed on."""


def is_pointer(data: bytes) -> bool:
    """Is this what Git LFS leaves in place of a file that was not fetched?"""
    return data.startswith(POINTER)


def read_head(path: Path, size: int = len(POINTER)) -> bytes:
    """The first bytes of a file; none where it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(size)
    except OSError:
        return b""


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Around all that is read from the stage file or folder `path` and made of it: whatever goes wrong is its fault.

    Decoders of many packages see these files, and what each raises over damage is documented nowhere, so this takes
    any exception for it; the traceback stays in the cause.

    Raises:
        TrainingError: names the file, what is wrong with it, and that the stage can be done again.
    """
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:
        if is_pointer(read_head(path)):
            raise TrainingError(f"{path} is a Git LFS pointer and not the file itself", f"{PULL}; or {AGAIN}") from None
        words = _complaint(error)
        raise TrainingError(
            words if words.startswith(str(path)) else f"{path} cannot be used: {words}", AGAIN
        ) from error


def _complaint(error: Exception) -> str:
    if isinstance(error, ResyncError):
        words = error.what
    elif isinstance(error, KeyError):
        words = f"it has no {error}"
    elif isinstance(error, OSError) and error.strerror:
        words = error.strerror
    else:
        words = str(error) or type(error).__name__
    words = " ".join(words.split())
    return words if len(words) <= LONGEST else f"{words[:LONGEST]}..."


def check_folder_kind(path: Path) -> None:
    """Raises TrainingError where something else than a folder lies at `path`; nothing at all is fine."""
    with reading(path):
        if path.exists() and not path.is_dir():
            raise ValueError("it should be a folder")


Shape = type | tuple["Shape", ...] | list["Shape"] | Mapping[str, "Shape"]
"""What plain data should look like: a type, one of several, a list of one kind, or fields by name (more are fine).

`float` also takes whole numbers, `int` takes no truth values; numbers are finite.
"""


def check_shape(data: Any, shape: Shape, where: str = "") -> None:
    """Raises ValueError where `data` from a JSON file does not have this shape; the message names the place."""
    here = f"'{where}'" if where else "it"
    if isinstance(shape, Mapping):
        if not isinstance(data, dict):
            raise ValueError(f"{here} is {_shown(data)}, and should be an object with the fields {', '.join(shape)}")
        for name, inner in shape.items():
            if name not in data:
                raise ValueError(f"{here} has no field '{name}'")
            check_shape(data[name], inner, f"{where}.{name}" if where else name)
    elif isinstance(shape, list):
        if not isinstance(data, list):
            raise ValueError(f"{here} is {_shown(data)}, and should be a list")
        for i, value in enumerate(data):
            check_shape(value, shape[0], f"{where}[{i}]")
    else:
        kinds = shape if isinstance(shape, tuple) else (shape,)
        if not any(_is(data, kind) for kind in kinds):
            names = " or ".join(getattr(kind, "__name__", str(kind)) for kind in kinds)
            raise ValueError(f"{here} is {_shown(data)}, and should be of type {names}")


def _is(data: Any, kind: Any) -> bool:
    if kind is float:
        # The difference is none for a number, and no number for infinities.
        return isinstance(data, int | float) and not isinstance(data, bool) and data - data == 0
    if kind is int:
        return isinstance(data, int) and not isinstance(data, bool)
    return isinstance(data, kind)


def _shown(data: Any) -> str:
    words = repr(data)
    return words if len(words) <= 40 else f"{words[:40]}..."
