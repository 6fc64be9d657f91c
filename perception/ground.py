"""What things stand on: the table, the floor of the box, or that of a drawer's tray."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.fittings import Drawer
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.pose import inside_box


@dataclass(frozen=True)
class Ground:
    """How high the ground is, place by place.

    Attributes:
        box: (11,) features of core.vocabulary.BOX; None where no box is known.
        drawers: (11,) features of core.vocabulary.DRAWER by the catalogue's names.
    """

    catalogue: Catalogue
    box: Float[np.ndarray, "11"] | None
    drawers: Mapping[str, Float[np.ndarray, "11"]] = field(default_factory=dict)

    def height(self, xy: Float[np.ndarray, "2"]) -> float:
        """m in the world."""
        name = self.tray_at(xy)
        if name is not None:
            return self.catalogue.table_z + self.catalogue.drawers[name].floor
        inside = self.box is not None and inside_box(xy, self.box)
        return self.catalogue.table_z + (self.catalogue.floor_thickness if inside else 0.0)

    def tray_at(self, xy: Float[np.ndarray, "2"]) -> str | None:
        """Name of the drawer whose tray is there."""
        return next((n for n, f in self.drawers.items() if _inside_tray(xy, f, self.catalogue.drawers[n])), None)

    def is_under_cabinet(self, xy: Float[np.ndarray, "2"], width: float) -> bool:
        """Does a cabinet hide, from above, some of a block of that width (m) which stands in its drawer?"""
        name = self.tray_at(xy)
        if name is None:
            return False
        ahead, _ = _in_front_frame(xy, self.drawers[name])
        return bool(ahead + self.catalogue.drawers[name].front[0] / 2 + self.drawers[name][7] < width / 2)


def _inside_tray(xy: Float[np.ndarray, "2"], features: Float[np.ndarray, "11"], drawer: Drawer) -> bool:
    """Is a point of the table between the walls of the tray of a drawer with these features?"""
    ahead, beside = _in_front_frame(xy, features)
    deep, wide, _ = drawer.tray
    return bool(-deep < ahead + drawer.front[0] / 2 < 0 and abs(beside) < wide / 2)


def _in_front_frame(xy: Float[np.ndarray, "2"], features: Float[np.ndarray, "11"]) -> Float[np.ndarray, "2"]:
    """A point of the table ahead of the middle of a drawer's front and beside it, m."""
    yaw = float(spatial.yaw_of(features[3:7]))
    along = np.array([np.cos(yaw), np.sin(yaw)])
    away = xy - features[:2]
    return np.array([along @ away, along[0] * away[1] - along[1] * away[0]])
