"""D435i cameras by serial number, through pyrealsense2."""

from __future__ import annotations

from hardware.base import Connected, Robot
from resync_robot.core.rig import CameraRig, Rig
from resync_robot.core.world import CameraFrame


class RealSense(Connected):
    def __init__(self, rig: Rig, camera: CameraRig, robot: Robot) -> None:
        self.name = camera.name

    def connect(self) -> None: ...

    def close(self) -> None: ...

    def capture(self) -> CameraFrame:
        raise NotImplementedError
