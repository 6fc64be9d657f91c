"""Pictures of the board with the arm's pose, taken one after another, judged at once, and kept on disk."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from resync_robot.calibration.board import BoardSpec
from resync_robot.calibration.detect import BoardDetector, Rejected, Sighting
from resync_robot.calibration.propose import apart
from resync_robot.core.errors import CalibrationError, ConfigError
from resync_robot.core.files import read_text, unwritable, write_bytes, write_text

LEAST_NEWS = 0.05
"""m (turns count by `propose.TILT_WEIGHT`: 7 degrees) by which a view must differ from every other to be of use."""
LIST = "shots.json"


@dataclass(frozen=True)
class Shot:
    """One picture.

    Attributes:
        name: of its file.
        colour: (h, w, 3) uint8 RGB.
        q: (6,) rad, measured when it was taken.
        verdict: the board as found in it, or why it is of no use.
    """

    name: str
    colour: UInt8[np.ndarray, "h w 3"]
    q: Float[np.ndarray, "6"]
    verdict: Sighting | Rejected


class Judge:
    """Says of each new picture whether it helps, given those before.

    Args:
        detector: finds the board and refuses bad pictures.
        redundant: refuse views like an earlier one too.
    """

    def __init__(self, detector: BoardDetector, redundant: bool = True) -> None:
        self._detector, self._redundant = detector, redundant
        self._seen: list[tuple[str, np.ndarray]] = []

    def __call__(self, name: str, colour: UInt8[np.ndarray, "h w 3"]) -> Sighting | Rejected:
        verdict = self._detector(colour)
        if isinstance(verdict, Rejected):
            return verdict
        if self._seen and self._redundant:
            news = apart(np.stack([pose for _, pose in self._seen]), verdict.cam_T_board)
            if news.min() < LEAST_NEWS:
                like = self._seen[int(news.argmin())][0]
                return Rejected(f"redundant: the board is seen as in {like}; tilt or turn it by 10 degrees more")
        self._seen.append((name, verdict.cam_T_board))
        return verdict


def take(
    poses: Sequence[Float[np.ndarray, "6"]],
    move: Callable[[Float[np.ndarray, "6"]], None],
    capture: Callable[[], UInt8[np.ndarray, "h w 3"]],
    measured: Callable[[], Float[np.ndarray, "6"]],
    judge: Judge,
    prefix: str,
) -> Iterator[Shot]:
    """Go through the poses, a picture at each.

    Args:
        move: brings the arm to (6,) joint positions in rad and returns when it stands still there.
        capture: an RGB picture exposed after the call.
        measured: (6,) where the arm says it is, rad.
        prefix: what names begin with.
    """
    for i, q in enumerate(poses):
        move(q)
        colour, here = capture(), np.array(measured(), dtype=np.float64)
        name = f"{prefix}-{i:03d}.png"
        yield Shot(name, colour, here, judge(name, colour))


def usable(shots: Sequence[Shot], least: int) -> list[tuple[Shot, Sighting]]:
    """The shots that show the board well enough.

    Raises:
        CalibrationError: fewer than `least`; says why most of the others were refused.
    """
    good = [(s, s.verdict) for s in shots if isinstance(s.verdict, Sighting)]
    if len(good) < least:
        reasons = [s.verdict.reason for s in shots if isinstance(s.verdict, Rejected)]
        # The words before the first figure tell kinds of reasons apart.
        kinds = Counter(re.split(r"[:(\d]", reason)[0] for reason in reasons)
        why = next((r for r in reasons if kinds and r.startswith(kinds.most_common(1)[0][0])), "")
        raise CalibrationError(
            f"{len(good)} usable pictures of the board of {len(shots)}, at least {least} are needed"
            + (f"; most often: {why}" if why else ""),
            "mend that and take them anew, or ask for more --poses",
        )
    return good


class ShotFolder:
    """Pictures of one camera on disk, complete after every shot, so that nothing is lost when a run ends early.

    Args:
        path: of the folder; it is made.

    Raises:
        ConfigError: it cannot be written, or holds pictures already.
        DiskError: there is no room in it.
    """

    def __init__(self, path: Path, camera: str, spec: BoardSpec) -> None:
        self.path = path
        self._content: dict[str, Any] = {"camera": camera, "board": asdict(spec), "shots": []}
        try:
            path.mkdir(parents=True, exist_ok=True)
            # Made by one of two that begin here at once; the other is told.
            (path / LIST).touch(exist_ok=False)
            self._write()
        except FileExistsError:
            if path.is_dir():
                raise ConfigError(
                    f"{path} holds pictures already", f"use them with --views {path}, or name another"
                ) from None
            raise ConfigError(f"cannot write to {path}: it is a file", "give another folder with --out") from None
        except OSError as error:
            raise unwritable(f"to {path}", error, "give another folder with --out") from None

    def add(self, shot: Shot) -> None:
        """Raises DiskError when the disk is full, ConfigError when it cannot be written for another reason."""
        reason = shot.verdict.reason if isinstance(shot.verdict, Rejected) else None
        try:
            ok, png = cv2.imencode(".png", cv2.cvtColor(shot.colour, cv2.COLOR_RGB2BGR))
            write_bytes(self.path / shot.name, png.tobytes() if ok else b"")
            self._content["shots"].append({"file": shot.name, "q": shot.q.tolist(), "rejected": reason})
            self._write()
        except OSError as error:
            raise unwritable(f"to {self.path}", error, "give another folder with --out") from None

    def _write(self) -> None:
        write_text(self.path / LIST, json.dumps(self._content, indent=1) + "\n")


def read_shots(path: Path, camera: str, judge: Judge) -> list[Shot]:
    """The pictures of a folder, judged anew.

    Raises:
        CalibrationError: no such folder, of another camera, or a picture or its pose is missing or broken.
    """
    again = "take them anew: resync-robot calibrate hand-eye"
    try:
        content = json.loads(read_text(path / LIST))
        # Only plain names, of overlays too: a list from elsewhere must not point out of its folder.
        taken_by, rows = content["camera"], [(Path(s["file"]).name, s["q"]) for s in content["shots"]]
    except OSError as error:
        raise CalibrationError(f"no pictures in {path}: {error.strerror}", again) from None
    except (ValueError, KeyError, TypeError):
        raise CalibrationError(f"{path / LIST} is not what resync-robot calibrate writes", again) from None
    if taken_by != camera:
        raise CalibrationError(f"{path} holds pictures of camera '{taken_by}'", f"give --camera {taken_by}")
    shots = []
    for name, values in rows:
        try:
            q = np.array(values, dtype=np.float64)
        except (TypeError, ValueError):
            q = np.zeros(0)
        if q.shape != (6,) or not np.isfinite(q).all():
            raise CalibrationError(f"{path / LIST}: the pose of {name} must be 6 numbers (rad)", again)
        data = (path / name).read_bytes() if (path / name).is_file() else b""
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
        if image is None:
            raise CalibrationError(f"{path / name} is missing or no picture", f"remove it from {path / LIST}")
        colour = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
        shots.append(Shot(name, colour, q, judge(name, colour)))
    return shots
