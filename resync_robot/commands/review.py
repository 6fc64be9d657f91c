"""Look at a recorded episode: in the Rerun viewer, or as a film. Local only: no analytics, no open port."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from resync_robot.core.errors import ConfigError, EpisodeError
from resync_robot.core.files import MCAP, RRD, check_output
from resync_robot.given import Given

if TYPE_CHECKING:
    from resync_robot.core.episode import Episode
    from resync_robot.deployment.film import Frames

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class ReviewConfig:
    """Open a recorded episode in the Rerun viewer, or make a film of it."""

    episode: tyro.conf.Positional[Path]
    """A recording, *.mcap."""

    save: Given[Path] = None
    """Write this .rrd file instead of opening the viewer; needs no display. Default: open the viewer."""

    video: Given[Path] = None
    """Write the episode as a film to this .mp4 file, or to this .webp, an animated picture for a page: the robot at its
    task, the pictures of its cameras, the plan, what holds, and the time. Needs no display; half a second to a second
    of computing a frame, of which there are 15 (.webp: 8) a second. A robot of the domain's own is shown as its
    simulator drew it, which takes a tenth of that."""

    speed: float = 1.0
    """How many times as fast as the robot the film runs."""

    picture: Given[Path] = None
    """Write the robot at its task, at one moment, to this .jpg or .png file."""

    at: Given[float] = None
    """That moment, in s of the episode; by default the middle."""

    mend: Given[Path] = None
    """Write what is whole of a recording, damaged or of an earlier version, to this .mcap file, which Foxglove, Rerun
    and the tools of ROS 2 open, and do nothing else."""


def review(config: ReviewConfig) -> None:
    """Draw the episode and show it, or save it, or make a film or a picture of it.

    Raises:
        EpisodeError: the recording cannot be read, or there is no display to show it on.
        RenderError: a film or a picture is asked for, and no device can render.
        ConfigError: the file to write is the recording, or one of another kind, or cannot be written.
        DiskError: there is no room for it.
    """
    _check_there(config.episode)
    if config.mend is not None:
        check_output(config.mend, MCAP, [config.episode], "--mend")
        _mend(config.episode, config.mend)
        return
    if config.video is not None or config.picture is not None:
        _film(config)
        return
    if config.save is not None:
        check_output(config.save, RRD, [config.episode], "--save")
    if config.save is None and not _has_display():
        raise EpisodeError(
            "there is no display to open the viewer on",
            f"resync-robot review {config.episode} --save {config.episode.with_suffix('.rrd').name}",
        )
    # Rerun, numpy and OpenCV take a second to load; `--help` shall not wait for them.
    from resync_robot.core.episode import read_episode
    from resync_robot.deployment.rerun_view.drawing import save_drawing

    episode = read_episode(config.episode)
    if episode.damage is not None:
        _log.warning("%s is not whole: %s. Showing the rest.", episode.path, episode.loss)
    if config.save is not None:
        from resync_robot.console import say

        save_drawing(episode, config.save)
        say(f"{config.save} is written. Open it where a viewer runs:  rerun {config.save}")
        return
    with tempfile.TemporaryDirectory(prefix="resync-review-") as folder:
        drawing = Path(folder) / f"{config.episode.stem}.rrd"
        save_drawing(episode, drawing)
        _view(drawing, Path(folder) / "config")


def _check_there(path: Path) -> None:
    """Raises EpisodeError where that is no file, with the newest recording that there is instead."""
    if path.exists() and not path.is_dir():
        return
    what = f"{path} is a folder" if path.is_dir() else f"there is no recording {path}"
    found = list(path.glob("*.mcap") if path.is_dir() else Path("runs").glob("*/*.mcap"))
    newest = max(found, key=lambda p: p.stat().st_mtime, default=None)
    raise EpisodeError(
        what, f"the newest one there: resync-robot review {newest}" if newest else "record one: resync-robot deploy"
    )


def _film(config: ReviewConfig) -> None:
    from resync_robot.console import Stages, say
    from resync_robot.core.episode import read_episode
    from resync_robot.deployment import film

    if config.video is not None:
        film.check_film(config.video, config.episode, config.speed)
    if config.picture is not None:
        film.check_picture(config.picture, config.episode)
    episode = read_episode(config.episode)
    if episode.damage is not None:
        _log.warning("%s is not whole: %s. Showing the rest.", episode.path, episode.loss)
    at = episode.duration / 2 if config.at is None else config.at
    if not 0 <= at <= episode.duration:
        raise ConfigError(f"--at {at:g} is not from 0 to {episode.duration:.1f}, the length of the episode in s")
    if config.picture is not None:
        film.write_picture(_frames(episode, film.STILL).scene(at, plain=True), config.picture)
        say(f"Picture: {config.picture}")
    if config.video is not None:
        made = _frames(episode, film.SCENE, film.KINDS[config.video.suffix].finer)
        with Stages(["film"]) as stages, stages.stage("film") as progress:
            film.write_film(made, config.video, config.speed, progress)
        say(f"Film: {config.video}")


def _frames(episode: Episode, size: tuple[int, int], finer: float = 2.0) -> Frames:
    """Of an arm, rendered; of a domain's own robot, its simulator's pictures. Raises EpisodeError or RenderError."""
    from resync_robot.core.recorded_rig import RecordedRig
    from resync_robot.deployment.film import Film
    from resync_robot.deployment.own_film import OwnFilm

    if not episode.meta.rig:
        return OwnFilm(episode)
    # SAPIEN takes a second to load.
    from resync_robot.sim_training.scenes.film import FilmScene, view_of

    seen = {o for _, state in episode.states() for o in state}
    return Film(episode, FilmScene(RecordedRig.of(episode), *size, finer, view_of(seen)))


def _mend(torn: Path, out: Path) -> None:
    from resync_robot.console import say
    from resync_robot.core.episode import mend_episode

    found = mend_episode(torn, out)
    say(f"{torn}: {found.loss or 'nothing is wrong with it'}.")
    say(f"{out} holds all that is whole, {found.duration:.1f} s, in messages of ROS 2.")
    say(f"Review:  resync-robot review {out}")


def _has_display() -> bool:
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _view(drawing: Path, config_home: Path) -> None:
    """Run the viewer until it is closed.

    It keeps its analytics switch in the user's configuration; a configuration folder of its own leaves that alone.
    It would also listen for programs that log to it, on every address of the machine.
    """
    viewer = [sys.executable, "-m", "rerun_cli"]
    environment = {**os.environ, "XDG_CONFIG_HOME": str(config_home)}
    subprocess.run([*viewer, "analytics", "disable"], env=environment, capture_output=True, check=False)
    done = subprocess.run(
        [*viewer, str(drawing), "--bind", "127.0.0.1", "--hide-welcome-screen"], env=environment, check=False
    )
    if done.returncode != 0:
        raise EpisodeError(
            f"the Rerun viewer ended with code {done.returncode}",
            "give --save FILE.rrd and open that file where a viewer runs: rerun FILE.rrd",
        )
