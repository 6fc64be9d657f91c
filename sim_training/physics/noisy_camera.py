"""A simulated camera that is as bad as a real one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from resync_robot.core import spatial
from resync_robot.core.world import CameraFrame, Cutout, Glimpse, Window
from resync_robot.hardware.sim import SimCamera
from resync_robot.sim_training.physics.camera_noise import NoisySensor
from resync_robot.sim_training.physics.motion_blur import Motion


class NoisyCamera:
    """A simulated camera with the faults of a D435i.

    Args:
        motion: of the camera now; by default it always rests. Cut-outs stay sharp, as those are that the camera policy
            learns from.
    """

    def __init__(
        self, camera: SimCamera, sensor: NoisySensor, motion: Callable[[], Motion | None] = lambda: None
    ) -> None:
        self._camera, self._sensor, self._motion = camera, sensor, motion
        self.name = camera.name

    def connect(self) -> None:
        self._camera.connect()

    def close(self) -> None:
        self._camera.close()

    def capture(self) -> CameraFrame:
        return self._sensor.apply(self._camera.capture(), self._motion())

    def cut_out(self, window: Window, size: int) -> Cutout:
        # Here the camera stands off its believed place, there the belief is off: for what is seen it is the same.
        error = spatial.inverse(self._sensor.pose_error())
        seen = self._camera.cut_out(window, size, error)
        return replace(seen, colour=self._sensor.colour(seen.colour, seen.time))

    def glimpse(self) -> Glimpse:
        seen = self._camera.glimpse()
        return replace(seen, colour=self._sensor.glimpse(seen.colour, seen.time))

    def __enter__(self) -> NoisyCamera:
        self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
