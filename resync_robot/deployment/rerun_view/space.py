"""Things in space, as they are believed to be and as they are: edges, and ellipsoids of uncertainty."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import rerun as rr

from resync_robot.core import spatial
from resync_robot.core.solids import boxes
from resync_robot.core.state import State
from resync_robot.core.symbols import SE3
from resync_robot.core.vocabulary import BOX
from resync_robot.deployment.rerun_view.series import pose_of

SIGMAS = 2.0
"""Half axes of the uncertainty ellipsoids, in standard deviations."""
DOUBT = (220, 60, 160, 90)


@dataclass(frozen=True)
class Look:
    """Of the edges of an object: colour, half width in m, and whether its name stands beside it."""

    colour: tuple[int, int, int]
    line: float
    labelled: bool


BELIEF, TRUTH = Look((240, 150, 40), 0.0012, True), Look((60, 180, 90), 0.0006, False)


def draw_states(states: Iterator[tuple[float, State]], recording: rr.RecordingStream, root: str, look: Look) -> None:
    before: set[str] = set()
    for time, state in states:
        recording.set_time("time", duration=time)
        now = {o.name for o in state if o.type.pose == SE3 and (o.type == BOX or o.type.extents)}
        for name in before - now:
            recording.log(f"{root}/{name}", rr.Clear(recursive=True))
            recording.log(f"{root}_uncertainty/{name}", rr.Clear(recursive=True))
        before = now
        for obj in state:
            if obj.name not in now:
                continue
            entity = f"{root}/{obj.name}"
            features = state[obj]
            recording.log(entity, pose_of(spatial.pose_from_features(features[:7])))
            centers, half_sizes = boxes(obj, features)
            body = rr.Boxes3D(
                centers=centers, half_sizes=half_sizes, colors=look.colour, radii=look.line,
                labels=[obj.name], show_labels=look.labelled and obj.type != BOX,
            )  # fmt: skip
            recording.log(f"{entity}/body", body)
            covariance = state.covariance(obj)
            if covariance is not None:
                recording.log(f"{root}_uncertainty/{obj.name}", _ellipsoid(features[:3], covariance[:3, :3]))


def _ellipsoid(center: np.ndarray, covariance: np.ndarray) -> rr.Ellipsoids3D:
    variances, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    axes = axes * np.sign(np.linalg.det(axes))
    half = SIGMAS * np.sqrt(np.clip(variances, 1e-10, None))
    quaternion = rr.Quaternion(xyzw=np.roll(spatial.quat_from_matrix(axes), -1))
    return rr.Ellipsoids3D(centers=[center], half_sizes=[half], quaternions=[quaternion], colors=DOUBT)
