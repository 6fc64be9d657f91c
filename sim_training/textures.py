"""Procedural surfaces: how light and dark vary over a table or a box. Hue stays, for blocks are told apart by it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    "speckle": _speckle,
    "stripes": _stripes,
    "checks": _checks,
    "blotches": _blotches,
}
TRAINED = ("grain", "speckle", "stripes")
UNSEEN = ("checks", "blotches")
"""Kept from every training, so that evaluation shows what the robot makes of surfaces it never saw."""


@lru_cache(maxsize=64)
def surface(kind: str, seed: int, contrast: float, colour: tuple[float, float, float]) -> UInt8[np.ndarray, "s s 4"]:
    """RGBA of a surface of this colour whose brightness varies by the share `contrast`."""
    light = 1.0 - contrast * _KINDS[kind](np.random.default_rng(seed))
    rgb = np.asarray(colour, dtype=np.float64) * light[..., None]
    opaque = np.ones((SIZE, SIZE, 1))
    return (np.concatenate([np.clip(rgb, 0, 1), opaque], -1) * 255).astype(np.uint8)


def draw_surface(rng: np.random.Generator, kinds: Sequence[str]) -> dict[str, object]:
    """What `surface` needs besides the colour, as plain data."""
    return {
        "kind": str(rng.choice(list(kinds))),
        "seed": int(rng.integers(2**31)),
        "contrast": float(rng.uniform(0.1, 0.5)),
    }
