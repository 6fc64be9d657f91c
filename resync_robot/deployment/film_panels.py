"""The parts of a film's frame that are not the scene: header, camera tiles, plan, atoms. Pictures are RGB."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw

from resync_robot.core.plan_progress import PlanProgress, Standing
from resync_robot.figures import fitting, font

Picture = UInt8[np.ndarray, "h w 3"]
Colour = tuple[int, int, int]
BACKGROUND, BAR, TEXT, FAINT = (24, 27, 32), (36, 40, 47), (228, 231, 235), (138, 146, 156)
GOOD, BAD, NOW = (104, 196, 128), (240, 96, 86), (246, 176, 66)
BELIEF = (246, 150, 40)
SIZE, LINE = 17, 23
"""px of letters, and from one line to the next."""
HOLDS, DOUBTFUL = 0.5, 0.05
"""Probabilities from which on an atom is held true, and from which on, or below one by as much, it is doubtful."""
_LOOKS: Mapping[Standing, tuple[str, Colour]] = {
    Standing.DONE: ("✓", GOOD),
    Standing.FAILED: ("✗", BAD),
    Standing.UNDER_WAY: ("▶", NOW),
    Standing.NEXT: ("○", TEXT),
    Standing.LATER: ("○", FAINT),
}
_WORDS = {Standing.LATER: ""}


def header(title: str, time: float, speed: float, width: int, height: int) -> Picture:
    """What the film shows, and the time of the episode."""
    image, draw = _blank(width, height, BAR)
    clock = f"{time:5.1f} s" + (f"   {speed:g} × speed" if speed != 1 else "")
    room = width - 48 - int(font(20, True).getlength(clock))
    draw.text((16, height / 2), fitting(title, room, font(20, True)), TEXT, font(20, True), anchor="lm")
    draw.text((width - 16, height / 2), clock, TEXT, font(20, True), anchor="rm")
    return np.asarray(image)


def tile(picture: Picture | None, label: str, width: int, height: int) -> Picture:
    """A picture, as large as fits, with its label in it; without one, the label alone."""
    image, draw = _blank(width, height, BAR)
    if picture is not None:
        scale = min(width / picture.shape[1], height / picture.shape[0])
        size = round(picture.shape[1] * scale), round(picture.shape[0] * scale)
        image.paste(
            Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS),
            ((width - size[0]) // 2, (height - size[1]) // 2),
        )
    return np.asarray(_labelled(image, draw, label))


def labelled(picture: Picture, label: str) -> Picture:
    """The picture with a label in its upper left corner."""
    image = Image.fromarray(picture)
    return np.asarray(_labelled(image, ImageDraw.Draw(image), label))


def plan_panel(moment: PlanProgress, width: int, height: int) -> Picture:
    """What the robot does, and how its steps stand; of a long plan the part around the step under way."""
    image, draw = _blank(width, height, BACKGROUND)
    draw.text((16, 16), "Plan", FAINT, font(SIZE, True), anchor="lm")
    known = {step for step, _ in moment.steps}
    doing = "" if moment.doing in known else moment.doing
    ended = moment.steps and doing.partition(":")[0] in ("goal reached", "given up", "stopped")
    colour = GOOD if doing == "goal reached" else BAD if ended else NOW
    draw.text((72, 16), fitting(doing, width - 84, font(SIZE, True)), colour, font(SIZE, True), anchor="lm")
    if not moment.steps:
        draw.text((16, 30 + LINE / 2), "no plan yet", FAINT, font(SIZE), anchor="lm")
    most = (height - 30) // LINE
    begin = _first_shown([standing for _, standing in moment.steps], most)
    for row, (step, standing) in enumerate(moment.steps[begin : begin + most]):
        sign, colour = _LOOKS[standing]
        y = 30 + LINE * row + LINE / 2
        word = _WORDS.get(standing, standing.value)
        draw.text((16, y), sign, colour, font(SIZE), anchor="lm")
        letters = font(SIZE, standing is Standing.UNDER_WAY)
        room = width - 44 - int(font(SIZE - 2).getlength(word)) - 20
        draw.text((40, y), fitting(f"{begin + row + 1}. {step}", room, letters), colour, letters, anchor="lm")
        draw.text((width - 12, y), word, colour, font(SIZE - 2), anchor="rm")
    return np.asarray(image)


def _first_shown(standings: Sequence[Standing], most: int) -> int:
    """Two steps before the first that has not ended, and no fewer than there is room for."""
    ahead = next((i for i, s in enumerate(standings) if s not in (Standing.DONE, Standing.FAILED)), len(standings))
    return max(0, min(ahead - 2, len(standings) - most))


def atoms_panel(atoms: Mapping[str, float], width: int, height: int) -> Picture:
    """What holds, and what is in doubt with its probability, in two columns."""
    image, draw = _blank(width, height, BACKGROUND)
    draw.text((12, 16), "What holds" if atoms else "Nothing is known yet", FAINT, font(SIZE, True), anchor="lm")
    shown = [(a, p) for a, p in sorted(atoms.items()) if p > HOLDS or p > DOUBTFUL]
    # What a plan waits for comes last where there is not room for all.
    shown.sort(key=lambda item: item[1] <= HOLDS)
    rows = (height - 30) // LINE
    hidden = max(0, len(shown) - 2 * rows)
    for i, (atom, p) in enumerate(shown[: 2 * rows - (1 if hidden else 0)]):
        x, y = 12 + i // rows * (width // 2), 30 + LINE * (i % rows) + LINE / 2
        doubtful = DOUBTFUL < p < 1 - DOUBTFUL
        text = f"{atom}  {p:.2f}" if doubtful else atom
        colour = NOW if doubtful else TEXT
        draw.text((x, y), fitting(text, width // 2 - 18, font(SIZE - 1)), colour, font(SIZE - 1), anchor="lm")
    if hidden:
        corner = (12 + width // 2, 30 + LINE * (rows - 1) + LINE / 2)
        draw.text(corner, f"and {hidden + 1} more", FAINT, font(SIZE - 1), anchor="lm")
    return np.asarray(image)


def _blank(width: int, height: int, colour: Colour) -> tuple[Image.Image, ImageDraw.ImageDraw]:
    image = Image.new("RGB", (width, height), colour)
    return image, ImageDraw.Draw(image)


def _labelled(image: Image.Image, draw: ImageDraw.ImageDraw, label: str) -> Image.Image:
    text = fitting(label, image.width - 24, font(15))
    draw.rectangle((0, 0, font(15).getlength(text) + 16, 24), BACKGROUND)
    draw.text((8, 12), text, TEXT, font(15), anchor="lm")
    return image
