"""Parts of pictures, for policies that look at what is around the hand."""

from __future__ import annotations

from resync_robot.core.errors import PerceptionError
from resync_robot.core.rig import CameraRig
from resync_robot.core.world import CameraFrame, Cutout, Window
from resync_robot.hardware.crop import crop


def cut_out(frame: CameraFrame, camera: CameraRig, window: Window, size: int) -> Cutout:
    """What lies in a window of a whole picture, scaled to (size, size).

    Raises:
        PerceptionError: the picture has not the size that the rig file gives, so that windows mean nothing in it, or
            the window lies outside of it.
    """
    height, width = frame.colour.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise PerceptionError(
            f"camera '{camera.name}' gave a picture of {width} x {height} pixels; the rig file says "
            f"{camera.width} x {camera.height}",
            "set the resolution of its stream, or calibrate again: resync-robot calibrate intrinsics",
        )
    return Cutout(frame.name, crop(frame.colour, window, size), frame.time)
