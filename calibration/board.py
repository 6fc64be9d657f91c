"""The ChArUco board: a chessboard with markers in its white squares, so that a part of it is enough to tell which part.

Frame of the board: x right along the rows, y down, z into the board, origin at the outer corner of the upper left
square, as OpenCV has it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from resync_robot.core.errors import CalibrationError, ConfigError
from resync_robot.core.files import check_output, starting_with, unwritable, whole

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float, UInt8

# The settings of the command line contain a board, and --help shall not wait for numpy and OpenCV.

DICTIONARIES = ("4x4_50", "4x4_100", "5x5_50", "5x5_100", "6x6_50")
"""Small dictionaries of OpenCV: few markers, far apart in code."""
A4 = (0.210, 0.297)
"""m."""
MARGIN = 0.005
"""m that a printer leaves white."""
MOST_PIXELS = 600e6
"""Of a .png: A4 at 2400 dpi, 2 GB while it is drawn."""
KINDS = {
    kind.suffix: kind
    for kind in (
        starting_with("a board that this program drew", ".pdf", b"%PDF-", containing=b"ChArUco"),
        starting_with("a board that this program drew", ".png", b"\x89PNG\r\n\x1a\n", containing=b"ChArUco"),
    )
}
"""What a board is written as, by the ending of the file's name."""


@dataclass(frozen=True, kw_only=True)
class BoardSpec:
    """A board. The default fills an A4 sheet; its cells are large enough for a 424 x 240 picture from 0.5 m."""

    columns: int = 6
    """Squares from left to right."""
    rows: int = 8
    """Squares from top to bottom."""
    square: float = 0.032
    """Side of a square, m. Measure the print, over many squares, and give what you measured."""
    marker: float = 0.024
    """Side of a marker, m."""
    dictionary: str = "4x4_50"
    """Which set of markers: 4x4_50, 4x4_100, 5x5_50, 5x5_100 or 6x6_50."""
    legacy: bool = False
    """The layout of boards that OpenCV drew before version 4.6: with an even number of rows, the upper left square is
    white and has a marker."""

    def __post_init__(self) -> None:
        if self.dictionary not in DICTIONARIES:
            raise ConfigError(f"unknown marker dictionary '{self.dictionary}'", f"valid: {', '.join(DICTIONARIES)}")
        if not (3 <= self.columns <= 20 and 3 <= self.rows <= 20):
            raise ConfigError(f"a board of {self.columns} x {self.rows} squares; allowed: 3 to 20 each way")
        if not (math.isfinite(self.square) and 0.005 <= self.square <= 0.2):
            raise ConfigError(f"squares of {self.square} m; allowed: 0.005 to 0.2 m", "lengths are in metres")
        if not (math.isfinite(self.marker) and 0.5 * self.square <= self.marker <= 0.9 * self.square):
            raise ConfigError(
                f"markers of {self.marker} m in squares of {self.square} m; allowed: half to nine tenths of the square",
                f"give --board.marker {0.75 * self.square:.4g}",
            )
        most = int(self.dictionary.split("_")[1])
        if self.columns * self.rows // 2 > most:
            raise ConfigError(
                f"{self.columns} x {self.rows} squares need {self.columns * self.rows // 2} markers, "
                f"the dictionary {self.dictionary} has {most}",
                "give fewer squares, or a larger --board.dictionary",
            )

    @cached_property
    def opencv(self) -> Any:
        """The board as OpenCV knows it."""
        import cv2

        board = cv2.aruco.CharucoBoard(
            (self.columns, self.rows), float(self.square), float(self.marker), self.opencv_dictionary
        )
        board.setLegacyPattern(self.legacy)
        return board

    @property
    def first_black(self) -> int:
        """0 where the upper left square is black, 1 where it is white; squares alternate from there."""
        return int(self.legacy and self.rows % 2 == 0)

    @cached_property
    def opencv_dictionary(self) -> Any:
        import cv2

        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary.upper()}"))

    @cached_property
    def corners(self) -> Float[np.ndarray, "n 3"]:
        """Inner corners by their number, in the frame of the board, m."""
        import numpy as np

        return np.asarray(self.opencv.getChessboardCorners(), dtype=np.float64)

    @property
    def size(self) -> tuple[float, float]:
        """(width, height), m."""
        return self.columns * self.square, self.rows * self.square

    @property
    def centre(self) -> Float[np.ndarray, "3"]:
        import numpy as np

        return np.array([*self.size, 0.0]) / 2

    def image(self, pixels_per_square: int) -> UInt8[np.ndarray, "h w"]:
        """The board without a margin."""
        import numpy as np

        size = (self.columns * pixels_per_square, self.rows * pixels_per_square)
        return np.asarray(self.opencv.generateImage(size, marginSize=0, borderBits=1))


def write_board(spec: BoardSpec, path: Path, dpi: int = 600) -> None:
    """Draw the board to scale on an A4 sheet (or on one as large as it needs), with a ruler to check the print by.

    Args:
        path: a .pdf (lines, exact at any resolution) or a .png (`dpi` pixels an inch, and the file says so).

    Raises:
        ConfigError: the file's name has another ending, it is there and is no such board, or it cannot be written.
        DiskError: there is no room for it.
    """
    kind = KINDS.get(path.suffix.lower())
    if kind is None:
        raise ConfigError(f"a board is written as .pdf or .png, not as '{path.name}'", "give --out board.pdf")
    check_output(path, kind)
    import numpy as np

    page = [max(a, b) for a, b in zip(A4, (spec.size[0] + 2 * MARGIN, spec.size[1] + 6 * MARGIN), strict=True)]
    pixels = math.prod(side / 0.0254 * dpi for side in page)
    if path.suffix.lower() == ".png" and pixels > MOST_PIXELS:
        fits = int(dpi * math.sqrt(MOST_PIXELS / pixels))
        raise ConfigError(
            f"a sheet of {page[0]:.2f} x {page[1]:.2f} m at {dpi} dpi has {pixels / 1e6:.0f} million pixels; allowed: "
            f"{MOST_PIXELS / 1e6:.0f} million",
            f"give --dpi {fits}, or --out board.pdf, which has lines in place of pixels",
        )
    # Matplotlib writes true vector PDF with a page in inches; it comes with ManiSkill, so nothing is added.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    ruler = 0.1
    width, height = page
    figure = Figure(figsize=(width / 0.0254, height / 0.0254))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.axis("off")
    left, top = (width - spec.size[0]) / 2, (height - spec.size[1] - 2 * MARGIN) / 2

    def black(x: float, y: float, side: float) -> None:
        axes.add_patch(Rectangle((x, y), side, side, facecolor="black", edgecolor="none", antialiased=False))

    inset = (spec.square - spec.marker) / 2
    number = 0
    for row in range(spec.rows):
        for column in range(spec.columns):
            x, y = left + column * spec.square, top + row * spec.square
            if (row + column) % 2 == spec.first_black:
                black(x, y, spec.square)
                continue
            cells = _cells(spec, number)
            number += 1
            cell = spec.marker / len(cells)
            for i, j in np.argwhere(cells == 0):
                black(x + inset + j * cell, y + inset + i * cell, cell)
    bottom = top + spec.size[1] + 2 * MARGIN
    axes.plot([left, left + ruler], [bottom, bottom], color="black", linewidth=0.5)
    for end in (left, left + ruler):
        axes.plot([end, end], [bottom - 0.002, bottom + 0.002], color="black", linewidth=0.5)
    layout = ", legacy layout" if spec.legacy else ""
    text = (
        f"100 mm   ChArUco {spec.columns} x {spec.rows}, {spec.dictionary}, squares {1000 * spec.square:g} mm, "
        f"markers {1000 * spec.marker:g} mm{layout}. Print at 100 %, glue flat, measure."
    )
    axes.text(left, bottom + 0.006, text, fontsize=7, family="monospace", va="center")
    try:
        with whole(path) as beside:
            figure.savefig(beside, dpi=dpi, format=kind.suffix[1:], metadata={"Title": text})
    except OSError as error:
        raise unwritable(path, error, "give another file with --out") from None


def _cells(spec: BoardSpec, number: int) -> UInt8[np.ndarray, "n n"]:
    """0 where the marker of that number is black, its border included; a cell a pixel."""
    import numpy as np

    side = int(spec.dictionary[0]) + 2
    cells = np.asarray(spec.opencv_dictionary.generateImageMarker(number, side, borderBits=1))
    if cells.shape != (side, side):
        raise CalibrationError(f"OpenCV drew marker {number} as {cells.shape}, not as {side} x {side} cells")
    return cells
