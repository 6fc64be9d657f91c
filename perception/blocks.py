"""From labelled views to the blocks: which patches of a colour are one block, where each stands, and how sure that is.

Blocks of one colour cannot be told apart by what they look like. A scan counts them, and hands out their names in the
order of x; whoever remembers where they stood (`belief`) puts the names right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.ground import Ground
from resync_robot.perception.outline import Rectangle, fit_rectangle, grid, outward_of_face, rough_rectangle, vote
from resync_robot.perception.patches import LEAST_POINTS, UPRIGHT_WITHIN, patches_of, tilt_of, without_stragglers
from resync_robot.perception.pose import (
    HEIGHT_SIGMA,
    ViewSigma,
    fitted_covariance,
    peak_height,
    tie_height,
    upright_covariance,
)
from resync_robot.perception.views import View

BLOCK_SIGMA = ViewSigma(place=0.00118, yaw=0.0078)
SIZE_SIGMA = 0.0006
STOREY_SIGMA = 0.003
"""Of the heights of blocks around their mean, m."""
BESIDE = 1.3
"""Distance of two centres over their width, below which blocks touch: one edge of each is not seen."""
TOUCHING_SIGMA, SEAM_SIGMA = ViewSigma(place=0.0, yaw=0.004), ViewSigma(place=0.001, yaw=0.010)
"""What that adds where the colours tell the two apart, and where they do not."""
CORNER_SIGMA, CORNER_GAP = ViewSigma(place=0.0004, yaw=0.0015), 0.010
"""What two walls nearer than that add, m: all views come from the middle of the box, and draw the outline there."""
TYPICAL_HEIGHT = 0.045
COVERED_WITHIN = 0.040
OBLONG = 1.4
"""Length over width from which a patch is no longer one square block."""
SEAM = 0.003
"""m on either side of the line between two touching blocks of a colour, where no view tells whose a cell is."""


@dataclass(frozen=True)
class BlockEstimate:
    """One block whose top face was seen.

    Attributes:
        features, covariance: of core.vocabulary.BLOCK.
        top_z: height of the body's top face in the world, m.
        upright: its top face is level, high enough, and bears the stud.
        stacked: it stands on another one, so that its own height is a guess.
        views: how many saw the top face.
    """

    name: str
    features: Float[np.ndarray, "10"]
    covariance: Float[np.ndarray, "10 10"]
    top_z: float
    upright: bool
    stacked: bool
    views: int


@dataclass(frozen=True)
class Glimpse:
    """A block of which something is seen around `centre` (2,), but no top face that could be measured."""

    name: str
    centre: Float[np.ndarray, "2"]


@dataclass(frozen=True)
class Blocks:
    """What a scan says about blocks.

    Attributes:
        found, glimpses: by name.
        surplus: blocks seen beyond those that there are of their colour, named after one of these.
        without_depth: names of blocks that show in the pictures, where these hold no depth.
    """

    found: dict[str, BlockEstimate]
    glimpses: dict[str, Glimpse]
    surplus: tuple[BlockEstimate, ...]
    without_depth: tuple[str, ...]


def estimate_blocks(views: Sequence[View], catalogue: Catalogue, ground: Ground) -> Blocks:
    """Every block whose top face is seen, and glimpses of those of which only sides are."""
    found: dict[str, BlockEstimate] = {}
    surplus: list[BlockEstimate] = []
    without_depth: list[str] = []
    patches: dict[str, list[np.ndarray]] = {}
    groups = [(i, names) for i, names in enumerate(catalogue.look_alikes) if names[0] in catalogue.blocks]
    for index, names in groups:
        whole, blind = patches_of(views, index, catalogue)
        if blind:
            without_depth += names
        pieces = [p for c in whole for p in (_squares(c, catalogue) if len(names) > 1 else [c])]
        centres = [_middle(p) for p in pieces]
        estimates = []
        for i, piece in enumerate(pieces):
            others = [c for j, c in enumerate(centres) if j != i]
            estimate = _block(views, index, names[0], piece, others, ground)
            if estimate is not None:
                estimates.append(estimate)
            else:
                patches.setdefault(names[0], []).append(centres[i])
        # The best seen are those that exist; what is left over is a riddle for whoever asked.
        estimates.sort(key=lambda e: (-e.views, e.covariance[0, 0]))
        surplus += [e for e in estimates[len(names) :] if _is_a_block_of_its_own(e, estimates[: len(names)])]
        kept = sorted(estimates[: len(names)], key=lambda e: float(e.features[0]))
        found |= {name: replace(e, name=name) for name, e in zip(names, kept, strict=False)}
    found = {name: _beside_others(block, found, catalogue) for name, block in found.items()}
    glimpses: dict[str, Glimpse] = {}
    for name, block in list(found.items()):
        # Under another block only a rim of the top face shows, or a side that looks like one: no measurement.
        if any(_covers(other, block) for other in found.values()):
            glimpses[name] = Glimpse(name, found.pop(name).features[:2])
    for _, names in groups:
        missing = [n for n in names if n not in found and n not in glimpses]
        # A tower of one colour shows one top face: what is not seen elsewhere may be below it.
        towers = [b.features[:2] for b in found.values() if b.stacked]
        of_one_colour = [b.features[:2] for n, b in found.items() if n in names and b.stacked]
        sides = sorted(patches.get(names[0], []), key=lambda c: min((_distance(c, t) for t in towers), default=0.0))
        glimpses |= {n: Glimpse(n, c) for n, c in zip(missing, [*sides, *of_one_colour], strict=False)}
    return Blocks(found, glimpses, tuple(surplus), tuple(without_depth))


def _is_a_block_of_its_own(estimate: BlockEstimate, known: Sequence[BlockEstimate]) -> bool:
    """Not a part of one that was counted already, seen apart from the rest of it."""
    apart = [_distance(estimate.features, k.features) for k in known]
    return estimate.upright and estimate.views > 1 and min(apart) > COVERED_WITHIN


def _beside_others(block: BlockEstimate, found: Mapping[str, BlockEstimate], catalogue: Catalogue) -> BlockEstimate:
    """The estimate with the doubt that blocks touching it add."""
    covariance = block.covariance.copy()
    place, yaw = np.zeros(3), 0.0
    for name, other in found.items():
        apart = _distance(other.features, block.features)
        level = abs(other.top_z - block.top_z) < TYPICAL_HEIGHT / 2
        if name == block.name or not level or apart > BESIDE * block.features[7]:
            continue
        added = SEAM_SIGMA if catalogue.hues[name] == catalogue.hues[block.name] else TOUCHING_SIGMA
        place[:2] += added.place**2
        yaw += added.yaw**2
    covariance[:7, :7] += upright_covariance(place, yaw, block.features[3:7])
    return replace(block, covariance=covariance)


def _distance(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.linalg.norm(first[:2] - second[:2]))


def _covers(upper: BlockEstimate, lower: BlockEstimate) -> bool:
    apart = _distance(upper.features, lower.features)
    return upper.top_z > lower.top_z + TYPICAL_HEIGHT / 2 and apart < COVERED_WITHIN


def _block(
    views: Sequence[View],
    index: int,
    name: str,
    patch: np.ndarray,
    others: Sequence[np.ndarray],
    ground: Ground,
) -> BlockEstimate | None:
    """The block of a patch of points, or None where no square top face shows.

    Args:
        others: centres of the other patches of that colour, which a vote for this one must not count.
    """
    catalogue, box = ground.catalogue, ground.box
    top_z = peak_height(patch[:, 2])
    on_top = np.abs(patch[:, 2] - top_z) < 0.005
    # Sides alone have no peak: their heights are spread over the whole block.
    if on_top.sum() < 60 or on_top.mean() < 0.3:
        return None
    top = patch[on_top]
    centre, yaw, extents = rough_rectangle(without_stragglers(top[:, :2]))
    least, most = catalogue.block_width
    if extents.max() < least * 0.6 or extents.max() > most * 1.4:
        return None

    def of_block(view: View) -> np.ndarray:
        return view.labels == index

    cells = grid(centre, 0.055, 0.001)
    votes = vote(views, cells, top_z, of_block, outward_of_face(cells, centre))
    votes = replace(votes, weight=np.where(_nearer_to(cells, centre, others), 0.0, votes.weight))
    r = fit_rectangle(votes, (centre, yaw, np.clip(extents, least, most)), square=True)
    if not least <= r.width <= most or r.misfit > 0.35:
        return None
    tilt = tilt_of(top)
    height = top_z - ground.height(np.array([r.x, r.y]))
    low, high = catalogue.block_height
    # Of a tower only the whole height is seen: its blocks share it.
    storeys = 1 if height <= high else round(height / TYPICAL_HEIGHT)
    # With their sum known, a height is off from the mean by less than heights are from each other.
    size_z = height / storeys
    size_z_sigma = SIZE_SIGMA if storeys == 1 else STOREY_SIGMA * np.sqrt(1 - 1 / storeys)
    features = np.array(
        [r.x, r.y, top_z - size_z / 2, *spatial.quat_from_yaw(r.yaw), r.width, r.width, size_z], dtype=np.float64
    )
    covariance = np.zeros((10, 10))
    covariance[:7, :7] = fitted_covariance(r, 0.0, votes.views, BLOCK_SIGMA)
    if box is not None and in_corner(np.array([r.x, r.y]), r.width, box):
        place = np.array([CORNER_SIGMA.place**2, CORNER_SIGMA.place**2, 0.0])
        covariance[:7, :7] += upright_covariance(place, CORNER_SIGMA.yaw**2, features[3:7])
    covariance[7:9, 7:9] = r.sigma[3] ** 2 + SIZE_SIGMA**2
    tie_height(covariance, size_z_sigma, HEIGHT_SIGMA)
    upright = tilt < UPRIGHT_WITHIN and height >= low and _has_stud(patch, r, top_z, catalogue)
    return BlockEstimate(name, features, covariance, top_z, upright, storeys > 1, votes.views)


def in_corner(xy: Float[np.ndarray, "2"], width: float, box: Float[np.ndarray, "11"]) -> bool:
    """Does a block of that width, square to the box, stand close to two of its walls?"""
    place = spatial.inverse(spatial.pose_from_features(box[:7])) @ np.array([*xy, box[2], 1.0])
    gaps = box[7:9] / 2 - np.abs(place[:2]) - width / 2
    return bool(np.all(np.abs(gaps) < CORNER_GAP))


def _has_stud(patch: np.ndarray, r: Rectangle, top_z: float, catalogue: Catalogue) -> bool:
    """Does something of the stud's height stand on the middle of the top face? Not so on a block that lies."""
    middle = np.hypot(patch[:, 0] - r.x, patch[:, 1] - r.y) < catalogue.stud_width / 2
    high = patch[middle, 2] > top_z + catalogue.stud_height / 2
    return len(high) > 20 and bool(high.mean() > 0.3)


def _nearer_to(cells: np.ndarray, own: np.ndarray, others: Sequence[np.ndarray]) -> np.ndarray:
    """(n,) which cells belong to another patch, or to the seam between it and this one."""
    foreign = np.zeros(len(cells), dtype=bool)
    for other in others:
        across = (other - own) / (np.linalg.norm(other - own) + 1e-9)
        foreign |= (cells - (own + other) / 2) @ across > -SEAM
    return foreign


def _squares(patch: np.ndarray, catalogue: Catalogue) -> list[np.ndarray]:
    """A patch that is too long for one square block, cut across until its pieces are not."""
    xy = without_stragglers(patch[:, :2])
    rectangle = cv2.minAreaRect(xy.astype(np.float32))
    long, short = max(rectangle[1]), min(rectangle[1])
    if long < max(OBLONG * short, 2 * catalogue.block_width[0]) or short < 0.6 * catalogue.block_width[0]:
        return [patch]
    # By the outline, which the block that is seen more often does not draw towards it; between two of them, not
    # through the middle one of three.
    corners = cv2.boxPoints(rectangle)
    sides = corners[1:3] - corners[:2]
    along = sides[np.argmax(np.linalg.norm(sides, axis=1))] / long
    blocks = max(2, round(long / short))
    second = (patch[:, :2] - corners.mean(axis=0)) @ along > (blocks // 2 / blocks - 0.5) * long
    halves = [patch[~second], patch[second]]
    if min(map(len, halves)) < LEAST_POINTS:
        return [patch]
    return [piece for half in halves for piece in _squares(half, catalogue)]


def _middle(patch: np.ndarray) -> np.ndarray:
    """(2,) of the least rectangle around a patch."""
    return rough_rectangle(without_stragglers(patch[:, :2]))[0]
