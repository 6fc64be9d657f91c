"""Which pixels belong to which object. A segmenter is anything with `segment(frame) -> list[Segment]`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from resync_robot.core.errors import PerceptionError
from resync_robot.core.world import CameraFrame
from resync_robot.perception.catalogue import Catalogue

NOBODY = -1


@dataclass(frozen=True)
class Segment:
    """Attributes: `label`, the name of a block, of several that look alike the first; `mask` (H, W) bool, its pixels
    in one picture."""

    label: str
    mask: Bool[np.ndarray, "h w"]


class Segmenter(Protocol):
    """Finds the named objects in one picture; an object that is not seen has no segment."""

    def segment(self, frame: CameraFrame) -> list[Segment]: ...


def as_rgb(frame: CameraFrame) -> UInt8[np.ndarray, "h w 3"]:
    """The picture of a frame. Raises PerceptionError where it is no 8-bit RGB."""
    colour = frame.colour
    if colour.dtype != np.uint8 or colour.ndim != 3 or colour.shape[2] != 3:
        raise PerceptionError(
            f"the picture of camera '{frame.name}' is {colour.dtype} {colour.shape}, not uint8 (H, W, 3) RGB",
            "set the camera's colour stream to RGB8",
        )
    return colour


def vivid(hsv: UInt8[np.ndarray, "h w 3"], catalogue: Catalogue) -> Bool[np.ndarray, "h w"]:
    """Which pixels have a colour. `hsv`: as OpenCV's `COLOR_RGB2HSV_FULL` has it."""
    saturation = hsv[..., 1]
    chroma = saturation.astype(np.uint16) * hsv[..., 2]
    found: np.ndarray = (saturation >= catalogue.least_saturation * 255) & (chroma >= catalogue.least_chroma * 255**2)
    return found


class ColourSegmenter:
    """Saturated pixels of a catalogue hue, joined into connected components. Needs no weights.

    One segment for every component, so that one label may come several times (a block seen in two parts behind the
    hand); what belongs together is decided in space, not in the picture.

    Args:
        catalogue: the hue of each object.
        least_pixels: smaller components are noise.
    """

    def __init__(self, catalogue: Catalogue, least_pixels: int = 25) -> None:
        self._catalogue = catalogue
        self._least_pixels = least_pixels
        self._names = [alike[0] for alike in catalogue.look_alikes]
        hues = np.array([catalogue.hues[n] for n in self._names])
        away = np.abs((np.arange(256)[:, None] / 256 - hues + 0.5) % 1.0 - 0.5)
        close = away.min(axis=1) <= catalogue.hue_tolerance
        self._owner_of_hue = np.where(close, away.argmin(axis=1), NOBODY).astype(np.int8)

    def segment(self, frame: CameraFrame) -> list[Segment]:
        """Components of every catalogue colour. Raises PerceptionError on a picture that is no 8-bit RGB."""
        colour = as_rgb(frame)
        hsv = cv2.cvtColor(cv2.GaussianBlur(colour, (3, 3), 0.6), cv2.COLOR_RGB2HSV_FULL)
        owner = np.where(vivid(hsv, self._catalogue), self._owner_of_hue[hsv[..., 0]], NOBODY)
        segments = []
        for i, name in enumerate(self._names):
            mask = (owner == i).astype(np.uint8)
            count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
            segments += [
                Segment(name, labels == k) for k in range(1, count) if stats[k, cv2.CC_STAT_AREA] >= self._least_pixels
            ]
        return segments
