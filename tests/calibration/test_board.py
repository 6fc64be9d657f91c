"""The printed board is to scale and the one that OpenCV looks for; a board that cannot be is refused."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from resync_robot.calibration.board import BoardSpec, write_board
from resync_robot.core.errors import ConfigError


def test_a_printed_board_is_to_scale(tmp_path: Path) -> None:
    spec, dpi = BoardSpec(), 200
    write_board(spec, tmp_path / "board.png", dpi)
    picture = cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE)
    px, ids, _, _ = cv2.aruco.CharucoDetector(spec.opencv).detectBoard(picture)
    assert sorted(ids.ravel()) == list(range(len(spec.corners)))
    metres = px[:, 0] * 0.0254 / dpi
    offset = metres - spec.corners[ids.ravel(), :2]
    # Half a pixel is 0.06 mm.
    np.testing.assert_allclose(offset, np.broadcast_to(offset.mean(0), offset.shape), atol=1.5e-4)


@pytest.mark.parametrize("rows", [7, 8])
@pytest.mark.parametrize("legacy", [False, True])
def test_the_printed_board_is_the_one_that_opencv_draws(tmp_path: Path, rows: int, legacy: bool) -> None:
    """Both layouts; with an odd number of rows they are one."""
    spec, dpi = BoardSpec(rows=rows, legacy=legacy), 254
    write_board(spec, tmp_path / "board.png", dpi)
    picture = cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE)
    side = round(spec.square / 0.0254 * dpi)
    drawn = spec.image(side)
    best = cv2.minMaxLoc(cv2.matchTemplate(picture, drawn, cv2.TM_CCOEFF_NORMED))[1]
    assert best > 0.97
    other = BoardSpec(rows=rows, legacy=not legacy).image(side)
    assert (cv2.minMaxLoc(cv2.matchTemplate(picture, other, cv2.TM_CCOEFF_NORMED))[1] > 0.97) == (rows == 7)


def test_a_picture_too_large_to_draw_is_refused(tmp_path: Path) -> None:
    spec = BoardSpec(columns=14, rows=14, square=0.2, marker=0.15, dictionary="5x5_100")
    with pytest.raises(ConfigError, match=r"million pixels; allowed: 600 million\n.*give --dpi 2"):
        write_board(spec, tmp_path / "board.png", 2400)
    assert not list(tmp_path.iterdir())


def test_a_pdf_is_an_a4_page_of_lines(tmp_path: Path) -> None:
    write_board(BoardSpec(), tmp_path / "board.pdf")
    data = (tmp_path / "board.pdf").read_bytes()
    assert data.startswith(b"%PDF") and b"/Subtype /Image" not in data
    width, height = (float(v) for v in re.search(rb"/MediaBox \[ *0 +0 +([\d.]+) +([\d.]+)", data).groups())
    assert (width, height) == pytest.approx((210 / 25.4 * 72, 297 / 25.4 * 72), abs=0.1)


@pytest.mark.parametrize("suffix", [".pdf", ".png"])
def test_only_a_board_is_replaced(suffix: str, tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    path = tmp_path / f"board{suffix}"
    for _ in range(2):
        write_board(BoardSpec(columns=4, rows=3), path, 60)
    Figure().savefig(path)
    before = path.read_bytes()
    with pytest.raises(ConfigError, match="exists and is not a board"):
        write_board(BoardSpec(), path, 60)
    assert path.read_bytes() == before


def test_a_board_larger_than_a_sheet_gets_a_larger_page(tmp_path: Path) -> None:
    spec = BoardSpec(columns=7, rows=5, square=0.08, marker=0.06)
    write_board(spec, tmp_path / "board.png", 60)
    picture = cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE)
    _, ids, _, _ = cv2.aruco.CharucoDetector(spec.opencv).detectBoard(picture)
    assert len(ids) == 24
    assert picture.shape[1] * 0.0254 / 60 > spec.size[0]


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"dictionary": "7x7"}, "valid: 4x4_50"),
        ({"columns": 2}, "3 to 20"),
        ({"square": 32.0}, "in metres"),
        ({"square": float("nan")}, "allowed: 0.005"),
        ({"marker": 0.031}, "--board.marker 0.024"),
        ({"marker": 0.0}, "half to nine tenths"),
        ({"columns": 12, "rows": 12}, "need 72 markers"),
    ],
)
def test_a_board_that_cannot_be_is_refused(change: dict, word: str) -> None:
    with pytest.raises(ConfigError) as error:
        BoardSpec(**change)
    assert word in str(error.value)


@pytest.mark.parametrize("name", ["board.svg", "board"])
def test_what_cannot_be_written_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError):
        write_board(BoardSpec(), tmp_path / name)


def test_a_folder_that_is_no_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="cannot write"):
        write_board(BoardSpec(), tmp_path / "file" / "board.pdf")
