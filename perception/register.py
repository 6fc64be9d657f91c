"""Views brought into agreement: each is moved in the plane until its picture of the box's rim fits the common one.

The table corrects a camera's height and tilt; its place and heading in the plane remain, a millimetre or two. All views
see some of the rim, and their mean error is smaller than that of the two or three that see a certain block.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from resync_robot.core import spatial
from resync_robot.core.rig import CameraRig
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.outline import coverage, grid, outward_of_ring, vote
from resync_robot.perception.views import BACKGROUND, View

_LEVER = 0.3
"""m; an angle times this is a length, so that the three unknowns are alike."""
_VOTE_SIGMA = 0.15
_BOX_SIGMA = 0.0003
"""How well the common box is known along each unknown, at best, m."""
_CELLS_PER_SIGHT = 10.0
"""Neighbouring cells share pixels: so many count as one independent sight."""


def align_to_box(view: View, box: Float[np.ndarray, "11"], catalogue: Catalogue, camera: CameraRig) -> View:
    """The same view, turned and shifted in the plane towards the box that all views agree on.

    How far follows from what the view sees of the rim, against how well its camera's pose is known beforehand.

    Args:
        box: features of the box, estimated from all views together.
        camera: whose sigmas say how wrong a view's pose may be.
    """
    centre, yaw, inner = box[:2], float(spatial.yaw_of(box[3:7])), box[7:9]
    cells = grid(centre, 0.29, 0.004)
    outward = outward_of_ring(cells, centre, yaw, inner, catalogue.wall_thickness)
    place, heading = max(camera.position_sigma, 1e-4), _LEVER * max(camera.rotation_sigma, 1e-4)
    prior = np.diag([place**2, place**2, heading**2])

    def of_rim(view: View) -> np.ndarray:
        return view.valid & (view.labels == BACKGROUND)

    votes = vote([view], cells, box[2] + box[9], of_rim, outward, by_depth=True)
    seen = votes.weight > 0.02
    if seen.sum() < 100:
        return view
    xy, filled, weight = votes.xy[seen], votes.filled[seen], np.sqrt(votes.weight[seen])

    def misfit(p: np.ndarray) -> np.ndarray:
        rim = coverage(xy, centre + p[:2], yaw + p[2] / _LEVER, (inner[0], inner[1]), catalogue.wall_thickness)
        return (rim - filled) * weight

    fit = least_squares(misfit, np.zeros(3), loss="soft_l1", f_scale=0.3, max_nfev=15, x_scale=0.005)
    information = fit.jac.T @ fit.jac / (_CELLS_PER_SIGHT * _VOTE_SIGMA**2)
    # A metre of doubt keeps a direction that the view does not show from being taken as measured.
    measured = np.linalg.inv(information + np.eye(3)) + np.eye(3) * _BOX_SIGMA**2
    gain = prior @ np.linalg.inv(prior + measured)
    x, y, turn = gain @ fit.x
    back = spatial.transform(spatial.rotation_about("z", -turn / _LEVER), np.zeros(3))
    back[:2, 3] = centre - back[:2, :2] @ (centre + (x, y))
    return view.moved(back @ view.world_T_cam)
