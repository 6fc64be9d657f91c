"""From labelled views to lids and drawers: cuboids of known size, found by their upper faces.

What does not measure what the catalogue says is not one of them; what is seen twice is reported and not chosen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.fittings import Drawer, Lid
from resync_robot.perception.catalogue import CABINET, Catalogue
from resync_robot.perception.outline import (
    Rectangle,
    Votes,
    fit_rectangle,
    grid,
    least_seen_edge,
    outward_of_rectangle,
    rough_rectangle,
    vote,
)
from resync_robot.perception.patches import UPRIGHT_WITHIN, patches_of, tilt_of
from resync_robot.perception.pose import HEIGHT_SIGMA, ViewSigma, fitted_covariance, peak_height
from resync_robot.perception.views import View

LID_SIGMA, DRAWER_SIGMA = ViewSigma(place=0.0012, yaw=0.0026), ViewSigma(place=0.0009, yaw=0.0056)
"""A drawer stands to the side, where fewer views see it. Fitted to errors in ray-cast scenes."""
OPENING_SIGMA = 0.0004
"""m; front and cabinet are seen in the same views, whose errors move both alike."""
ROUGHLY = 0.03
"""m by which the points of a face may seem larger or smaller than it is, before its edges are fitted."""
SIZE_TOLERANCE = 0.006
"""m by which fitted extents may differ from those of the catalogue."""
EDGE_SEEN = 0.5
"""Share of what lies outside an edge that some picture must show, or the face may go on there."""
OFF_THE_AXIS = 0.008
"""m by which the middle of a drawer's front may seem to lie beside the cabinet's."""
ASKEW = np.radians(5.0)
"""By which front and cabinet may seem turned against each other."""


@dataclass(frozen=True)
class FittingEstimate:
    """One lid or drawer. `features` and `covariance` are those of core.vocabulary.LID, or of DRAWER; an opening near 0
    may come out a little negative."""

    name: str
    features: Float[np.ndarray, "f"]
    covariance: Float[np.ndarray, "f f"]


@dataclass(frozen=True)
class Fittings:
    """What a scan says about lids and drawers.

    Attributes:
        found: by name.
        seen_twice: name -> (n, 2) places in m where something was seen that may be it.
        without_depth: names of those that show in the pictures, where these hold no depth.
        seen_in_part: name of one not found -> (n, 2) places in m of something that may be it, of which an edge is
            outside all pictures or hidden in them. Another look there may show all of it.
    """

    found: Mapping[str, FittingEstimate]
    seen_twice: Mapping[str, Float[np.ndarray, "n 2"]]
    without_depth: tuple[str, ...]
    seen_in_part: Mapping[str, Float[np.ndarray, "n 2"]]


@dataclass(frozen=True)
class _Outline:
    """A level face before its edges are fitted. `rough`: centre (2,), yaw, extents (2,)."""

    votes: Votes
    rough: tuple[np.ndarray, float, np.ndarray]
    top_z: float

    @property
    def whole(self) -> bool:
        return least_seen_edge(self.votes, self.rough, SIZE_TOLERANCE) >= EDGE_SEEN


@dataclass(frozen=True)
class _Face:
    """A level rectangle of known extents; `yaw` in [-pi/2, pi/2) turns the world's x to the first of these."""

    fit: Rectangle
    yaw: float
    top_z: float
    views: int

    @property
    def xy(self) -> np.ndarray:
        return np.array([self.fit.x, self.fit.y])


def estimate_fittings(views: Sequence[View], catalogue: Catalogue) -> Fittings:
    """Every lid and drawer whose colour the catalogue has and whose upper faces are seen."""
    index = {names[0]: i for i, names in enumerate(catalogue.look_alikes)}
    without_depth: list[str] = []
    in_part: dict[str, list[np.ndarray]] = {}

    def faces(name: str, of_part: str, extents: tuple[float, float]) -> list[_Face]:
        patches, blind = patches_of(views, index[of_part], catalogue)
        if blind and name not in without_depth:
            without_depth.append(name)
        outlines = [_outline(views, index[of_part], patch, np.array(extents)) for patch in patches]
        in_part.setdefault(name, []).extend(o.rough[0] for o in outlines if o is not None and not o.whole)
        fitted = [_fit_face(o, np.array(extents)) for o in outlines if o is not None and o.whole]
        return [face for face in fitted if face is not None]

    estimates: dict[str, list[FittingEstimate]] = {}
    for name in catalogue.coloured_lids:
        lid = catalogue.lids[name]
        estimates[name] = [_lid(name, lid, face) for face in faces(name, name, lid.size[:2])]
    for name in catalogue.coloured_drawers:
        drawer = catalogue.drawers[name]
        fronts = faces(name, name, drawer.front[:2])
        cabinets = faces(name, name + CABINET, drawer.cabinet[:2])
        pairs = [_drawer(name, drawer, f, c, catalogue.table_z) for f in fronts for c in cabinets]
        estimates[name] = [e for e in pairs if e is not None]
    found = {name: seen[0] for name, seen in estimates.items() if len(seen) == 1}
    seen_twice = {name: np.array([e.features[:2] for e in seen]) for name, seen in estimates.items() if len(seen) > 1}
    seen_in_part = {name: np.array(at) for name, at in in_part.items() if at and not estimates[name]}
    return Fittings(found, seen_twice, tuple(without_depth), seen_in_part)


def _lid(name: str, lid: Lid, face: _Face) -> FittingEstimate:
    features = np.array([*face.xy, face.top_z - lid.size[2] / 2, *spatial.quat_from_yaw(face.yaw), *lid.size])
    covariance = np.zeros((10, 10))
    covariance[:7, :7] = fitted_covariance(face.fit, HEIGHT_SIGMA**2, face.views, LID_SIGMA, face.yaw)
    return FittingEstimate(name, features, covariance)


def _drawer(name: str, drawer: Drawer, front: _Face, cabinet: _Face, table_z: float) -> FittingEstimate | None:
    """The drawer of a front and a cabinet, or None where the one does not slide out of the other."""
    along = np.array([np.cos(cabinet.yaw), np.sin(cabinet.yaw)])
    # Both ends of a cabinet look alike from above: its face is where the front is.
    ahead = float(along @ (front.xy - cabinet.xy)) >= 0
    along = along if ahead else -along
    yaw = float(spatial.wrap(cabinet.yaw if ahead else cabinet.yaw + np.pi))
    away = front.xy - cabinet.xy
    opening = float(along @ away) - (drawer.cabinet[0] + drawer.front[0]) / 2
    beside = float(along[0] * away[1] - along[1] * away[0])
    fits = (
        -SIZE_TOLERANCE < opening < drawer.travel + SIZE_TOLERANCE
        and abs(beside) < OFF_THE_AXIS
        and abs(spatial.wrap(front.yaw - cabinet.yaw, np.pi)) < ASKEW
        and front.top_z - drawer.front[2] > table_z - SIZE_TOLERANCE
        and abs(cabinet.top_z - table_z - drawer.cabinet[2]) < SIZE_TOLERANCE
        and front.top_z < cabinet.top_z + SIZE_TOLERANCE
    )
    if not fits:
        return None
    z = front.top_z - drawer.front[2] / 2
    features = np.array([*front.xy, z, *spatial.quat_from_yaw(yaw), opening, *drawer.front])
    covariance = np.zeros((11, 11))
    covariance[:7, :7] = fitted_covariance(front.fit, HEIGHT_SIGMA**2, front.views, DRAWER_SIGMA, yaw)
    moves = along * np.square(front.fit.sigma[:2])
    covariance[:2, 7] = covariance[7, :2] = moves
    covariance[7, 7] = along @ moves + np.square(along * cabinet.fit.sigma[:2]).sum() + OPENING_SIGMA**2
    return FittingEstimate(name, features, covariance)


def _outline(views: Sequence[View], index: int, patch: np.ndarray, extents: np.ndarray) -> _Outline | None:
    """The upper face in a patch of points; None where it is tilted, or too large for these extents (2,)."""
    top_z = peak_height(patch[:, 2])
    top = patch[np.abs(patch[:, 2] - top_z) < 0.005]
    centre, yaw, rough = rough_rectangle(top[:, :2])
    if (np.sort(rough) - np.sort(extents)).max() > ROUGHLY or tilt_of(top) > UPRIGHT_WITHIN:
        return None

    def of_face(view: View) -> np.ndarray:
        return view.labels == index

    half = float(np.hypot(*extents)) / 2 + 0.015
    cells = grid(centre, half, max(half / 75, 0.001))
    votes = vote(views, cells, top_z, of_face, outward_of_rectangle(cells, centre, yaw, rough))
    return _Outline(votes, (centre, yaw, rough), top_z)


def _fit_face(outline: _Outline, extents: np.ndarray) -> _Face | None:
    """The face of an outline, or None where it does not have these extents (2,)."""
    if (np.sort(extents) - np.sort(outline.rough[2])).max() > ROUGHLY:
        return None
    r = fit_rectangle(outline.votes, outline.rough)
    measured = np.array([r.width, r.length])
    off, off_turned = (float(np.abs(measured - e).max()) for e in (extents, extents[::-1]))
    if min(off, off_turned) > SIZE_TOLERANCE or r.misfit > 0.35:
        return None
    yaw = r.yaw if off <= off_turned or extents[0] == extents[1] else float(spatial.wrap(r.yaw + np.pi / 2, np.pi))
    return _Face(r, yaw, outline.top_z, outline.votes.views)
