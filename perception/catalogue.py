"""What is known about the things on the table before looking: colours, ranges of sizes, nominal dimensions.

The ranges are what perception accepts, a little wider than what the factory promises; the true size of a block and
of the box is measured. Lengths in m.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType


@dataclass(frozen=True, kw_only=True)
class Catalogue:
    """One kind of block in several colours, and one kind of open box, on a table."""

    hues: Mapping[str, float] = field(
        default_factory=lambda: MappingProxyType({"b0": 0.00, "b1": 0.60, "b2": 0.14, "b3": 0.36})
    )
    """Hue of each block by its name, in [0, 1): red, blue, yellow, green. Several blocks may have the same."""
    hue_tolerance: float = 0.06
    least_saturation: float = 0.30
    least_value: float = 0.15

    block_width: tuple[float, float] = (0.040, 0.080)
    block_height: tuple[float, float] = (0.036, 0.062)
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

    @property
    def look_alikes(self) -> tuple[tuple[str, ...], ...]:
        """Names of blocks, those of one hue together."""
        groups: dict[float, list[str]] = {}
        for name, hue in self.hues.items():
            groups.setdefault(hue, []).append(name)
        return tuple(map(tuple, groups.values()))
