"""A camera of an emulated lab: its pictures come over the side door."""

from __future__ import annotations

from resync_robot.core.rig import CameraRig, Rig
from resync_robot.core.world import CameraFrame, Cutout, Glimpse, Window
from resync_robot.hardware.base import Connected, Robot
from resync_robot.hardware.emulator.lab_client import LabClient


class EmulatedCamera(Connected):
    """One camera of the rig, where calibration and the measured arm say it is.

    Args:
        lab: connected.
        robot: carries the camera, where it is mounted on the flange.
    """

    def __init__(self, lab: LabClient, rig: Rig, camera: CameraRig, robot: Robot) -> None:
        self._lab, self._rig, self._camera, self._robot = lab, rig, camera, robot
        self.name = camera.name

    def connect(self) -> None:
        pass

    def close(self) -> None:
        pass

    def capture(self) -> CameraFrame:
        """A picture of now."""
        time, colour, depth = self._lab.picture(self.name)
        pose = self._rig.camera_pose(self._camera, self._robot.state().q)
        return CameraFrame(self.name, colour, depth, self._camera.intrinsics, pose, time)

    def cut_out(self, window: Window, size: int) -> Cutout:
        """A part of a picture of now, rendered by itself."""
        time, colour = self._lab.window(self.name, window, size)
        return Cutout(self.name, colour, time)

    def glimpse(self) -> Glimpse:
        """The colours of now."""
        time, colour = self._lab.colour(self.name)
        return Glimpse(self.name, colour, time)
