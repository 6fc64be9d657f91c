"""The light of a scene: one to three lamps, of which the first may cast shadows, and what the camera makes of it.

The renderer has one shadow map for lamps that are far away; filling it costs as much as a small picture itself, however
fine it is. Its texels make a shadow hard or soft, for an edge is drawn over a few of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import sapien

LIT = (0.45, 0.0, 0.15)
"""m; the middle of what a shadow map covers: box, blocks and the hand above them."""
LIT_HALF = 0.45
"""m that it covers to each side; what lies further off is lit."""


@dataclass(frozen=True, kw_only=True)
class Lighting:
    """From where light and camera settings are drawn.

    Attributes:
        lamps: fewest and most.
        tilt: how far the first lamp stands aside, in m for each m of height, least and most.
        strength: of all lamps together.
        others: of any but the first lamp, as a share of that.
        ambient: light from everywhere, which shadows keep.
        shadows: probability that the first lamp casts any.
        texels: of a side of the shadow map; few are soft.
        tint: least of each colour in a lamp's light.
        gamma: of the camera, from 1 (values as light falls in) to 2.2 (as screens expect).
        exposure: how light a white surface in full light becomes, of what a picture can show.
        white_balance: most relative error of each colour.
    """

    lamps: tuple[int, int] = (1, 3)
    tilt: tuple[float, float] = (0.0, 0.7)
    strength: tuple[float, float] = (1.3, 2.4)
    others: tuple[float, float] = (0.2, 0.6)
    ambient: tuple[float, float] = (0.2, 0.55)
    shadows: float = 0.5
    texels: tuple[int, ...] = (128, 256, 384)
    tint: float = 0.93
    gamma: tuple[float, float] = (1.0, 2.2)
    exposure: tuple[float, float] = (0.75, 1.15)
    white_balance: float = 0.04


TRAINED = Lighting()
UNSEEN = Lighting(
    tilt=(0.7, 1.0), strength=(2.4, 2.8), ambient=(0.14, 0.2), shadows=0.8, texels=(512, 768), tint=0.88,
    exposure=(0.6, 0.75), white_balance=0.06,
)  # fmt: skip
"""Beyond the edges of training: lower and stronger lamps, sharper shadows, stronger tints, darker pictures."""
HARD = Lighting(
    lamps=(1, 1), tilt=(0.5, 1.2), strength=(1.8, 2.6), ambient=(0.06, 0.12), shadows=1.0, texels=(1024,), tint=0.90
)
"""A single lamp that casts dark shadows."""


def draw_lighting(rng: np.random.Generator, ranges: Lighting) -> dict[str, Any]:
    """`light` and `camera` of a world, as plain data."""
    count = int(rng.integers(ranges.lamps[0], ranges.lamps[1] + 1))
    total, ambient = float(rng.uniform(*ranges.strength)), float(rng.uniform(*ranges.ambient))
    # Cameras set themselves to the light, or else coloured blocks would burn out and lose their hue. What they would
    # take in is all that is rendered, for a picture that was burnt out cannot be mended afterwards.
    exposed = float(rng.uniform(*ranges.exposure)) / (ambient + total / np.pi)
    shares = np.array([1.0, *rng.uniform(*ranges.others, count - 1)])
    lamps = []
    for i, level in enumerate(exposed * total * shares / shares.sum()):
        aside, heading = rng.uniform(*ranges.tilt) if i == 0 else rng.uniform(0.0, 1.0), rng.uniform(-np.pi, np.pi)
        lamps.append(
            {
                "direction": (float(aside * np.cos(heading)), float(aside * np.sin(heading)), -1.0),
                "colour": tuple(float(level * c) for c in rng.uniform(ranges.tint, 1.0, 3)),
            }
        )
    texels = int(rng.choice(ranges.texels)) if rng.random() < ranges.shadows else 0
    return {
        "light": {"ambient": exposed * ambient, "lamps": lamps, "texels": texels},
        "camera": {
            "gamma": float(rng.uniform(*ranges.gamma)),
            "white_balance": tuple(float(c) for c in 1 + ranges.white_balance * rng.uniform(-1, 1, 3)),
        },
    }


def add_lights(scene: sapien.Scene, light: Mapping[str, Any]) -> None:
    """Put up the lamps of a world's `light`; without one, two that cast no shadow."""
    level = float(light.get("ambient", 0.45))
    scene.set_ambient_light([level] * 3)
    usual = [
        {"direction": (0.3, 0.4, -1.0), "colour": (1.4, 1.4, 1.4)},
        {"direction": (-0.5, -0.6, -0.8), "colour": (0.56, 0.56, 0.56)},
    ]
    texels = int(light.get("texels", 0))
    for i, lamp in enumerate(light.get("lamps", usual)):
        shadow = {
            "shadow": True, "position": LIT, "shadow_scale": LIT_HALF, "shadow_near": -2.0, "shadow_far": 2.0,
            "shadow_map_size": texels,
        } if i == 0 and texels else {"shadow": False}  # fmt: skip
        scene.add_directional_light(lamp["direction"], list(lamp["colour"]), **shadow)
