"""A recording becomes a film that shows at each time what was then."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from resync_robot.commands.review import ReviewConfig, review
from resync_robot.core.episode import read_episode
from resync_robot.core.errors import ConfigError, EpisodeError
from resync_robot.core.plan_progress import PlanProgress, Standing
from resync_robot.deployment import film
from resync_robot.deployment.film_panels import BAD, BELIEF, GOOD, NOW, plan_panel
from tests.commands.test_review import B0, B1, TRAY, synthetic_episode

WHITE = 240


class PaintedScene:
    """Stands for the renderer: a bar whose length says where a block is."""

    def __init__(self) -> None:
        self.asked: list[tuple[np.ndarray, float, dict]] = []

    def picture(self, q, opening, things):
        self.asked.append((q, opening, dict(things)))
        picture = np.full((film.SCENE[1], film.SCENE[0], 3), 90, np.uint8)
        picture[200:220, : round(1000 * things[B0][0])] = WHITE
        return picture

    def pixels(self, points):
        return points[:, :2] * 1000


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recorded") / "episode.mcap"
    synthetic_episode(path)
    return path


def made(recording: Path) -> tuple[film.Film, PaintedScene]:
    scene = PaintedScene()
    return film.Film(read_episode(recording), scene), scene


def has(picture: np.ndarray, colour: tuple[int, int, int]) -> bool:
    return bool((np.abs(picture.astype(int) - colour).max(-1) < 12).any())


def test_a_frame_shows_the_moment(recording: Path) -> None:
    film_, scene = made(recording)
    frames = {t: film_.frame(t) for t in (0.5, 1.5, 4.0)}
    assert {f.shape for f in frames.values()} == {(film.HEIGHT, film.WIDTH, 3)}
    joints = list(read_episode(recording).joints())
    for (q, opening, things), time in zip(scene.asked, frames, strict=True):
        nearest = min(joints, key=lambda j: abs(j.time - time))
        np.testing.assert_allclose(q, nearest.measured, atol=0.02)
        assert opening == pytest.approx(0.082) and {B0, B1, TRAY} <= set(things)
    # The truth, not the belief, which is 1 mm beside it; and the belief as an outline.
    np.testing.assert_allclose(scene.asked[1][2][B0][0], 0.35 + 0.02 * 1.5, atol=0.005)
    left = frames[1.5][film.BAR :, : film.SCENE[0]]
    assert has(left[:300], BELIEF)
    plan = left[film.SCENE[1] :, : film.PLAN_WIDTH]
    assert has(plan, GOOD) and has(plan, NOW)
    assert not has(frames[0.5][film.BAR + film.SCENE[1] :, : film.PLAN_WIDTH], GOOD)


def test_what_has_not_moved_is_not_rendered_again(recording: Path) -> None:
    film_, scene = made(recording)
    for _ in range(3):
        film_.frame(2.0)
    assert len(scene.asked) == 1


def test_the_film_plays_as_fast_as_asked_and_is_the_same_every_time(recording: Path, tmp_path: Path) -> None:
    import av

    for name in ("one", "two"):
        film.write_film(made(recording)[0], tmp_path / f"{name}.mp4", 4.0, lambda share, figure: None)
    assert (tmp_path / "one.mp4").read_bytes() == (tmp_path / "two.mp4").read_bytes()
    with av.open(str(tmp_path / "one.mp4")) as container:
        (stream,) = container.streams
        assert stream.codec_context.name == "h264" and stream.codec_context.pix_fmt == "yuv420p"
        frames = [f.to_ndarray(format="rgb24") for f in container.decode(stream)]
        rate = float(stream.average_rate)
    assert len(frames) / rate == pytest.approx(4.0 / 4.0 + film.HELD_S, abs=2 / rate)
    assert frames[0].shape == (film.HEIGHT, film.WIDTH, 3)
    bars = [int((f[film.BAR + 210, : film.SCENE[0], 0] > 200).sum()) for f in frames]
    # The block slides by 80 mm, of which the painted bar makes 80 px.
    assert bars[-1] - bars[0] == pytest.approx(80, abs=8) and sorted(bars) == bars


def test_an_animated_picture_for_a_page(recording: Path, tmp_path: Path) -> None:
    from PIL import Image

    out = tmp_path / "film.webp"
    film.write_film(made(recording)[0], out, 8.0, lambda share, figure: None)
    with Image.open(out) as picture:
        assert picture.format == "WEBP" and picture.is_animated and picture.size == (960, 540)
        assert picture.info["loop"] == 0, "for ever"


def test_a_long_plan_shows_the_step_under_way() -> None:
    steps = [(f"Pick(r, b{i})", Standing.DONE) for i in range(12)]
    steps += [("Insert(r, b1, b0)", Standing.UNDER_WAY), ("Pick(r, b9)", Standing.NEXT)]
    panel = plan_panel(PlanProgress(0.0, "Insert(r, b1, b0)", "", tuple(steps)), 410, 186)
    assert has(panel, NOW) and has(panel, GOOD) and not has(panel, BAD)


def test_a_recording_without_joints_cannot_be_filmed(tmp_path: Path) -> None:
    from tests.core.test_plan_progress import Recorded

    r = Recorded(tmp_path)
    r.writer.close()
    with pytest.raises(EpisodeError, match="holds no joints to show"):
        film.Film(read_episode(r.path), PaintedScene())


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("film.avi", r"is neither \.mp4 nor \.webp"),
        ("film", r"is neither \.mp4 nor \.webp"),
        ("episode.mcap", r"is neither \.mp4 nor \.webp"),
        ("link.mp4", "is the file that is read"),
        ("notes.mp4", "exists and is not an MP4 film"),
        ("notes.mp4/film.mp4", "cannot write --video"),
    ],
)
def test_a_film_takes_no_other_file_s_place(recording: Path, tmp_path: Path, name: str, word: str) -> None:
    mine = tmp_path / "episode.mcap"
    mine.write_bytes(recording.read_bytes())
    (tmp_path / "link.mp4").symlink_to(mine)
    (tmp_path / "notes.mp4").write_text("mine")
    with pytest.raises(ConfigError, match=word):
        review(ReviewConfig(episode=mine, video=tmp_path / name))
    assert mine.read_bytes() == recording.read_bytes() and (tmp_path / "notes.mp4").read_text() == "mine"


@pytest.mark.parametrize(
    ("asked", "word"),
    [
        ({"video": "film.mp4", "speed": 0.0}, "--speed 0 is not from 0.1 to 100"),
        ({"video": "film.mp4", "speed": float("nan")}, "--speed nan"),
        ({"picture": "robot.gif"}, r"is neither \.jpg nor \.png"),
        ({"picture": "robot.jpg", "at": 99.0}, r"--at 99 is not from 0 to 4\.0"),
    ],
)
def test_what_cannot_be_filmed_is_said_at_once(recording: Path, tmp_path: Path, asked: dict, word: str) -> None:
    files = {k: tmp_path / v for k, v in asked.items() if isinstance(v, str)}
    with pytest.raises(ConfigError, match=word):
        review(ReviewConfig(episode=recording, **{**asked, **files}))
    assert not list(tmp_path.iterdir())


def test_a_missing_recording_leaves_no_film(tmp_path: Path) -> None:
    with pytest.raises(EpisodeError, match="there is no recording"):
        review(ReviewConfig(episode=tmp_path / "none.mcap", video=tmp_path / "film.mp4"))
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_recording_is_filmed_by_the_renderer(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "robot.png"
    review(ReviewConfig(episode=recording, picture=out, at=2.0))
    picture = cv2.imread(str(out))
    assert picture.shape == (*film.STILL[::-1], 3)
    blue, red = picture[..., 0].astype(int), picture[..., 2].astype(int)
    assert (red - blue > 90).sum() > 200, "the red block"
    assert (blue - red > 60).sum() > 200, "the blue block and the arm's rings"
