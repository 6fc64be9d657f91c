"""Words in pictures that are made pixel by pixel, and drawn figures on disk."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
from PIL import ImageFont

from resync_robot.core.files import whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@cache
def font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Letters of `size` px; matplotlib's, so that every machine writes the same."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name), size)


def fitting(text: str, room: float, letters: ImageFont.FreeTypeFont) -> str:
    """The text, cut off where there is not room for all of it in so many px."""
    if letters.getlength(text) <= room:
        return text
    while text and letters.getlength(text + "…") > room:
        text = text[:-1]
    return text + "…"


def save_figure(figure: Figure, path: Path) -> None:
    """Write it as PNG, whole or not at all, with this program's name in it (`core.files.FIGURE`). Raises OSError."""
    with whole(path) as beside:
        figure.savefig(beside, dpi=130, format="png", metadata={"Software": "resync-robot"})
