"""The film of a domain's own robot: at each time the picture that was recorded last."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from resync_robot.core.episode import Episode, read_episode
from resync_robot.core.episode_records import SCENE_VIEW, EpisodeMeta
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.errors import EpisodeError
from resync_robot.deployment import film
from resync_robot.deployment.own_film import OwnFilm

RED, BLUE = (200, 40, 40), (40, 40, 200)


def recorded(path: Path, *pictures: bytes) -> Episode:
    """One picture a second, and an atom that holds from the first second on."""
    meta = EpisodeMeta(
        rig_hash="", rig={}, library_hash="", domain="toys", scenario="s", goal="Tidy(r)", seed=0, backend="sim"
    )
    with EpisodeWriter(path, meta) as writer:
        for k, picture in enumerate(pictures):
            writer.film(SCENE_VIEW, float(k), picture)
            writer.atoms(float(k), {"Tidy(r)": float(k > 0)})
    return read_episode(path)


def painted(colour: tuple[int, int, int]) -> bytes:
    return cv2.imencode(".png", np.full((30, 60, 3), colour[::-1], np.uint8))[1].tobytes()


def test_each_frame_has_the_latest_picture_as_large_as_fits(tmp_path: Path) -> None:
    frames = OwnFilm(recorded(tmp_path / "e.mcap", painted(RED), painted(BLUE)))
    assert frames.duration == 1.0
    for time, colour in ((0.0, RED), (0.9, RED), (1.0, BLUE), (5.0, BLUE)):
        frame = frames.frame(time)
        assert frame.shape == (film.HEIGHT, film.WIDTH, 3)
        scene = frame[film.BAR : film.BAR + film.SCENE[1]]
        assert tuple(scene[film.SCENE[1] // 2, film.WIDTH // 2]) == colour
        wide = (np.abs(scene[film.SCENE[1] // 2].astype(int) - colour).max(-1) < 5).sum()
        assert wide == pytest.approx(2 * film.SCENE[1], abs=3), "twice as wide as high, as it was painted"
        assert frames.scene(time, plain=True).shape == (30, 60, 3)
    below = slice(film.BAR + film.SCENE[1], None)
    assert (frames.frame(0.0)[below] != frames.frame(1.0)[below]).any(), "what holds"


def test_a_damaged_picture_is_told_and_the_film_goes_on(tmp_path: Path) -> None:
    frames = OwnFilm(recorded(tmp_path / "e.mcap", painted(RED), b"\xff\xd8torn", painted(BLUE)))
    middle = film.BAR + film.SCENE[1] // 2, film.WIDTH // 2
    shown = [tuple(frames.frame(float(t))[middle]) for t in range(3)]
    assert (shown[0], shown[2]) == (RED, BLUE) and shown[1] not in (RED, BLUE)
    with pytest.raises(EpisodeError, match=r"the picture at 1\.00 s is damaged"):
        frames.scene(1.5, plain=True)


def test_without_pictures_there_is_no_film(tmp_path: Path) -> None:
    with pytest.raises(EpisodeError, match="holds no pictures to show"):
        OwnFilm(recorded(tmp_path / "e.mcap"))
