"""Writes calibrated values into a rig file and leaves everything else in it, comments too, as its owner wrote it."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import asdict
from importlib.resources import files
from itertools import chain, count, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from resync_robot.core import spatial
from resync_robot.core.calibration_record import CalibrationRecord
from resync_robot.core.errors import ConfigError
from resync_robot.core.files import read_text, unwritable, whole, write_bytes
from resync_robot.core.rig import load_rig
from resync_robot.core.sensor_noise import SensorNoise


def update_rig(
    source: Path | None,
    target: Path,
    camera: str,
    values: Mapping[str, Any],
    record: CalibrationRecord | None = None,
    noise: SensorNoise | None = None,
) -> None:
    """Write `target`: the rig file `source` (None: the built-in one) with another camera entry.

    The result is read back and compared before anything is replaced; an older `target` is kept as `target.bak`, or as
    `target.bak-2` and so on where there are such files. A link stays one, and what it points to is written.

    Args:
        values: fields of the camera; `pose` as a (4, 4) matrix, the others numbers.
        record, noise: take the place of earlier ones; None leaves those.

    Raises:
        ConfigError: the file is written in an unusual way, or cannot be written.
        DiskError: there is no room for it; nothing has changed.
    """
    tables = {name: table for name, table in (("calibration", record), ("noise", noise)) if table is not None}
    edited = _edit(_text(source), camera, values, tables)
    _replace(target, edited, lambda written: _compare(written, source, camera, values, tables))


def update_hues(source: Path | None, target: Path, hues: Mapping[str, float]) -> None:
    """Write `target`: the rig file `source` (None: the built-in one) with these under `[hues]`; other names there stay.

    Read back and kept as by `update_rig`.

    Raises:
        ConfigError: the file is written in an unusual way, or cannot be written; or a name that TOML has no word for.
    """
    for name in hues:
        if not re.fullmatch(r"[A-Za-z0-9_-]+", name):
            raise ConfigError(f"{name!r} is no name for a thing", "use letters, digits, _ and -")
    lines = _lines(_text(source))
    heads = [i for i, line in enumerate(lines) if re.match(r"\s*\[\s*hues\s*\]", line)]
    begin = heads[0] if heads else len(lines)
    end = next((i for i in range(begin + 1, len(lines)) if re.match(r"\s*\[", lines[i])), len(lines))
    own = _without_blank_end(lines[begin:end]) or ["", "[hues]"]
    rounded = {name: round(hue, 4) % 1.0 for name, hue in hues.items()}
    written = {name: f"{name} = {hue:.4f}" for name, hue in rounded.items()}
    for i, line in enumerate(own):
        known = re.match(r"\s*[\"']?([A-Za-z0-9_-]+)[\"']?\s*=", line)
        if known and known[1] in written:
            comment = re.search(r"\s*#.*$", line)
            own[i] = written.pop(known[1]) + (comment.group() if comment else "")
    edited = "\n".join([*lines[:begin], *own, *written.values(), "", *lines[end:]]).rstrip() + "\n"

    def compare(beside: Path) -> None:
        read = load_rig(beside)
        before, after = tomllib.loads(_text(source)), tomllib.loads(read_text(beside))
        wanted = {**before.pop("hues", {}), **rounded}
        if read.hues != wanted or after | {"hues": wanted} != before | {"hues": wanted}:
            raise ConfigError("the rig file is written in a way in which [hues] cannot be changed", "write [hues] last")

    _replace(target, edited, compare)


def _text(source: Path | None) -> str:
    if source is None:
        return files("resync_robot.core").joinpath("simulated_rig.toml").read_text(encoding="utf-8")
    return read_text(source)


def _lines(text: str) -> list[str]:
    """As TOML counts them: other signs that end lines elsewhere may stand in a comment."""
    return text.rstrip("\n").split("\n")


def _replace(target: Path, text: str, check: Callable[[Path], None]) -> None:
    """Write beside, check that, and put it in place; what was there is kept. Raises ConfigError or DiskError."""
    try:
        with whole(target) as beside:
            beside.write_text(text, encoding="utf-8")
            check(beside)
            if target.exists():
                _keep(target)
    except OSError as error:
        raise unwritable(target, error, "give another file with --write") from None


def _keep(target: Path) -> None:
    """A copy of it as it was, under the first name that is free. Raises OSError."""
    data = target.read_bytes()
    names = (f"{target.name}.bak{n}" for n in chain([""], (f"-{i}" for i in count(2))))
    copy = next(path for path in map(target.with_name, names) if not os.path.lexists(path))
    write_bytes(copy, data)


def pose_text(pose: np.ndarray) -> str:
    """(4, 4) as the rig file has it: x y z (m) and a quaternion w x y z."""
    numbers = spatial.features_from_pose(pose)
    return "[" + ", ".join([*(f"{v:.6f}" for v in numbers[:3]), *(f"{v:.8f}" for v in numbers[3:])]) + "]"


def _edit(text: str, camera: str, values: Mapping[str, Any], tables: Mapping[str, Any]) -> str:
    lines = _lines(text)
    begin, end = _camera_lines(lines, camera)
    # A sub-table of this camera begins its own section.
    heads = [i for i in range(begin + 1, end) if re.match(r"\s*\[", lines[i])]
    own = lines[begin : heads[0] if heads else end]
    sections = [lines[i:j] for i, j in pairwise([*heads, end])]
    for name, value in values.items():
        shown = pose_text(value) if name == "pose" else f"{value:.6g}"
        places = [i for i, line in enumerate(own) if re.match(rf"\s*{name}\s*=", line)]
        if len(places) != 1:
            raise ConfigError(f"the entry of camera '{camera}' has no line '{name} = ...' of its own", "write it so")
        comment = re.search(r"\s*#[^\"\]]*$", own[places[0]])
        own[places[0]] = f"{name} = {shown}{comment.group() if comment else ''}"
    for name, table in tables.items():
        sections = [s for s in sections if not re.match(rf"\s*\[\s*cameras\s*\.\s*{name}\s*\]", s[0])]
        sections.append(
            [
                f"[cameras.{name}]",
                *(f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v:.4g}" for k, v in asdict(table).items()),
            ]
        )
    written = [line for section in [own, *sections] for line in [*_without_blank_end(section), ""]]
    return "\n".join([*lines[:begin], *written, *lines[end:]]).rstrip() + "\n"


def _without_blank_end(lines: list[str]) -> list[str]:
    last = max((i for i, line in enumerate(lines) if line.strip()), default=-1)
    return lines[: last + 1]


def _camera_lines(lines: list[str], camera: str) -> tuple[int, int]:
    """[begin, end) of the `[[cameras]]` entry of that name, its sub-table included."""
    starts = [i for i, line in enumerate(lines) if re.match(r"\s*\[\[\s*cameras\s*\]\]", line)]
    for begin in starts:
        end = begin + 1
        while end < len(lines) and not re.match(r"\s*\[(?!\s*cameras\s*\.)", lines[end]):
            end += 1
        if any(re.match(rf"\s*name\s*=\s*[\"']{re.escape(camera)}[\"']", line) for line in lines[begin:end]):
            return begin, end
    raise ConfigError(f'the rig file has no [[cameras]] entry with a line name = "{camera}"', "write it so")


def _compare(
    written: Path, source: Path | None, camera: str, values: Mapping[str, Any], tables: Mapping[str, Any]
) -> None:
    before, after = load_rig(source).camera(camera), load_rig(written).camera(camera)
    for name in ("pose", "fx", "fy", "cx", "cy", "position_sigma", "rotation_sigma"):
        wanted = values.get(name, getattr(before, name))
        if not np.allclose(getattr(after, name), wanted, rtol=1e-4, atol=1e-6):
            raise ConfigError(f"the rig file is written in a way in which '{name}' of '{camera}' cannot be changed")
    for name, wanted in tables.items():
        found = getattr(after, name)
        if found is None or any(not _same(getattr(found, k), v) for k, v in asdict(wanted).items()):
            raise ConfigError(f"the rig file is written in a way to which no [cameras.{name}] can be added")
    for name in {"calibration", "noise"} - set(tables):
        if getattr(after, name) != getattr(before, name):
            raise ConfigError(f"the rig file is written in a way in which [cameras.{name}] would be lost")


def _same(found: Any, wanted: Any) -> bool:
    return found == wanted if isinstance(wanted, str) else bool(np.isclose(found, wanted, rtol=1e-3))
