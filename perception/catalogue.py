"""What is known about the things on the table before looking: colours, ranges of sizes, nominal dimensions.

The ranges are what perception accepts, a little wider than what the factory promises; the true size of a block and
of the box is measured, a lid and a drawer have the size that stands here. Lengths in m.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from resync_robot.core.errors import ConfigError
from resync_robot.core.fittings import Drawer, Lid

CABINET = "_cabinet"
"""Ends the name under which the colour of a drawer's cabinet stands in `hues`."""
BLOCK_HUES: Mapping[str, float] = MappingProxyType({"b0": 0.00, "b1": 0.60, "b2": 0.14, "b3": 0.36})
"""Red, blue, yellow, green."""
FITTING_HUES: Mapping[str, float] = MappingProxyType({"lid": 0.80, "drawer": 0.48, "drawer" + CABINET: 0.25})
"""Purple, turquoise, and the green of limes: of a lid and a drawer where a task has them."""


@dataclass(frozen=True, kw_only=True)
class Catalogue:
    """One kind of block in several colours, and one kind of open box, on a table; maybe lids and drawers.

    Raises:
        ConfigError: a lid or a drawer that looks like something else, or a drawer without a colour for its cabinet.
    """

    hues: Mapping[str, float] = field(default_factory=lambda: BLOCK_HUES)
    """Hue of each thing by its name, in [0, 1). Several blocks may have the same."""
    hue_tolerance: float = 0.06
    least_saturation: float = 0.30
    least_chroma: float = 0.03
    """Saturation times value. A strong colour is sure of its hue even in a deep shadow; a dark, pale one is noise."""

    block_width: tuple[float, float] = (0.036, 0.084)
    block_height: tuple[float, float] = (0.033, 0.062)
    stud_width: float = 0.024
    stud_height: float = 0.012

    table_z: float = 0.0
    """Height of the table top in the world."""
    floor_thickness: float = 0.005
    """Height of the upper face of the box's floor above the table."""
    wall_thickness: float = 0.030
    rim_height: tuple[float, float] = (0.085, 0.130)
    """Height of the box's rim above the table."""
    box_inner: tuple[float, float] = (0.24, 0.36)

    lids: Mapping[str, Lid] = field(default_factory=lambda: MappingProxyType({"lid": Lid()}))
    drawers: Mapping[str, Drawer] = field(default_factory=lambda: MappingProxyType({"drawer": Drawer()}))
    """Each looked for where `hues` has its name, a drawer's cabinet under the name that ends in `CABINET`."""

    def __post_init__(self) -> None:
        for name in self.drawers:
            if (name in self.hues) != (name + CABINET in self.hues):
                raise ConfigError(
                    f"of the drawer '{name}' only one colour is known; its front and its cabinet need one each",
                    f"give both {name} and {name}{CABINET} a line under [hues] of the rig file",
                )
        for names in self.look_alikes:
            if len(names) > 1 and not set(names) <= set(self.blocks):
                raise ConfigError(
                    f"{' and '.join(names)} have the same hue, {self.hues[names[0]]:g}; only blocks may look alike",
                    "change one of them under [hues] of the rig file",
                )

    @property
    def blocks(self) -> tuple[str, ...]:
        """Names in `hues` that are those of blocks."""
        others = {*self.lids, *self.drawers, *(name + CABINET for name in self.drawers)}
        return tuple(name for name in self.hues if name not in others)

    @property
    def coloured_lids(self) -> tuple[str, ...]:
        """Names of lids that `hues` has a colour for."""
        return tuple(name for name in self.lids if name in self.hues)

    @property
    def coloured_drawers(self) -> tuple[str, ...]:
        """Names of drawers that `hues` has colours for."""
        return tuple(name for name in self.drawers if name in self.hues)

    @property
    def look_alikes(self) -> tuple[tuple[str, ...], ...]:
        """Names of things, those of one hue together."""
        groups: dict[float, list[str]] = {}
        for name, hue in self.hues.items():
            groups.setdefault(hue, []).append(name)
        return tuple(map(tuple, groups.values()))
