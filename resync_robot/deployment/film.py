"""An episode as a film: the robot at its task seen from beside it, its cameras' pictures, plan, atoms, and the time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from jaxtyping import UInt8

from resync_robot.core import spatial
from resync_robot.core.episode import Episode
from resync_robot.core.episode_records import Joints
from resync_robot.core.errors import ConfigError, EpisodeError
from resync_robot.core.files import JPEG, MP4, PNG, WEBP, FileKind, check_output, unwritable, write_bytes
from resync_robot.core.plan_progress import plan_progress, progress_at
from resync_robot.core.recorded_rig import RecordedRig
from resync_robot.core.symbols import Object
from resync_robot.core.tracks import Tracks
from resync_robot.core.vocabulary import BLOCK
from resync_robot.deployment import film_panels as panels

WIDTH, HEIGHT, BAR = 1280, 720, 44
SCENE = 872, 490
STILL = 1280, 720
"""px of a picture of the scene alone."""
GAP = 4
PLAN_WIDTH = 410
HAND_HZ = 25.0
HELD_S = 2.0
"""s for which the last picture stays."""
OLD_S = 1.5
"""s from which on the age of a camera's picture is told."""
SPEEDS = 0.1, 100.0


@dataclass(frozen=True, kw_only=True)
class FilmKind:
    """How films of one suffix are encoded. One thread, so that the same frames give the same bytes.

    Attributes:
        width: px; rate: frames a second; finer: how much finer than shown the scene is rendered.
    """

    file: FileKind
    container: str
    codec: str
    width: int
    rate: int
    finer: float
    options: Mapping[str, str]
    container_options: Mapping[str, str] = field(default_factory=dict)


KINDS = {
    ".mp4": FilmKind(
        file=MP4, container="mp4", codec="libx264", width=WIDTH, rate=15, finer=2.0,
        options={"crf": "20", "preset": "medium", "x264-params": "threads=1:lookahead-threads=1:sliced-threads=0"},
    ),
    ".webp": FilmKind(
        file=WEBP, container="webp", codec="libwebp_anim", width=960, rate=8, finer=1.5,
        options={"quality": "85", "compression_level": "5"}, container_options={"loop": "0"},
    ),
}  # fmt: skip
PICTURES = {".jpg": JPEG, ".jpeg": JPEG, ".png": PNG}


class Scene(Protocol):
    """What draws the robot and the things around it, as `resync_robot.sim_training.scenes.film.FilmScene` does."""

    def picture(
        self, q: np.ndarray, opening: float, things: Mapping[Object, np.ndarray]
    ) -> UInt8[np.ndarray, "h w 3"]: ...

    def pixels(self, points: np.ndarray) -> np.ndarray: ...


class Frames(ABC):
    """The frames of an episode: its scene, the pictures of its cameras beside it, plan and atoms below.

    Args:
        cameras: whose pictures are shown; without any, the scene is as wide as the frame.

    Raises:
        EpisodeError: a message makes no sense.
    """

    def __init__(self, episode: Episode, cameras: Sequence[str]) -> None:
        self.duration = episode.duration
        self._moments = plan_progress(episode)
        self._atoms = list(episode.atoms())
        self._pictures = {name: [(p.time, p.colour) for p in episode.pictures(name)] for name in cameras}
        self._size = SCENE if cameras else (WIDTH, SCENE[1])
        meta = episode.meta
        self._title = "   ".join(part for part in (meta.domain, meta.scenario, f"goal: {meta.goal}") if part)

    @abstractmethod
    def scene(self, time: float, plain: bool = False) -> UInt8[np.ndarray, "h w 3"]:
        """The scene alone, labelled; unless it is to be plain."""

    def frame(self, time: float, speed: float = 1.0) -> UInt8[np.ndarray, "h w 3"]:
        """RGB of the whole frame at `time`."""
        frame = np.empty((HEIGHT, WIDTH, 3), np.uint8)
        frame[:] = panels.BACKGROUND
        frame[:BAR] = panels.header(self._title, time, speed, WIDTH, BAR)
        width, height = self._size
        frame[BAR : BAR + height, :width] = self.scene(time)
        below, plan = HEIGHT - BAR - height, width * PLAN_WIDTH // SCENE[0]
        frame[BAR + height :, :plan] = panels.plan_panel(progress_at(self._moments, time), plan, below)
        frame[BAR + height :, plan:width] = panels.atoms_panel(self._atoms_at(time), width - plan, below)
        across, down = WIDTH - width - 2 * GAP, (HEIGHT - BAR) // max(3, len(self._pictures)) - GAP
        for i, name in enumerate(self._pictures):
            top = BAR + i * (down + GAP)
            frame[top : top + down, width + GAP : width + GAP + across] = self._tile(name, time, across, down)
        return frame

    def _tile(self, name: str, time: float, width: int, height: int) -> UInt8[np.ndarray, "h w 3"]:
        pictures = self._pictures[name]
        i = bisect_right(pictures, time, key=lambda p: p[0]) - 1
        data = pictures[i][1] if i >= 0 else None
        if data is None:
            return panels.tile(None, f"{name} camera: no picture yet", width, height)
        picture = decoded(data)
        if picture is None:
            return panels.tile(None, f"{name} camera: the picture is damaged", width, height)
        age = time - pictures[i][0]
        label = f"{name} camera" + (f", {age:.0f} s ago" if age > OLD_S else "")
        return panels.tile(picture, label, width, height)

    def _atoms_at(self, time: float) -> Mapping[str, float]:
        i = bisect_right(self._atoms, time, key=lambda a: a[0]) - 1
        return self._atoms[i][1] if i >= 0 else {}


class Film(Frames):
    """The frames of an episode of an arm.

    Args:
        scene: of SCENE's size.

    Raises:
        EpisodeError: there is nothing in it to show, or a message makes no sense.
    """

    def __init__(self, episode: Episode, scene: Scene) -> None:
        super().__init__(episode, episode.cameras)
        self._scene, self._size = scene, SCENE
        self._joints = _thinned(episode)
        self._times = [j.time for j in self._joints]
        rig = RecordedRig.of(episode)
        tip = spatial.transform(None, np.array([0.0, 0.0, rig.tip_offset]))
        tips = np.stack([rig.frames(j.measured)[-1] @ tip for j in self._joints])
        truths, beliefs = list(episode.truths()), list(episode.states())
        self._belief = Tracks(beliefs, np.array(self._times), tips)
        self._shown = Tracks(truths, np.array(self._times), tips) if truths else self._belief
        self._knows = bool(truths)
        self._last: tuple[bytes, np.ndarray] | None = None

    def scene(self, time: float, plain: bool = False) -> UInt8[np.ndarray, "h w 3"]:
        """The scene alone; unless it is to be plain, with a label, and with the blocks as they are believed to be."""
        joints, things = self._joints_at(time), self._shown.at(time)
        key = np.concatenate([joints.measured, [joints.opening], *things.values()]).round(4).tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self._scene.picture(joints.measured, joints.opening, things)
        picture = self._last[1].copy()
        if plain:
            return picture
        if not self._knows:
            return panels.labelled(picture, "as the robot believes it since its last scan")
        if self._outline(picture, time):
            return panels.labelled(picture, "as simulated; orange: where the robot believes the blocks")
        return panels.labelled(picture, "as simulated; the robot has not scanned yet")

    def _outline(self, picture: np.ndarray, time: float) -> bool:
        """Draw where blocks are believed. Returns whether anything is."""
        believed = self._belief.at(time)
        for obj, features in believed.items():
            if obj.type != BLOCK:
                continue
            signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
            corners = spatial.apply(spatial.pose_from_features(features[:7]), signs * features[7:10] / 2)
            px = np.round(self._scene.pixels(corners) * 16).clip(-(2**20), 2**20).astype(np.int32)
            cv2.polylines(picture, [cv2.convexHull(px)], True, panels.BELIEF, 2, cv2.LINE_AA, 4)
        return bool(believed)

    def _joints_at(self, time: float) -> Joints:
        return self._joints[max(0, bisect_right(self._times, time) - 1)]


def _thinned(episode: Episode) -> list[Joints]:
    shown: list[Joints] = []
    for moment in episode.joints():
        late = not shown or moment.time >= shown[-1].time + 0.99 / HAND_HZ
        if late and np.isfinite(moment.measured).all() and np.isfinite(moment.opening):
            shown.append(moment)
    if not shown:
        raise EpisodeError(f"{episode.path} holds no joints to show", "record one with resync-robot deploy")
    return shown


def decoded(data: bytes) -> UInt8[np.ndarray, "h w 3"] | None:
    """RGB of an encoded picture; None where it is damaged."""
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    return None if picture is None else np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)


def check_film(path: Path, recording: Path, speed: float) -> None:
    """Before any work: raises ConfigError or DiskError where no film can be written there."""
    if path.suffix not in KINDS:
        raise ConfigError(
            f"--video {path} is neither .mp4 nor .webp", f"give another name, such as {path.with_suffix('.mp4')}"
        )
    if not SPEEDS[0] <= speed <= SPEEDS[1]:
        raise ConfigError(f"--speed {speed:g} is not from {SPEEDS[0]:g} to {SPEEDS[1]:g}", "give --speed 4")
    check_output(path, KINDS[path.suffix].file, [recording], "--video")


def check_picture(path: Path, recording: Path) -> None:
    """Before any work: raises ConfigError or DiskError where no picture can be written there."""
    if path.suffix not in PICTURES:
        raise ConfigError(
            f"--picture {path} is neither .jpg nor .png", f"give another name, such as {path.with_suffix('.jpg')}"
        )
    check_output(path, PICTURES[path.suffix], [recording], "--picture")


def write_picture(picture: UInt8[np.ndarray, "h w 3"], path: Path) -> None:
    """Raises ConfigError or DiskError."""
    quality = [cv2.IMWRITE_JPEG_QUALITY, 90] if PICTURES[path.suffix] is JPEG else []
    _, data = cv2.imencode(path.suffix, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), quality)
    try:
        write_bytes(path, data.tobytes())
    except OSError as error:
        raise unwritable(path, error, "give another file with --picture") from None


def frame_times(duration: float, speed: float, rate: int) -> Iterator[float]:
    """The moments of the episode that the film's frames show; the last one stays for a while."""
    count = int(duration / speed * rate) + 1
    yield from (i * speed / rate for i in range(count))
    yield from [duration] * round(HELD_S * rate)


def write_film(film: Frames, path: Path, speed: float, progress: Callable[[float, str], None]) -> None:
    """Encode the film as the suffix says: .mp4 (H.264, which everything plays) or .webp (an animated picture).

    The same recording gives the same bytes on one machine.

    Raises:
        ConfigError, DiskError: it cannot be written.
    """
    import av

    kind = KINDS[path.suffix]
    times = list(frame_times(film.duration, speed, kind.rate))
    data = BytesIO()
    height = round(HEIGHT * kind.width / WIDTH)
    with av.open(data, "w", format=kind.container, options=dict(kind.container_options)) as container:
        stream = container.add_stream(kind.codec, rate=Fraction(kind.rate), options=dict(kind.options))
        stream.width, stream.height, stream.pix_fmt = kind.width, height, "yuv420p"
        stream.codec_context.thread_count = 1
        for i, time in enumerate(times):
            picture = cv2.resize(film.frame(time, speed), (kind.width, height), interpolation=cv2.INTER_AREA)
            for packet in stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")):
                container.mux(packet)
            progress((i + 1) / len(times), f"{time:.0f} of {film.duration:.0f} s")
        for packet in stream.encode():
            container.mux(packet)
    try:
        write_bytes(path, data.getvalue())
    except OSError as error:
        raise unwritable(path, error, "give another file with --video") from None
