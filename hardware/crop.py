"""Parts of pictures, scaled: what a policy that looks through a window sees of a whole picture."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import UInt8

from resync_robot.core.errors import PerceptionError
from resync_robot.core.world import Window


def crop(colour: UInt8[np.ndarray, "h w 3"], window: Window, size: int) -> UInt8[np.ndarray, "size size 3"]:
    """What of the picture lies in the window, scaled to (size, size). Raises PerceptionError where nothing does."""
    height, width = colour.shape[:2]
    left, top = max(0, round(window.left)), max(0, round(window.top))
    right, bottom = min(width, round(window.left + window.width)), min(height, round(window.top + window.height))
    if left >= right or top >= bottom:
        raise PerceptionError(
            f"a window of {window.width:.0f} x {window.height:.0f} pixels at ({window.left:.0f}, {window.top:.0f}) "
            f"shows nothing of a picture of {width} x {height}",
            "bring the hand back into the camera's view, or calibrate again: resync-robot calibrate hand-eye",
        )
    return cv2.resize(colour[top:bottom, left:right], (size, size), interpolation=cv2.INTER_AREA)
