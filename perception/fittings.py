"""From labelled views to lids and drawers: cuboids of known size, found by their upper faces.

What does not measure what the catalogue says is not one of them; what is seen twice is reported and not chosen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from resync_robot.core import spatial
from resync_robot.core.fittings import Drawer, Lid
from resync_robot.perception.catalogue import CABINET, Catalogue
from resync_robot.perception.outline import (
    SEEN,
    Rectangle,
    Votes,
    coverage,
    fit_rectangle,
    grid,
    outward_of_rectangle,
    rough_rectangle,
    seen_edges,
    vote,
)
from resync_robot.perception.patches import LEAST_POINTS, UPRIGHT_WITHIN, patches_of, tilt_of
from resync_robot.perception.pose import HEIGHT_SIGMA, ViewSigma, fitted_covariance, peak_height
from resync_robot.perception.views import View, gather

LID_SIGMA, DRAWER_SIGMA = ViewSigma(place=0.0018, yaw=0.0050), ViewSigma(place=0.0014, yaw=0.0070)
"""Fitted to errors in rendered scenes."""
OPENING_SIGMA = 0.0014
"""m, of one view, whose error moves front and cabinet alike."""
ROUGHLY = 0.03
"""m by which the points of a face may seem larger or smaller than it is, before its edges are fitted."""
SIZE_TOLERANCE = 0.006
"""m by which fitted extents may differ from those of the catalogue."""
EDGE_SEEN = 0.5
"""Share of what lies outside an edge that some picture must show, or the face may go on there."""
UPPER_EDGE = 0.005
"""m by which a point of the upper edge of a front may seem higher or lower than that is."""
MOST_MISFIT, MOST_MISFIT_OF_FRONT = 0.35, 0.45
"""Root mean square of the votes that a shape may leave unexplained. A front is a strip of which most cells lie at an
edge: 0.23 to 0.31 in seven rendered scenes, and 0.37 in one where a lamp glares on it."""


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
        return bool(seen_edges(self.votes, self.rough, SIZE_TOLERANCE).min() >= EDGE_SEEN)


@dataclass(frozen=True)
class _Slide:
    """A front before a cabinet.

    Attributes:
        fit: (4,) x and y of the middle of the cabinet, the way that it opens to, and how far the front is out; m, rad.
        sigma: (4,) what the fit itself knows of these.
        views: how many see the cabinet's top.
        whole: the end of the front was seen, and all of its length.
    """

    fit: Float[np.ndarray, "4"]
    sigma: Float[np.ndarray, "4"]
    views: int
    whole: bool


@dataclass(frozen=True)
class _Face:
    """A level rectangle of known extents; `yaw` in [-pi/2, pi/2) turns the world's x to the first of these."""

    fit: Rectangle
    yaw: float
    top_z: float
    votes: Votes

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
        estimates[name] = []
        for cabinet in faces(name, name + CABINET, drawer.cabinet[:2]):
            if abs(cabinet.top_z - catalogue.table_z - drawer.cabinet[2]) > SIZE_TOLERANCE:
                continue
            # Both ends of a cabinet look alike from above: its face is where the front is.
            for yaw in (cabinet.yaw, float(spatial.wrap(cabinet.yaw + np.pi))):
                slide = _slide_of(views, index[name], drawer, cabinet, yaw, catalogue.table_z)
                if slide is None:
                    continue
                estimate = _drawer(name, drawer, slide, catalogue.table_z)
                if slide.whole:
                    estimates[name].append(estimate)
                else:
                    in_part[name].append(estimate.features[:2])
    found = {name: seen[0] for name, seen in estimates.items() if len(seen) == 1}
    seen_twice = {name: np.array([e.features[:2] for e in seen]) for name, seen in estimates.items() if len(seen) > 1}
    seen_in_part = {name: np.array(at) for name, at in in_part.items() if at and not estimates[name]}
    return Fittings(found, seen_twice, tuple(without_depth), seen_in_part)


def _lid(name: str, lid: Lid, face: _Face) -> FittingEstimate:
    features = np.array([*face.xy, face.top_z - lid.size[2] / 2, *spatial.quat_from_yaw(face.yaw), *lid.size])
    covariance = np.zeros((10, 10))
    covariance[:7, :7] = fitted_covariance(face.fit, HEIGHT_SIGMA**2, face.votes.views, LID_SIGMA, face.yaw)
    return FittingEstimate(name, features, covariance)


def _drawer(name: str, drawer: Drawer, slide: _Slide, table_z: float) -> FittingEstimate:
    """The front is where the cabinet lets it slide, and as far ahead as it was seen."""
    x, y, yaw, opening = slide.fit
    along, across = (np.array([np.cos(a), np.sin(a)]) for a in (yaw, yaw + np.pi / 2))
    reach = (drawer.cabinet[0] + drawer.front[0]) / 2 + opening
    z, quat = table_z + drawer.lift + drawer.front[2] / 2, spatial.quat_from_yaw(yaw)
    features = np.array([*(np.array([x, y]) + reach * along), z, *quat, opening, *drawer.front])
    # An error of the yaw moves the front sideways, one of the opening moves it ahead.
    by = np.zeros((11, 4))
    by[:2] = np.column_stack([np.eye(2), reach * across, along])
    by[[3, 6], 2] = np.array([-quat[3], quat[0]]) / 2
    by[7, 3] = 1.0
    place, turn = DRAWER_SIGMA.place, DRAWER_SIGMA.yaw
    variances = np.square([place, place, turn, OPENING_SIGMA]) / max(slide.views, 1) + slide.sigma**2
    covariance = by @ np.diag(variances) @ by.T
    covariance[2, 2] = HEIGHT_SIGMA**2
    return FittingEstimate(name, features, covariance)


def _slide_of(
    views: Sequence[View], index: int, drawer: Drawer, cabinet: _Face, yaw: float, table_z: float
) -> _Slide | None:
    """How far a front of that colour has come out of a cabinet that opens towards `yaw`; None where there is none.

    The upper edge of the front is what a view from above shows of it; where it ends towards a closed cabinet, which is
    higher, nobody sees.
    """
    along = np.array([np.cos(yaw), np.sin(yaw)])
    thickness, width, height = drawer.front
    top_z = table_z + drawer.lift + height
    face = cabinet.xy + along * drawer.cabinet[0] / 2
    points, _ = gather(
        views, [v.valid & (v.labels == index) & (np.abs(v.points[..., 2] - top_z) < UPPER_EDGE) for v in views]
    )
    away = points[:, :2] - face
    ahead, beside = away @ along, along[0] * away[:, 1] - along[1] * away[:, 0]
    on = (np.abs(beside) < width / 2 + SIZE_TOLERANCE) & (ahead > -SIZE_TOLERANCE)
    on &= ahead < drawer.travel + thickness + SIZE_TOLERANCE
    if on.sum() < LEAST_POINTS:
        return None
    rough = float(np.clip(np.percentile(ahead[on], 95) - thickness, 0.0, drawer.travel))

    def middle(opening: float) -> np.ndarray:
        return face + along * (opening + thickness / 2)

    half = width / 2 + 0.015
    cells = grid(middle(rough), half, max(half / 75, 0.001))
    edge = (middle(rough), yaw, np.array([thickness, width]))
    votes = vote(views, cells, top_z, lambda view: view.labels == index, outward_of_rectangle(cells, *edge))
    near = np.abs((cells - middle(rough)) @ along) < thickness / 2 + ROUGHLY
    votes = replace(votes, weight=np.where(near, votes.weight, 0.0))
    end, *_ = seen_edges(votes, edge, SIZE_TOLERANCE)
    spread = np.ptp(np.percentile(beside[on], [2, 98]))
    start = np.array([*cabinet.xy, yaw, rough])
    if end < EDGE_SEEN or spread < width - ROUGHLY:
        return _Slide(start, np.zeros(4), 0, whole=False)
    fit, sigma, misfit = _fit_slide(drawer, cabinet.votes, votes, start)
    if misfit > MOST_MISFIT_OF_FRONT or not -SIZE_TOLERANCE < fit[3] < drawer.travel + SIZE_TOLERANCE:
        return None
    return _Slide(fit, sigma, cabinet.votes.views, whole=True)


def _fit_slide(
    drawer: Drawer, cabinet: Votes, front: Votes, start: Float[np.ndarray, "4"]
) -> tuple[Float[np.ndarray, "4"], Float[np.ndarray, "4"], float]:
    """x, y, yaw of the cabinet and the opening that explain the votes for its top and for the edge of its front best;
    what the fit knows of these, and what the front leaves unexplained."""
    on_cabinet, on_front = cabinet.weight > SEEN, front.weight > SEEN

    def of_front(p: np.ndarray) -> np.ndarray:
        along = np.array([np.cos(p[2]), np.sin(p[2])])
        middle = p[:2] + along * ((drawer.cabinet[0] + drawer.front[0]) / 2 + p[3])
        return coverage(front.xy[on_front], middle, p[2], drawer.front[:2]) - front.filled[on_front]

    def misfit(p: np.ndarray) -> np.ndarray:
        top = coverage(cabinet.xy[on_cabinet], p[:2], p[2], drawer.cabinet[:2]) - cabinet.filled[on_cabinet]
        return np.concatenate([top, of_front(p)])

    scale = np.array([1.0, 1.0, 1.0 / max(drawer.cabinet[:2]), 1.0]) * 0.01
    fit = least_squares(misfit, start, x_scale=scale, loss="soft_l1", f_scale=0.3, max_nfev=25)
    left = float(np.sqrt(np.mean(of_front(fit.x) ** 2)))
    # Neighbouring cells see the same pixels, so a tenth of them is independent.
    information = fit.jac.T @ fit.jac + np.eye(4) * 1e-3
    return fit.x, np.sqrt(np.diag(np.linalg.inv(information)) * 10) * max(left, 0.05), left


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
    if min(off, off_turned) > SIZE_TOLERANCE or r.misfit > MOST_MISFIT:
        return None
    yaw = r.yaw if off <= off_turned or extents[0] == extents[1] else float(spatial.wrap(r.yaw + np.pi / 2, np.pi))
    return _Face(r, yaw, outline.top_z, outline.votes)
