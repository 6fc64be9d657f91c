"""What is drawn anew for every episode: friction, masses, gains, sizes, colours, light."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from typing import Any

import numpy as np

BLOCK_HUES = {"b0": 0.00, "b1": 0.60, "b2": 0.14, "b3": 0.36}
"""Red, blue, yellow, green: what tells the blocks apart for a camera."""


def draw_physics(rng: np.random.Generator, blocks: Sequence[str]) -> dict[str, Any]:
    """Physics and looks of one episode. Friction combines by average: pad on block stays well above
    block on box floor, or no hand could press and drag."""
    return {
        "friction_pad": float(rng.uniform(1.0, 1.3)),
        "friction_block": float(rng.uniform(0.3, 0.55)),
        "friction_box": float(rng.uniform(0.2, 0.42)),
        "gain": float(rng.uniform(0.8, 1.2)),
        "masses": {b: float(rng.uniform(0.05, 0.16)) for b in blocks},
        **draw_looks(rng, blocks),
    }


def draw_looks(rng: np.random.Generator, blocks: Sequence[str]) -> dict[str, Any]:
    """Colours near the catalogue's, and a light."""
    colours = {}
    for name in blocks:
        hue = (BLOCK_HUES.get(name, 0.8) + rng.uniform(-0.02, 0.02)) % 1.0
        colours[name] = colorsys.hsv_to_rgb(hue, rng.uniform(0.8, 0.95), rng.uniform(0.65, 0.9))
    grey, wood = rng.uniform(0.28, 0.42), rng.uniform(0.9, 1.1)
    return {
        "colours": colours,
        "box_colour": (grey, grey + 0.01, grey + 0.02),
        "table_colour": tuple(float(np.clip(c * wood, 0, 1)) for c in (0.75, 0.70, 0.62)),
        "light": {
            "ambient": float(rng.uniform(0.35, 0.55)),
            "strength": float(rng.uniform(1.0, 1.7)),
            "tint": tuple(float(c) for c in rng.uniform(0.93, 1.0, 3)),
            "direction": (float(rng.uniform(-0.5, 0.5)), float(rng.uniform(-0.5, 0.5)), -1.0),
        },
    }
