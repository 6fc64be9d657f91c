"""How lids and drawers are built: what is the same for each of them, and so is no feature of a state. Lengths in m.

A state says where a lid or a drawer is, and how large its plate or front; see core.vocabulary.LID and DRAWER.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial


@dataclass(frozen=True, kw_only=True)
class Lid:
    """A flat plate with a knob in the middle of its upper face.

    Attributes:
        size: full extents of the plate along x, y, z.
        knob: the same of the knob.
    """

    size: tuple[float, float, float] = (0.34, 0.34, 0.012)
    knob: tuple[float, float, float] = (0.030, 0.030, 0.045)


@dataclass(frozen=True, kw_only=True)
class Drawer:
    """A tray behind a front, which slides out of its cabinet along x. The cabinet is open at its face, so that what
    stands in the tray may be higher than the front.

    Attributes:
        front, cabinet: full extents along x, y, z. Between the two, an open drawer lies lower than its front.
        travel: the widest opening.
        lift: height of the front's lower edge above the table.
        tray: interior of the tray along x and y, and the height of its walls above its floor.
        floor: height of the tray's floor above the table.
        wall: thickness of what tray and cabinet are made of.
        bar: full extents of the handle, a bar along y.
        reach: from the front's outer face to that of the bar: far enough for a hand on the bar to pass the cabinet.
        bar_z: height of the middle of the bar above the table.
    """

    front: tuple[float, float, float] = (0.012, 0.24, 0.090)
    cabinet: tuple[float, float, float] = (0.22, 0.24, 0.20)
    travel: float = 0.17
    lift: float = 0.004
    tray: tuple[float, float, float] = (0.20, 0.19, 0.07)
    floor: float = 0.012
    wall: float = 0.009
    bar: tuple[float, float, float] = (0.012, 0.10, 0.012)
    reach: float = 0.070
    bar_z: float = 0.045

    def face(self, features: Float[np.ndarray, "11"]) -> Float[np.ndarray, "4 4"]:
        """world_T_face of a drawer with these features: on the table under the middle of the face of its cabinet, x the
        way that it opens."""
        x, z = -features[7] - self.front[0] / 2, -self.lift - self.front[2] / 2
        return spatial.pose_from_features(features[:7]) @ spatial.transform(None, np.array([x, 0.0, z]))


LID, DRAWER = Lid(), Drawer()
"""Those of which there are simulations."""
