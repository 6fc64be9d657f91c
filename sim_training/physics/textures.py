"""Procedural surfaces of wood, paint and metal: how light and dark vary over a table or a box, and how they shine.

Hue stays, and is faint, for blocks are told apart by it.
"""

from __future__ import annotations

import colorsys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, UInt8

SIZE = 256


def _smooth(rng: np.random.Generator, cells: tuple[int, int]) -> Float[np.ndarray, "s s"]:
    """Noise in [0, 1] with so many cells along each axis."""
    coarse = rng.random(cells).astype(np.float32)
    return np.clip(cv2.resize(coarse, (SIZE, SIZE), interpolation=cv2.INTER_CUBIC), 0.0, 1.0)


def _grain(rng: np.random.Generator) -> np.ndarray:
    return 0.7 * _smooth(rng, (int(rng.integers(20, 60)), 3)) + 0.3 * _smooth(rng, (60, 6))


def _rings(rng: np.random.Generator) -> np.ndarray:
    """The rings of a tree, cut along its length a little askew."""
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE
    away = np.hypot(y - rng.uniform(-0.5, 1.5), 0.2 * (x - rng.uniform(-1, 2))) + 0.06 * _smooth(rng, (5, 3))
    return 0.5 + 0.5 * np.sin(2 * np.pi * rng.uniform(8, 25) * away)


def _brushed(rng: np.random.Generator) -> np.ndarray:
    return 0.6 * _smooth(rng, (SIZE, 2)) + 0.4 * _smooth(rng, (SIZE // 2, 8))


def _speckle(rng: np.random.Generator) -> np.ndarray:
    n = int(rng.integers(30, 120))
    return _smooth(rng, (n, n))


def _stripes(rng: np.random.Generator) -> np.ndarray:
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE
    angle, count = rng.uniform(0, np.pi), rng.uniform(3, 12)
    return 0.5 + 0.5 * np.sin(2 * np.pi * count * (x * np.cos(angle) + y * np.sin(angle)) + rng.uniform(0, 6))


def _checks(rng: np.random.Generator) -> np.ndarray:
    y, x = np.mgrid[0:SIZE, 0:SIZE] * int(rng.integers(4, 14)) // SIZE
    return ((x + y) % 2).astype(np.float32)


def _blotches(rng: np.random.Generator) -> np.ndarray:
    n = int(rng.integers(4, 10))
    return (_smooth(rng, (n, n)) > 0.5).astype(np.float32)


_KINDS: dict[str, Callable[[np.random.Generator], np.ndarray]] = {
    "grain": _grain,
    "rings": _rings,
    "brushed": _brushed,
    "speckle": _speckle,
    "stripes": _stripes,
    "checks": _checks,
    "blotches": _blotches,
}
TRAINED = ("grain", "rings", "speckle", "stripes", "brushed")
UNSEEN = ("checks", "blotches")
"""Kept from every training, so that evaluation shows what the robot makes of surfaces it never saw."""


@dataclass(frozen=True)
class _Stuff:
    """Ranges of what a surface is made of: least and most of hue, saturation, value, roughness, metallic, contrast."""

    hue: tuple[float, float]
    saturation: tuple[float, float]
    value: tuple[float, float]
    roughness: tuple[float, float]
    metallic: tuple[float, float]
    contrast: tuple[float, float]


_WOOD = _Stuff((0.06, 0.11), (0.10, 0.28), (0.35, 0.80), (0.5, 0.9), (0.0, 0.0), (0.1, 0.5))
_PAINT = _Stuff((0.0, 1.0), (0.0, 0.12), (0.25, 0.85), (0.25, 0.9), (0.0, 0.0), (0.03, 0.4))
_METAL = _Stuff((0.5, 0.7), (0.0, 0.06), (0.45, 0.80), (0.25, 0.5), (0.2, 0.5), (0.1, 0.4))
_MADE_OF = {
    "grain": _WOOD,
    "rings": _WOOD,
    "speckle": _PAINT,
    "stripes": _PAINT,
    "brushed": _METAL,
    "checks": _PAINT,
    "blotches": _METAL,
}


@lru_cache(maxsize=64)
def surface(kind: str, seed: int, contrast: float, colour: tuple[float, float, float]) -> UInt8[np.ndarray, "s s 4"]:
    """RGBA of a surface of this colour whose brightness varies by the share `contrast`."""
    light = 1.0 - contrast * _KINDS[kind](np.random.default_rng(seed))
    rgb = np.asarray(colour, dtype=np.float64) * light[..., None]
    opaque = np.ones((SIZE, SIZE, 1))
    return (np.concatenate([np.clip(rgb, 0, 1), opaque], -1) * 255).astype(np.uint8)


def draw_surface(rng: np.random.Generator, kinds: Sequence[str], shade: float = 1.0) -> dict[str, object]:
    """A surface as plain data: what `surface` needs, and `roughness` and `metallic`.

    Args:
        shade: factor on how light it is: a box is darker than a table.
    """
    kind = str(rng.choice(list(kinds)))
    stuff = _MADE_OF[kind]
    hue, saturation, value, roughness, metallic, contrast = (float(rng.uniform(*r)) for r in vars(stuff).values())
    return {
        "kind": kind,
        "seed": int(rng.integers(2**31)),
        "contrast": contrast,
        "colour": colorsys.hsv_to_rgb(hue, saturation, shade * value),
        "roughness": roughness,
        "metallic": metallic,
    }
