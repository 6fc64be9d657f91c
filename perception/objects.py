"""A scan's pictures in, an estimate of the scene out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from resync_robot.core.errors import ConfigError, PerceptionError
from resync_robot.core.rig import CameraRig, Rig
from resync_robot.core.world import CameraFrame
from resync_robot.perception.blocks import BlockEstimate, Glimpse, estimate_blocks
from resync_robot.perception.catalogue import BLOCK_HUES, FITTING_HUES, Catalogue
from resync_robot.perception.fittings import FittingEstimate, Fittings, estimate_fittings
from resync_robot.perception.ground import Ground
from resync_robot.perception.pose import BoxEstimate, box_outline, box_under, estimate_box, outer_corners
from resync_robot.perception.register import align_to_box
from resync_robot.perception.segment import ColourSegmenter, Segmenter
from resync_robot.perception.views import View, level, make_view


@dataclass(frozen=True)
class SceneEstimate:
    """What one scan says. `blocks` by name; `glimpses`: blocks of which only sides are seen; `surplus`: blocks beyond
    those that there are of their colour; `without_depth`: names of things whose pixels hold no depth; `fittings`: lids
    and drawers by name; `seen_twice`: name of a lid or drawer -> (n, 2) places in m, where none is chosen;
    `seen_in_part`: the same for one that was not found, and may be what the pictures show only a part of."""

    box: BoxEstimate
    blocks: Mapping[str, BlockEstimate]
    glimpses: Mapping[str, Glimpse]
    surplus: tuple[BlockEstimate, ...] = ()
    without_depth: tuple[str, ...] = ()
    fittings: Mapping[str, FittingEstimate] = field(default_factory=dict)
    seen_twice: Mapping[str, Float[np.ndarray, "n 2"]] = field(default_factory=dict)
    seen_in_part: Mapping[str, Float[np.ndarray, "n 2"]] = field(default_factory=dict)


def catalogue_of(rig: Rig, furnished: bool = False) -> Catalogue:
    """The catalogue with the colours of the rig file, where it has any; else with its own, and, where the task is
    `furnished` with lids or drawers, with those of these. Raises ConfigError where they cannot be."""
    if not rig.hues:
        return Catalogue(hues={**BLOCK_HUES, **FITTING_HUES}) if furnished else Catalogue()
    try:
        return Catalogue(hues=rig.hues)
    except ConfigError as error:
        raise ConfigError(f"{rig.where}: {error.what}", error.fix) from None


def check_colours(rig: Rig, hues: Mapping[str, float]) -> None:
    """Whether there is a catalogue with these under [hues] beside what the rig has there. Raises ConfigError."""
    catalogue_of(replace(rig, hues={**rig.hues, **hues}))


def hues_of(rig: Rig) -> str:
    """Whose colours the catalogue has, for a message: empty where they are its own."""
    return f"[hues] of {rig.where}" if rig.hues else ""


BOX_MOVED = 0.005
"""m by which a picture may lie beside a box that is known; the calibrated pose of a camera is never so wrong."""


class SceneEstimator:
    """Estimates box, blocks, lids and drawers from a scan.

    Args:
        rig: whose hand to mask, and where the cameras sit.
        catalogue: what may stand on the table; by default in the colours of the rig file, where it has any.
        segmenter: colour by default.
    """

    def __init__(self, rig: Rig, catalogue: Catalogue | None = None, segmenter: Segmenter | None = None) -> None:
        self.rig = rig
        self.catalogue = catalogue or catalogue_of(rig)
        self.segmenter = segmenter or ColourSegmenter(self.catalogue)

    def estimate(self, frames: Sequence[CameraFrame], box: BoxEstimate | None = None) -> SceneEstimate:
        """Fuse the pictures of one scan.

        Args:
            box: known from an earlier scan; these pictures, which need not show all of it, then are taken to be of
                that one.

        Raises:
            PerceptionError: no pictures, one that cannot be used, neither a box nor a lid that covers one, or a box
                that is not where it is known.
        """
        if not frames:
            raise PerceptionError("a scan without pictures", "check that the wrist camera delivers frames")
        views = [make_view(f, self.segmenter, self.catalogue, self.rig) for f in frames]
        outline = box_outline(views, self.catalogue) if box is None else outer_corners(box.features)
        views = [level(v, self.catalogue, outline) for v in views]
        box, views, fittings = self._box_and_fittings(views, [self.rig.camera(f.name) for f in frames], box)
        drawers = {n: fittings.found[n].features for n in self.catalogue.coloured_drawers if n in fittings.found}
        blocks = estimate_blocks(views, self.catalogue, Ground(self.catalogue, box.features, drawers))
        return SceneEstimate(
            box,
            blocks.found,
            blocks.glimpses,
            blocks.surplus,
            (*blocks.without_depth, *fittings.without_depth),
            fittings.found,
            fittings.seen_twice,
            fittings.seen_in_part,
        )

    def _box_and_fittings(
        self, views: list[View], cameras: Sequence[CameraRig], known: BoxEstimate | None
    ) -> tuple[BoxEstimate, list[View], Fittings]:
        """The box, the views corrected by it, and the lids and drawers in them."""
        try:
            box = estimate_box(views, self.catalogue) if known is None else known
        except PerceptionError:
            # A lid may cover all of the rim.
            fittings = estimate_fittings(views, self.catalogue)
            lids = [fittings.found[n].features for n in self.catalogue.coloured_lids if n in fittings.found]
            beneath = next(filter(None, (box_under(lid, self.catalogue) for lid in lids)), None)
            if beneath is None:
                raise
            return beneath, views, fittings
        if not box.seen:
            return box, views, estimate_fittings(views, self.catalogue)
        aligned = [align_to_box(v, box.features, self.catalogue, c) for v, c in zip(views, cameras, strict=True)]
        if known is not None:
            _check_place(views, aligned)
        return box, aligned, estimate_fittings(aligned, self.catalogue)


def _check_place(views: Sequence[View], aligned: Sequence[View]) -> None:
    """Raises PerceptionError where a view had to be moved far to agree with the known box."""
    moved = max(
        float(np.linalg.norm(a.world_T_cam[:3, 3] - v.world_T_cam[:3, 3])) for v, a in zip(views, aligned, strict=True)
    )
    if moved > BOX_MOVED:
        raise PerceptionError(f"the box is {1000 * moved:.0f} mm from where it was", "look at all of it again")
