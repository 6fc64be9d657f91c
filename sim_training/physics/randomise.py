"""What is drawn anew for every episode: friction, masses, gains, sizes, colours, surfaces, light."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from resync_robot.sim_training.physics import lights, textures
from resync_robot.sim_training.physics.lights import Lighting, draw_lighting
from resync_robot.sim_training.physics.solver import MOST_ITERATIONS, SHIPPED, Solver

BLOCK_HUES = {"b0": 0.00, "b1": 0.60, "b2": 0.14, "b3": 0.36}
"""Red, blue, yellow, green: what tells the blocks apart for a camera."""

FITTING_HUES = {"lid": 0.80, "drawer": 0.48, "drawer_cabinet": 0.25}
"""Purple, turquoise, and the green of limes."""


@dataclass(frozen=True, kw_only=True)
class Ranges:
    """From where physics and looks are drawn.

    Attributes:
        edges: draw near the edges more often than between them (the arcsine law): there it is hard, and from there on
            nothing was ever tried.
        solver: draw the solver and its contacts too, around what is shipped; else they are what is shipped.
        beyond: 0 draws between the edges that are written at each quantity. Above, it draws outside them on either
            side, up to this share of the edge: worlds like none in training.
        surfaces: kinds of surfaces of table and box; none: they are plain.
        lighting: of lamps, shadows and the camera's settings.
    """

    edges: bool = False
    solver: bool = False
    beyond: float = 0.0
    surfaces: tuple[str, ...] = ()
    lighting: Lighting = lights.TRAINED

    def draw(self, rng: np.random.Generator, low: float, high: float) -> float:
        """One value between the edges, or outside them."""
        # Always from one uniform draw, so that a world keeps all else whatever the ranges.
        share = float(rng.uniform())
        if self.edges:
            share = float(np.sin(np.pi / 2 * share) ** 2)
        if self.beyond == 0.0:
            return low + share * (high - low)
        return low * (1 - self.beyond * (1 - 2 * share)) if share < 0.5 else high * (1 + self.beyond * (2 * share - 1))


USUAL = Ranges()
PRACTICE = Ranges(edges=True, solver=True)
"""What training draws."""
PICTURED = Ranges(edges=True, solver=True, surfaces=textures.TRAINED)
"""What camera policies learn from."""
UNSEEN = Ranges(beyond=0.10, surfaces=textures.UNSEEN, lighting=lights.UNSEEN)
"""Up to a tenth beyond the edges of training, with surfaces and lights that it never drew."""
HARD = Ranges(surfaces=textures.TRAINED, lighting=lights.HARD)
"""Between the edges of training, under a lamp that casts darker shadows than training has."""
LOOKS = {"usual": PICTURED, "unseen": UNSEEN, "hard": HARD}
"""What pictures are judged in, by the names that `evaluate --worlds` has for it."""


def draw_physics(rng: np.random.Generator, blocks: Sequence[str], ranges: Ranges = USUAL) -> dict[str, Any]:
    """Physics and looks of one episode. Friction combines by average: pad on block stays well above
    block on box floor, or no hand could press and drag. Pads yield as rubber does."""
    physics = {
        "friction_pad": ranges.draw(rng, 1.0, 1.3),
        "friction_block": ranges.draw(rng, 0.3, 0.55),
        "friction_box": ranges.draw(rng, 0.2, 0.42),
        "gain": ranges.draw(rng, 0.8, 1.2),
        "masses": {b: ranges.draw(rng, 0.05, 0.16) for b in blocks},
        **draw_looks(rng, blocks, ranges),
    }
    if ranges.solver:
        physics["solver"] = draw_solver(rng)
    # Between rigid pads one block of a tower is always a hair wider, and carries the whole grip.
    return physics | {"pad_stiffness": ranges.draw(rng, 0.75e4, 1.5e4)}


def draw_fittings(rng: np.random.Generator, ranges: Ranges = USUAL) -> dict[str, Any]:
    """Physics and looks of a lid, and of a drawer, which it takes `stiction` N to move."""
    lid = {"mass": ranges.draw(rng, 0.3, 0.5), "friction": ranges.draw(rng, 0.3, 0.5)}
    drawer = {
        "mass": ranges.draw(rng, 0.4, 0.7),
        "friction": ranges.draw(rng, 0.25, 0.4),
        "stiction": ranges.draw(rng, 1.5, 4.0),
    }
    looks = {name: _coloured(rng, hue) for name, hue in FITTING_HUES.items()}
    steel = rng.uniform(0.25, 0.45)
    drawer_looks = {"colour": looks["drawer"], "cabinet_colour": looks["drawer_cabinet"], "handle_colour": (steel,) * 3}
    return {
        "lid": {**lid, "colour": looks["lid"]},
        "drawer": {**drawer, **drawer_looks},
    }


def draw_solver(rng: np.random.Generator) -> Solver:
    """The shipped physics, solved a little more coarsely or more finely, with other contacts."""
    iterations = round(SHIPPED.iterations * float(np.exp(rng.uniform(np.log(0.8), np.log(1.25)))))
    return replace(
        SHIPPED,
        iterations=min(iterations, MOST_ITERATIONS),
        contact_offset=float(rng.uniform(0.005, 0.012)),
        restitution=float(rng.uniform(0.0, 0.1)),
    )


def draw_looks(rng: np.random.Generator, blocks: Sequence[str], ranges: Ranges = USUAL) -> dict[str, Any]:
    """Colours near the catalogue's, surfaces, lamps, and the settings of the camera."""
    colours = {name: _coloured(rng, BLOCK_HUES.get(name, 0.8)) for name in blocks}
    grey, wood = rng.uniform(0.28, 0.42), rng.uniform(0.9, 1.1)
    looks: dict[str, Any] = {
        "colours": colours,
        "box_colour": (grey, grey + 0.01, grey + 0.02),
        "table_colour": tuple(float(np.clip(c * wood, 0, 1)) for c in (0.75, 0.70, 0.62)),
    }
    # Of a generator of its own: a world keeps all else whatever its light and surfaces.
    own = np.random.default_rng((2**32 * rng.random(7)).astype(np.uint32))
    looks |= draw_lighting(own, ranges.lighting)
    if ranges.surfaces:
        looks["gloss"] = float(own.uniform(0.25, 0.7))
        looks["surfaces"] = {
            what: textures.draw_surface(own, ranges.surfaces, shade) for what, shade in (("table", 1.0), ("box", 0.6))
        }
    return looks


def _coloured(rng: np.random.Generator, hue: float) -> tuple[float, float, float]:
    """(r, g, b) of a strong colour near a hue."""
    hue = (hue + rng.uniform(-0.02, 0.02)) % 1.0
    return colorsys.hsv_to_rgb(hue, rng.uniform(0.8, 0.95), rng.uniform(0.65, 0.9))
